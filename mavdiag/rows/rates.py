"""From aligned rows to the pair that the model relates: commanded rate u and measured rate y (T 4.3.4).

The commanded attitude is differentiated and the gyro smoothed by Savitzky-Golay filters of the same window and order,
so both have the same delay of m samples. Output row i belongs to input row i + m; a new segment starts the filters
afresh. A row is valid only if its whole window was.
"""

from dataclasses import dataclass

import numpy as np

from mavdiag.rows.block import Block
from mavdiag.rows.savgol import SavgolFilter, SavgolState
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

__all__ = ["RateBlock", "RateSpec", "RateState", "rates", "start"]


@dataclass(frozen=True, slots=True, eq=False)
class RateBlock:
    """Consecutive rows of one segment: u, y: (n, 3) commanded and measured roll, pitch, yaw rate [rad/s]."""

    segment: int
    dt_s: float
    t_ns: IntArray
    u: FloatArray
    y: FloatArray
    valid: BoolArray

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True, eq=False)
class RateSpec:
    """The two filters, of one window and order; build it with `RateSpec.of`."""

    window: int
    slope: SavgolFilter
    value: SavgolFilter

    @classmethod
    def of(cls, dt_s: float, window: int, order: int = 2) -> "RateSpec":
        """Filters for a sample time [s], an odd window [samples] and a polynomial order. Raises UsageError."""
        slope = SavgolFilter.differentiator(window, dt_s, order)
        return cls(window, slope, SavgolFilter.smoother(window, order))


@dataclass(frozen=True, slots=True, eq=False)
class RateState:
    """Filter histories, and the times and validity of the rows that wait for the rest of their window."""

    segment: int
    setpoint: SavgolState
    gyro: SavgolState
    angle: FloatArray  # (3,) last set-point, to unwrap the next
    t_ns: IntArray
    valid: BoolArray


def start(spec: RateSpec, segment: int = -1) -> RateState:
    """A fresh state, before the first row of a segment."""
    return RateState(
        segment,
        spec.slope.start(3),
        spec.value.start(3),
        np.full(3, np.nan),
        np.empty(0, dtype=np.int64),
        np.empty(0, dtype=np.bool_),
    )


def rates(spec: RateSpec, state: RateState, block: Block) -> tuple[RateState, RateBlock]:
    """Take the next rows; return those whose window is complete."""
    if block.segment != state.segment:
        state = start(spec, block.segment)
    angle = _unwrap(state.angle, block.setpoint)
    setpoint, u = spec.slope.step(state.setpoint, angle)
    gyro, y = spec.value.step(state.gyro, block.rate)
    t_ns = np.concatenate((state.t_ns, block.t_ns))
    valid = np.concatenate((state.valid, block.valid))
    m, known = spec.window // 2, len(u)
    out = RateBlock(block.segment, block.dt_s, t_ns[m : m + known], u, y, _whole(valid, spec.window, known))
    return RateState(block.segment, setpoint, gyro, angle[-1], t_ns[known:], valid[known:]), out


def _unwrap(last: FloatArray, angle: FloatArray) -> FloatArray:
    """Angles without jumps of 2 pi, continuing from `last` (nan at a start)."""
    rows = angle if np.isnan(last[0]) else np.concatenate((last[None], angle))
    # np.unwrap costs more than the filter itself, and a jump is rare. A continued row may already be off by 2 pi n.
    if len(rows) > 1 and np.abs(rows[1:] - rows[:-1]).max() > np.pi:
        rows = np.unwrap(rows, axis=0)
    return rows[len(rows) - len(angle) :]


def _whole(valid: BoolArray, window: int, known: int) -> BoolArray:
    """Which of the `known` windows hold valid rows only."""
    if valid.all():
        return np.ones(known, dtype=np.bool_)
    bad = np.concatenate(([0], np.cumsum(~valid)))
    whole: BoolArray = bad[window : window + known] == bad[:known]
    return whole
