"""Guard of teaching: a flight that counts twice, found by its content and not by its name.

Two copies of one file have one SHA-256. A copy in another container, or a part of a log, has the same gyro samples;
they are compared by their values, since a container may change the stamps.
"""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.learning.flights import IN_MEMORY, HeldLog, hold
from mavdiag.learning.guards import Finding, Kind
from mavdiag.rows.grid import median_step
from mavdiag.storage import Shelf
from mavdiag.telemetry import FloatArray, IntArray, Log, Signal
from mavdiag.units import NS_PER_S

RUN = 16  # consecutive gyro samples that two flights do not have in common by chance (our choice)
RUN_CHANGES = 12  # of them that differ from the one before, for a gyro at rest repeats itself (our choice)
SHARED_S = 1.0  # of common runs that make an overlap (our choice)
ODD = 0x9E3779B97F4A7C15  # the golden ratio times 2^64: a multiplier that spreads bits (Knuth, TAOCP 3, 6.4)


@dataclass(frozen=True, slots=True, eq=False)
class _Content:
    """Of a flight's gyro. digest: of all values. runs: (m,) hashes of the runs that move."""

    number: int
    flight: HeldLog
    digest: str
    runs: IntArray


def repeated(flights: Iterable[Log | HeldLog]) -> tuple[Finding, ...]:
    """Flights that an earlier one holds already: the same file, the same gyro samples, or a part of them."""
    shelf = Shelf(IN_MEMORY)
    contents = [_content(number, hold(flight, shelf)) for number, flight in enumerate(flights)]
    shared = _shared(contents)
    found: list[Finding] = []
    kept: list[_Content] = []
    for content in contents:
        pairs = (_compared(content, earlier, shared) for earlier in kept)
        finding = next((pair for pair in pairs if pair is not None), None)
        if finding is None:
            kept.append(content)
        else:
            found.append(finding)
    return tuple(found)


def _shared(contents: Sequence[_Content]) -> frozenset[int]:
    """Numbers of the flights that hold a run which occurs more than once in all flights: hardly ever one."""
    pooled = np.sort(np.concatenate([np.empty(0, dtype=np.int64), *(one.runs for one in contents)]))
    twice = np.unique(pooled[1:][pooled[1:] == pooled[:-1]])
    return frozenset(one.number for one in contents if len(twice) and np.isin(one.runs, twice).any())


def _gyro(flight: HeldLog) -> tuple[IntArray, FloatArray]:
    """Times and values of a flight's gyro, without negative zeros."""
    gyro = flight.open().telemetry.need(Signal.BODY_RATE)
    return gyro.t_ns, np.ascontiguousarray(gyro.values, dtype=np.float64) + 0.0


def _content(number: int, flight: HeldLog) -> _Content:
    _, values = _gyro(flight)
    return _Content(number, flight, hashlib.sha256(values.tobytes()).hexdigest(), _runs(values)[0])


def _compared(one: _Content, earlier: _Content, shared: frozenset[int]) -> Finding | None:
    number, label, other = one.number, one.flight.label, earlier.flight.label.name
    name = label.name
    if label.sha256 and label.sha256 == earlier.flight.label.sha256:
        return Finding(number, name, Kind.REPEATED, f"the same file as {other}")
    if one.digest == earlier.digest:
        return Finding(number, name, Kind.REPEATED, f"the same flight as {other}")
    if number not in shared or earlier.number not in shared:
        return None
    t_ns, values = _gyro(one.flight)
    first = _runs(values)[1]
    common = first[np.isin(one.runs, earlier.runs)]
    if len(common) == 0:
        return None
    dt_s = median_step([t_ns]) / NS_PER_S
    if len(common) * dt_s < SHARED_S:
        return None
    low_s, high_s = float(t_ns[common].min()) / NS_PER_S, float(t_ns[common + RUN - 1].max()) / NS_PER_S
    text = f"{len(common) * dt_s:.1f} s of it are in {other} as well"
    if len(common) > 0.95 * len(first):
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
