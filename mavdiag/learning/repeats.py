"""Guard of teaching: a flight that counts twice, found by its content and not by its name.

Two copies of one file have one SHA-256. A copy in another container, or a part of a log, has the same gyro samples;
they are compared by their values, since a container may change the stamps.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.learning.findings import Finding, Kind
from mavdiag.telemetry import FloatArray, IntArray, Log, Signal
from mavdiag.units import NS_PER_S

__all__ = ["repeated"]

RUN = 16  # consecutive gyro samples that two flights do not have in common by chance (our choice)
RUN_CHANGES = 12  # of them that differ from the one before, for a gyro at rest repeats itself (our choice)
SHARED_S = 1.0  # of common runs that make an overlap (our choice)
ODD = 0x9E3779B97F4A7C15  # the golden ratio times 2^64: a multiplier that spreads bits (Knuth, TAOCP 3, 6.4)


@dataclass(frozen=True, slots=True, eq=False)
class _Content:
    """Of a flight's gyro.

    t_ns: (n,) its times. digest: of all values. runs: (m,) hashes of the runs that move.
    first: (m,) the sample that each begins with.
    """

    number: int
    log: Log
    t_ns: IntArray
    digest: str
    runs: IntArray
    first: IntArray


def repeated(flights: Sequence[Log]) -> tuple[Finding, ...]:
    """Flights that an earlier one holds already: the same file, the same gyro samples, or a part of them."""
    found: list[Finding] = []
    kept: list[_Content] = []
    for number, flight in enumerate(flights):
        content = _content(number, flight)
        finding = next((one for earlier in kept if (one := _compared(content, earlier)) is not None), None)
        if finding is None:
            kept.append(content)
        else:
            found.append(finding)
    return tuple(found)


def _content(number: int, flight: Log) -> _Content:
    gyro = flight.telemetry.need(Signal.BODY_RATE)
    values = np.ascontiguousarray(gyro.values, dtype=np.float64) + 0.0  # without negative zeros
    runs, first = _runs(values)
    return _Content(number, flight, gyro.t_ns, hashlib.sha256(values.tobytes()).hexdigest(), runs, first)


def _compared(one: _Content, earlier: _Content) -> Finding | None:
    number, name, other = one.number, one.log.name, earlier.log.name
    if one.log.sha256 and one.log.sha256 == earlier.log.sha256:
        return Finding(number, name, Kind.REPEATED, f"the same file as {other}")
    if one.digest == earlier.digest:
        return Finding(number, name, Kind.REPEATED, f"the same flight as {other}")
    common = one.first[np.isin(one.runs, earlier.runs)]
    if len(common) == 0:
        return None
    dt_s = float(np.median(np.diff(np.unique(one.t_ns)))) / NS_PER_S
    if len(common) * dt_s < SHARED_S:
        return None
    low_s, high_s = float(one.t_ns[common].min()) / NS_PER_S, float(one.t_ns[common + RUN - 1].max()) / NS_PER_S
    text = f"{len(common) * dt_s:.1f} s of it are in {other} as well"
    if len(common) > 0.95 * len(one.first):
        return Finding(number, name, Kind.REPEATED, text)
    return Finding(number, name, Kind.REPEATED, text, low_s, high_s + dt_s)


def _runs(values: FloatArray) -> tuple[IntArray, IntArray]:
    """A hash of each run of `RUN` samples that move, (m,), and the sample that each begins with, (m,)."""
    count = len(values) - RUN + 1
    if count <= 0:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    words = values.view(np.uint64)
    # h_i = sum_k c_k mix(sum_j c_j words_(i+k),j), modulo 2^64
    rows = np.zeros(len(values), dtype=np.uint64)
    for column in range(values.shape[1]):
        rows = (rows ^ words[:, column]) * np.uint64(ODD)
        rows ^= rows >> np.uint64(29)
    hashes = np.zeros(count, dtype=np.uint64)
    for k in range(RUN):
        hashes = hashes * np.uint64(ODD) + rows[k : k + count]
    changes = np.concatenate(([0], np.cumsum(np.any(np.diff(values, axis=0) != 0, axis=1))))
    moving = np.flatnonzero(changes[RUN - 1 :] - changes[:count] >= RUN_CHANGES)
    return hashes[moving].view(np.int64), moving
