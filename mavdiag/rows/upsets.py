"""Falls and crashes: a flight that ends in an upset, or has one in its middle. Learning refuses it; judging says so.

The signs are means over 0.4 s, while the vehicle counts as flying. A landing shows none of them: its spikes of 8 to 11
rad/s last some tens of milliseconds (METHOD section 5).
"""

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

import mavdiag.rows.block as col
from mavdiag.jit import cached_loop, jit
from mavdiag.rows.block import Block
from mavdiag.rows.windows import spans, window_mean
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.units import NS_PER_MS, NS_PER_S, G

SIGN_S = 0.4  # of the means (our choice)
BIN_S = 0.1  # steps of these means, where rows come at 20 Hz or more (our choice)
LOOK_NS = 20 * NS_PER_MS  # between two looks at the attitude, which no vehicle changes by much in it (our choice)
FALL_G = 0.3  # a vehicle that descends on purpose keeps more than half (our choice)
UPSIDE_DOWN_G = 0.3  # towards the belly (our choice)
TILT_RAD = math.radians(90.0)  # from the vertical (our choice)
ERROR_RAD = math.radians(60.0)  # from the commanded attitude (our choice)
TUMBLE_RAD_S = 5.0  # roll and pitch rates together (our choice)
TUMBLE_RATIO = 5.0  # and against the rate that the flight stays below for three quarters of its time
USUAL_SHARE = 0.75
MARGIN_S = 2.0  # of the flight before the first sign and after the last that belong to the upset (our choice)
REST_S = 10.0  # less flight than this after it is left out with it (our choice)


@dataclass(frozen=True, slots=True)
class Upset:
    """From the first sign to the last [s of the vehicle's clock]; whether the flight ends in it; a sentence."""

    begin_s: float
    end_s: float
    ends: bool
    text: str


def motion_of(block: Block) -> FloatArray:
    """Make, for `upset_in`, (bins, 10) numbers of each 0.1 s of any rows.

    Segment, number of the bin, its length [s], its rows; the sums of turning rate [rad/s], size and z of the specific
    force [g]; the looks at its attitude, and the sums of tilt and attitude error [rad].
    """
    bin_s = BIN_S if block.dt_s <= 0.5 * BIN_S else SIGN_S
    bin_ns = round(bin_s * NS_PER_S)
    found = np.zeros((int(block.t_ns[-1] // bin_ns - block.t_ns[0] // bin_ns) + 1, 10))
    found[:, 0], found[:, 2] = block.segment, bin_s
    return found[: _sum_bins(block.t_ns, bin_ns, block.whole, block.first, found)]


@jit
def _thrust(roll: float, pitch: float) -> tuple[float, float, float]:
    """Where the thrust points; the heading does not matter."""
    cos_roll = math.cos(roll)
    return math.sin(pitch) * cos_roll, -math.sin(roll), math.cos(pitch) * cos_roll


@cached_loop
def _sum_bins(t_ns: IntArray, bin_ns: int, x: FloatArray, first: int, found: FloatArray) -> int:
    """Sums of each bin that has rows; returns how many there are. first: the column of x that the first row is in."""
    place, until_ns, look_ns = -1, 0, 0
    for i in range(len(t_ns)):
        if place < 0 or t_ns[i] >= until_ns:
            place += 1
            found[place, 1] = t_ns[i] // bin_ns
            until_ns = (t_ns[i] // bin_ns + 1) * bin_ns
        k = first + i
        bin_, square, down = found[place], 0.0, x[col.FORCE + 2, k]  # a vehicle that sends the z axis alone has that
        for axis in range(col.FORCE, col.FORCE + 3):
            square += x[axis, k] ** 2 if math.isfinite(x[axis, k]) else 0.0
        bin_[3] += 1.0
        bin_[4] += math.sqrt(x[col.RATE, k] ** 2 + x[col.RATE + 1, k] ** 2)
        bin_[5] += math.sqrt(square) / G if math.isfinite(down) else np.nan
        bin_[6] += down / G
        if t_ns[i] < look_ns:
            continue
        look_ns = (t_ns[i] // LOOK_NS + 1) * LOOK_NS
        north, east, down = _thrust(x[col.ATTITUDE, k], x[col.ATTITUDE + 1, k])
        wanted = _thrust(x[col.LEAN, k], x[col.LEAN + 1, k])
        along = north * wanted[0] + east * wanted[1] + down * wanted[2]
        bin_[7] += 1.0
        bin_[8] += math.acos(min(max(down, -1.0), 1.0)) if down == down else np.nan
        known = along == along and x[col.SETPOINT, k] > 0.5
        bin_[9] += math.acos(min(max(along, -1.0), 1.0)) if known else np.nan
    return place + 1


def upset_in(motions: Iterable[FloatArray]) -> Upset | None:
    """The upset of a flight from its motion, in order of time; None if it has none."""
    motion = np.concatenate([np.empty((0, 10)), *motions])
    if not len(motion):
        return None
    starts = np.flatnonzero(np.any(np.diff(motion[:, :2], axis=0, prepend=-1.0) != 0, axis=1))
    sums = np.add.reduceat(motion[:, 3:], starts, axis=0)
    bin_s, number = motion[starts, 2], motion[starts, 1]
    means = np.hstack((sums[:, 1:4] / sums[:, :1], sums[:, 5:] / np.maximum(sums[:, 4:5], 1.0)))
    unbroken = (np.diff(motion[starts, 0]) == 0) & (np.diff(number) == 1)
    edges = [0, *(np.flatnonzero(~unbroken) + 1).tolist(), len(starts)]
    windows = [
        (number[a:b] * bin_s[a], window_mean(means[a:b], round(SIGN_S / bin_s[a])))
        for a, b in itertools.pairwise(edges)
    ]
    turning = np.concatenate([values[:, 0] for _, values in windows])
    turning = turning[np.isfinite(turning)]
    usual = float(np.quantile(turning, USUAL_SHARE)) if len(turning) else 0.0
    found = sorted(sign for t_s, values in windows for sign in _signs(t_s, values, usual))
    if not found:
        return None
    begin_s, end_s = found[0][0], max(stop for _, stop, _ in found)
    ends = float((number * bin_s)[-1]) < end_s + MARGIN_S + REST_S
    what = "ends in an upset" if ends else "has an upset in it"
    return Upset(begin_s, end_s, ends, f"the flight {what}, at {begin_s:.1f} s: {found[0][2]}")


def _signs(t_s: FloatArray, values: FloatArray, usual: float) -> list[tuple[float, float, str]]:
    """Start, end [s] and words of each spell of a sign, with its greatest value. values: (m, 5) of windows from t_s."""
    turn, size, down, tilt, error = values.T
    signs = (
        (turn, max(TUMBLE_RAD_S, TUMBLE_RATIO * usual), "it turns at {:.1f} rad/s"),
        (-size, -FALL_G, "free fall, specific force {:.2f} g"),
        (down, UPSIDE_DOWN_G, "upside down, specific force {:.1f} g towards the belly"),
        (np.degrees(tilt), math.degrees(TILT_RAD), "tilted by {:.0f} deg"),
        (np.degrees(error), math.degrees(ERROR_RAD), "attitude {:.0f} deg from its set-point"),
    )
    return [
        (float(t_s[first]), float(t_s[stop - 1]) + SIGN_S, text.format(abs(float(value[first:stop].max()))))
        for value, limit, text in signs
        for first, stop in spans(np.asarray(value > limit, dtype=np.bool_))
    ]
