"""Every so many rows: rates with acceleration and thrust, smoothed alike; the rates hold nothing above 8 Hz."""

import math
from dataclasses import dataclass

import numpy as np

from mavdiag.rows.front import Rows
from mavdiag.rows.savgol import coefficients
from mavdiag.rows.windows import windows
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

__all__ = ["Decimated", "Decimator", "DecimatorState", "stride_of"]

PERIOD_S = 0.01  # our choice: ten times what the 0.1 s window passes


@dataclass(frozen=True, slots=True, eq=False)
class Decimated:
    """Every so many rows.

    t_ns: (k,) time of the newest row behind it.
    u, y: (k, 2) roll and pitch rate, commanded and measured [rad/s].
    heave: (k, 2) vertical acceleration [m/s^2] and thrust, filtered alike.
    valid: (k,) rates and acceleration are known.
    """

    t_ns: IntArray
    u: FloatArray
    y: FloatArray
    heave: FloatArray
    valid: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class DecimatorState:
    """Rows that wait.

    skip: rate rows until the next sample.
    raw, raw_ns: (2, h) acceleration and thrust, and (h,) their times.
    rates: (p, 5) u, y and valid of samples without their heave.
    heave, heave_ns: (q, 2) and (q,) of samples without their rates.
    """

    skip: int
    raw: FloatArray
    raw_ns: IntArray
    rates: FloatArray
    heave: FloatArray
    heave_ns: IntArray


def stride_of(dt_s: float) -> int:
    """Rows between two samples at a row period [s]."""
    return max(1, round(PERIOD_S / dt_s))


class Decimator:
    """Takes every `stride`-th of the rates, with acceleration and thrust smoothed by the same `window` (odd)."""

    def __init__(self, stride: int, window: int) -> None:
        self._stride, self._window = stride, window
        self._taps = coefficients(window, min(2, window - 1))[0]

    def start(self) -> DecimatorState:
        """Before the first row of a segment."""
        never = np.empty(0, dtype=np.int64)
        return DecimatorState(0, np.empty((2, 0)), never, np.empty((0, 5)), np.empty((0, 2)), never)

    def step(self, state: DecimatorState, rows: Rows) -> tuple[DecimatorState, Decimated]:
        """Take the next rows; return the samples that they complete."""
        block, rates, stride = rows.block, rows.rates, self._stride
        at = slice(state.skip, None, stride)
        commanded = rates.commanded[at]
        fresh = np.empty((len(commanded), 5), order="F")
        fresh[:, :2], fresh[:, 2:4], fresh[:, 4] = rates.u[at, :2], rates.y[at, :2], commanded
        skip = state.skip + len(commanded) * stride - len(rates)

        waiting = state.raw.shape[1]
        raw = np.empty((2, waiting + len(block)))
        raw[:, :waiting], raw[0, waiting:], raw[1, waiting:] = state.raw, block.force[:, 2], block.thrust
        raw_ns = np.concatenate((state.raw_ns, block.t_ns))
        smoothed = self._smooth(raw)
        count = len(smoothed)
        both, heave = np.concatenate((state.rates, fresh)), np.concatenate((state.heave, smoothed))
        heave_ns = np.concatenate((state.heave_ns, raw_ns[self._window - 1 :: stride][:count]))
        n, used = min(len(both), len(heave)), count * stride
        valid = (both[:n, 4] > 0.5) & np.isfinite(heave[:n, 0])
        if not math.isfinite(float(np.add.reduce(both[:n], axis=None))):
            valid &= np.isfinite(both[:n]).all(axis=1)
        out = Decimated(heave_ns[:n], both[:n, :2], both[:n, 2:4], heave[:n], valid)
        return DecimatorState(skip, raw[:, used:], raw_ns[used:], both[n:], heave[n:], heave_ns[n:]), out

    def _smooth(self, raw: FloatArray) -> FloatArray:
        """(2, h) -> (count, 2): the full windows that begin at rows 0, stride, 2 stride .."""
        window, stride = self._window, self._stride
        if raw.shape[1] < window:
            return np.empty((0, 2))
        base = np.where(np.isfinite(raw[:, :1]), raw[:, :1], 0.0)
        rows = raw - base  # the taps add up to 1; without it a constant would get the rounding of its sums
        # What is unknown spoils the windows that hold it, and no other.
        if stride == 1:
            smooth = np.stack([np.correlate(row, self._taps) for row in rows])
        else:
            smooth = np.einsum("knw,w->kn", windows(rows, window, stride), self._taps)
        return np.asarray((smooth + base).T, dtype=np.float64)
