"""Guard of teaching: a flight that ends in a fall or a crash, or has one in its middle.

The signs are means over 0.4 s, while the vehicle counts as flying: free fall (hardly any specific force), thrust or
ground above the vehicle (specific force towards its belly), an attitude far from the commanded one or upside down, and
tumbling. A landing shows none of them: its spikes of 8 to 11 rad/s last some tens of milliseconds (METHOD section 5).
A flight that flies flips on purpose is refused as well, for a baseline of it would say that flips are healthy.
"""

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from mavdiag.airframe.traits import joined
from mavdiag.learning.findings import Finding, Kind
from mavdiag.learning.flights import LearntFlight
from mavdiag.rows.block import Block
from mavdiag.rows.windows import spans, window_mean, window_rows
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Signal
from mavdiag.units import NS_PER_S, G

__all__ = ["upsets"]

SIGN_S = 0.4  # of the means (our choice)
FALL_G = 0.3  # a vehicle that descends on purpose keeps more than half (our choice)
UPSIDE_DOWN_G = 0.3  # towards the belly (our choice)
TILT_RAD = math.radians(90.0)  # from the vertical (our choice)
ERROR_RAD = math.radians(60.0)  # from the commanded attitude (our choice)
TUMBLE_RAD_S = 5.0  # roll and pitch rates together (our choice)
TUMBLE_RATIO = 5.0  # and against the rate that the flight stays below for three quarters of its time
USUAL_SHARE = 0.75
MARGIN_S = 2.0  # of the flight before the first sign and after the last that belong to the upset (our choice)
REST_S = 10.0  # less flight than this after it is left out with it (our choice)

Sign = tuple[float, float, str]  # start, end [s], what was seen


def upsets(flights: Sequence[LearntFlight]) -> tuple[Finding, ...]:
    """The upset of each flight that has one, from its first sign to its last."""
    found = (_upset(number, flight) for number, flight in enumerate(flights))
    return tuple(one for one in found if one is not None)


def _upset(number: int, flight: LearntFlight) -> Finding | None:
    blocks = joined(flight.rows)
    signs = sorted(itertools.chain(_motions(blocks), _attitudes(flight, blocks)))
    if not signs:
        return None
    begin_s, _, text = signs[0]
    after_s = max(stop for _, stop, _ in signs) + MARGIN_S
    ends = float(blocks[-1].t_ns[-1]) / NS_PER_S < after_s + REST_S
    what = "ends in an upset" if ends else "has an upset in it"
    text = f"the flight {what}, at {begin_s:.1f} s: {text}"
    return Finding(number, flight.label.name, Kind.UPSET, text, begin_s - MARGIN_S, None if ends else after_s)


def _motions(blocks: Sequence[Block]) -> Iterator[Sign]:
    """Signs in gyro and accelerometer."""
    turning = [_mean(np.hypot(one.rate[:, 0], one.rate[:, 1]), one.dt_s) for one in blocks]
    usual = float(np.quantile(np.concatenate(turning), USUAL_SHARE)) if sum(map(len, turning)) else 0.0
    for block, turn in zip(blocks, turning, strict=True):
        t_s = block.t_ns / NS_PER_S
        yield from _spells(t_s, turn > max(TUMBLE_RAD_S, TUMBLE_RATIO * usual), turn, "it turns at {:.1f} rad/s")
        known = np.isfinite(block.force[:, 2])
        # A vehicle that sends the z axis alone is judged by it.
        size = np.where(known, np.sqrt(np.nansum(block.force**2, axis=1)), np.nan) / G
        size = _mean(size, block.dt_s)
        yield from _spells(t_s, size < FALL_G, -size, "free fall, specific force {:.2f} g")
        down = _mean(block.force[:, 2] / G, block.dt_s)
        yield from _spells(t_s, down > UPSIDE_DOWN_G, down, "upside down, specific force {:.1f} g towards the belly")


def _attitudes(flight: LearntFlight, blocks: Sequence[Block]) -> Iterator[Sign]:
    """Signs in the estimated attitude, where it is sent: upside down, or far from what was commanded."""
    series = flight.flight.telemetry.get(Signal.ATTITUDE)
    if series is None:
        return
    for block in blocks:
        inside = (series.t_ns >= block.t_ns[0]) & (series.t_ns <= block.t_ns[-1])
        t_ns, first = np.unique(series.t_ns[inside], return_index=True)
        angle = series.values[inside][first]
        if len(t_ns) < 2 or not np.isfinite(angle[:, :2]).any():
            continue
        dt_s = float(np.median(np.diff(t_ns))) / NS_PER_S
        tilt = _mean(np.arccos(np.clip(np.cos(angle[:, 0]) * np.cos(angle[:, 1]), -1.0, 1.0)), dt_s)
        yield from _spells(t_ns / NS_PER_S, tilt > TILT_RAD, np.degrees(tilt), "tilted by {:.0f} deg")
        error = _mean(_astray(block, t_ns, angle), dt_s)
        text = "attitude {:.0f} deg from its set-point"
        yield from _spells(t_ns / NS_PER_S, error > ERROR_RAD, np.degrees(error), text)


def _astray(block: Block, t_ns: IntArray, angle: FloatArray) -> FloatArray:
    """(n,) [rad] between commanded and estimated direction of thrust; NaN where no set-point is known."""
    rows = np.clip(np.searchsorted(block.t_ns, t_ns), 0, len(block) - 1)
    wanted = block.setpoint[rows]
    dot = (_thrust(wanted) * _thrust(angle)).sum(axis=1)
    return np.where(block.setpoint_valid[rows], np.arccos(np.clip(dot, -1.0, 1.0)), np.nan)


def _thrust(angle: FloatArray) -> FloatArray:
    """Where the thrust points, (n, 3), of roll and pitch; the heading does not matter."""
    (sin_roll, sin_pitch), (cos_roll, cos_pitch) = np.sin(angle[:, :2].T), np.cos(angle[:, :2].T)
    return np.stack((sin_pitch * cos_roll, -sin_roll, cos_pitch * cos_roll), axis=1)


def _mean(x: FloatArray, dt_s: float) -> FloatArray:
    """Means over SIGN_S, (n,) -> (m,); a NaN spoils those that hold it."""
    return window_mean(x[:, None], window_rows(SIGN_S, dt_s))[:, 0]


def _spells(t_s: FloatArray, sign: BoolArray, value: FloatArray, text: str) -> Iterator[Sign]:
    """Each spell of a sign (m,) over windows of the samples at t_s (n,), with the size of its greatest value."""
    window = len(t_s) - len(sign)
    for first, stop in spans(np.asarray(sign, dtype=np.bool_)):
        yield float(t_s[first]), float(t_s[stop - 1 + window]), text.format(abs(float(value[first:stop].max())))
