"""Under which conditions a vehicle flies, ten times a second: what the envelope of a baseline is made of.

A condition is measured from commands and slow signals, not from what the monitors judge, so that a damaged rotor does
not move it. One that the link does not carry is nan and restricts nothing. The figures follow from whole bins of 0.1 s
of the vehicle's clock, so any cut of the rows into chunks gives the same ones.

    yaw rate = min(|r|, max over 2 s of |d psi/dt|)      r: gyro, mean of the bin;  psi: commanded heading, over 0.1 s

Some autopilots step the commanded heading (PX4 offboard), and the vehicle turns there as fast as it can: r tells how
fast. A damaged rotor may yaw the vehicle: that is no condition, and psi, which the rotor does not move, limits it.
Where the link carries no commanded heading, r counts alone.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mavdiag.rows.front import Rows
from mavdiag.rows.windows import window_sums
from mavdiag.telemetry import BoolArray, FloatArray, IntArray
from mavdiag.units import NS_PER_S

__all__ = ["BIN_S", "Condition", "ConditionState", "Conditions", "measure", "start_conditions"]

BIN_S = 0.1  # our choice
TILT_BINS = 50  # 5 s: longer than a manoeuvre of a hall, shorter than a change of the wind (our choice)
TURN_BINS = 20  # 2 s: so long may a vehicle turn after a step of its commanded heading (our choice)
_BIN_NS = round(BIN_S * NS_PER_S)


class Condition(StrEnum):
    """What is watched. The comment gives its unit and how a bin has it."""

    TILT = "tilt"  # rad, of the mean commanded roll and pitch of 5 s: steady wind, or a steady acceleration
    THROTTLE = "throttle"  # 0..1, mean collective set-point
    COMMANDED_RATE = "commanded rate"  # rad/s, largest of roll and pitch
    COMMANDED_ACCELERATION = "commanded angular acceleration"  # rad/s^2, of roll and pitch, over 0.1 s
    YAW_RATE = "yaw rate"  # rad/s, mean measured one, and not more than the heading was commanded to move in 2 s
    HEIGHT = "height"  # m above take-off, least


COUNT = len(Condition)


@dataclass(frozen=True, slots=True, eq=False)
class Conditions:
    """Whole bins. end_ns: (n,) where they end. values: (n, COUNT) in the order of `Condition`; nan where unknown."""

    end_ns: IntArray
    values: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ConditionState:
    """Memory.

    block_ns, block: (h,) and (6, h) rows of an unfinished bin: roll and pitch set-point, thrust, measured yaw rate,
        height and yaw set-point.
    rates_ns, rates: (h,) and (2, h) commanded roll and pitch rate.
    past: (w, 3) of the last bins: mean roll and pitch set-point, and slope of the yaw set-point.
    last: (3,) commanded roll and pitch rate and yaw set-point at the end of the last bin.
    """

    block_ns: IntArray
    block: FloatArray
    rates_ns: IntArray
    rates: FloatArray
    past: FloatArray
    last: FloatArray


def start_conditions() -> ConditionState:
    """Before the first row of a segment."""
    never = np.empty(0, dtype=np.int64)
    return ConditionState(never, np.empty((6, 0)), never, np.empty((2, 0)), np.empty((0, 3)), np.full(3, np.nan))


def measure(state: ConditionState, rows: Rows) -> tuple[ConditionState, Conditions]:
    """The bins that the next rows of the same segment complete."""
    block_ns = np.concatenate((state.block_ns, rows.block.t_ns))
    block = np.concatenate((state.block, _block(rows)), axis=1)
    rates_ns = np.concatenate((state.rates_ns, rows.rates.t_ns))
    rates = np.concatenate((state.rates, _rates(rows)), axis=1)
    until_ns = 0 if len(rates_ns) == 0 else int(rates_ns[-1]) // _BIN_NS * _BIN_NS
    m, n = int(rates_ns.searchsorted(until_ns)), int(block_ns.searchsorted(until_ns))
    if m == 0 or n == 0:
        return ConditionState(block_ns, block, rates_ns, rates, state.past, state.last), _NOTHING
    end_ns, starts = _bins(rates_ns[:m])
    # A bin of the rates has rows of the block too, since each rate row is one of theirs, half a window earlier.
    at = block_ns[:n].searchsorted(end_ns - _BIN_NS)
    mean = _means(block[:4, :n], at).T
    values = np.full((len(end_ns), COUNT), np.nan)
    values[:, 1] = mean[:, 2]
    values[:, 2] = np.fmax.reduceat(np.abs(rates[:, :m]), starts, axis=1).max(axis=0)
    values[:, 5] = np.fmin.reduceat(block[4, :n], at)
    edge = np.empty((len(end_ns), 3))
    edge[:-1, :2], edge[-1, :2] = rates[:, starts[1:] - 1].T, rates[:, m - 1]
    edge[:-1, 2], edge[-1, 2] = block[5, at[1:] - 1], block[5, n - 1]
    steps = edge.copy()
    steps[0] -= state.last
    steps[1:] -= edge[:-1]
    steps = np.abs(steps) / BIN_S
    values[:, 3] = np.fmax(steps[:, 0], steps[:, 1])
    past = np.concatenate((state.past, np.column_stack((mean[:, :2], steps[:, 2]))))
    values[:, 0] = _tilt(past[:, :2], len(end_ns))
    values[:, 4] = np.minimum(np.abs(mean[:, 3]), _most_turn(past[:, 2], len(end_ns)))
    state = ConditionState(block_ns[n:], block[:, n:], rates_ns[m:], rates[:, m:], past[-TILT_BINS:], edge[-1])
    return state, Conditions(end_ns, values)


_NOTHING = Conditions(np.empty(0, dtype=np.int64), np.empty((0, COUNT)))


def _block(rows: Rows) -> FloatArray:
    block = rows.block
    out = np.empty((6, len(block)))
    out[:2], out[5] = block.setpoint.T[:2], block.setpoint[:, 2]
    out[2], out[3], out[4] = block.thrust, block.rate[:, 2], block.height
    if np.count_nonzero(block.setpoint_valid) < len(block):
        unknown = ~block.setpoint_valid
        out[:2, unknown], out[5, unknown] = np.nan, np.nan
    if np.count_nonzero(block.valid) < len(block):
        out[:, ~block.valid] = np.nan
    return out


def _rates(rows: Rows) -> FloatArray:
    rates = rows.rates
    if np.count_nonzero(rates.commanded) == len(rates):
        return rates.u.T[:2]
    return np.where(rates.commanded, rates.u.T[:2], np.nan)


def _bins(t_ns: IntArray) -> tuple[IntArray, IntArray]:
    """Where the bins of rows end [ns], and their first rows."""
    first, last = int(t_ns[0]) // _BIN_NS, int(t_ns[-1]) // _BIN_NS
    if first == last:  # the usual case of a live link
        return np.array([(first + 1) * _BIN_NS]), np.zeros(1, dtype=np.int64)
    number = t_ns // _BIN_NS
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    return (number[starts] + 1) * _BIN_NS, starts


def _means(values: FloatArray, starts: IntArray) -> FloatArray:
    """Means of the finite values of each row of (k, n) from each start to the next, nan where there is none."""
    if math.isfinite(float(np.add.reduce(values, axis=None))):
        counts = np.diff(starts, append=values.shape[1]) if len(starts) > 1 else values.shape[1]
        return np.asarray(np.add.reduceat(values, starts, axis=1) / counts, dtype=np.float64)
    known: BoolArray = np.isfinite(values)
    sums = np.add.reduceat(np.where(known, values, 0.0), starts, axis=1)
    number = np.add.reduceat(known.astype(np.float64), starts, axis=1)
    means: FloatArray = np.divide(sums, number, out=np.full(sums.shape, np.nan), where=number > 0)
    return means


def _tilt(setpoints: FloatArray, fresh: int) -> FloatArray:
    """Tilt of the mean set-point over 5 s, for the last `fresh` bins; nan before there are 5 s."""
    out = np.full(fresh, np.nan)
    first = max(0, TILT_BINS - 1 - (len(setpoints) - fresh))  # of the fresh ones that has so many behind it
    if first < fresh:
        mean = window_sums(setpoints[len(setpoints) - fresh + first + 1 - TILT_BINS :], TILT_BINS) / TILT_BINS
        out[first:] = np.hypot(mean[:, 0], mean[:, 1])
    return out


def _most_turn(slopes: FloatArray, fresh: int) -> FloatArray:
    """Largest known slope of the yaw set-point over 2 s, for the last `fresh` bins; infinite where none is known."""
    behind = np.concatenate((np.full(TURN_BINS, np.nan), slopes))[-(fresh + TURN_BINS - 1) :]
    largest: FloatArray = np.fmax.reduce(np.lib.stride_tricks.sliding_window_view(behind, TURN_BINS), axis=1)
    return np.where(np.isnan(largest), np.inf, largest)
