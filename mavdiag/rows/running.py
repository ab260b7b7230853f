"""Running figures of a stream of rows, restartable and independent of how the stream was cut.

Both are folds in the order of the rows, so any chunking gives the same bits. Neither pads: what a window or a memory
has not seen yet counts as zero, and the caller is told which windows are full.
"""

import math
from dataclasses import dataclass

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

__all__ = ["MeanState", "ema", "forgetting", "sliding_mean", "start_mean", "window_rows"]


@dataclass(frozen=True, slots=True, eq=False)
class MeanState:
    """sums: (h, k) running sums up to the last rows, oldest first, h <= window. run: valid rows since the last bad."""

    sums: FloatArray
    run: int


def start_mean(columns: int) -> MeanState:
    """Before the first row."""
    return MeanState(np.zeros((1, columns)), 0)


def window_rows(window_s: float, dt_s: float) -> int:
    """Rows in a window of `window_s` at a period of `dt_s` [s], at least 1. Raises UsageError if one is not positive.

    >>> window_rows(5.0, 0.01)
    500
    """
    if not (math.isfinite(window_s) and window_s > 0 and math.isfinite(dt_s) and dt_s > 0):
        raise UsageError(f"window {window_s} s and sample time {dt_s} s must be positive")
    return max(1, round(window_s / dt_s))


def sliding_mean(
    state: MeanState, x: FloatArray, valid: BoolArray, window: int
) -> tuple[MeanState, FloatArray, BoolArray]:
    """Mean of the last `window` rows at each row: x (n, k), valid (n,) -> mean (n, k), full (n,).

    An invalid row counts as zero; `full` is True where all rows of the window are there and valid, and only there the
    mean means anything.

    >>> state, mean, full = sliding_mean(start_mean(1), np.array([[1.0], [3.0], [5.0]]), np.ones(3, dtype=bool), 2)
    >>> mean[:, 0].tolist(), full.tolist()
    ([0.5, 2.0, 4.0], [False, True, True])
    """
    n = len(x)
    if n == 0:
        return state, np.empty(x.shape), np.empty(0, dtype=np.bool_)
    # sums[h + i] = x[0] + .. + x[i], in that order whatever the chunks; mean[i] = (sums[h + i] - sums[h + i - w]) / w
    fresh = np.cumsum(np.concatenate((state.sums[-1:], np.where(valid[:, None], x, 0.0))), axis=0)[1:]
    sums = np.concatenate((state.sums, fresh))
    before = np.maximum(np.arange(len(sums) - n, len(sums)) - window, 0)
    mean = (fresh - sums[before]) / window
    run = _run_lengths(state.run, valid)
    return MeanState(sums[-window:].copy(), int(run[-1])), mean, run >= window


def _run_lengths(carried: int, valid: BoolArray) -> IntArray:
    """Number of valid rows up to each row without a break, (n,)."""
    at = np.arange(len(valid))
    run: IntArray = at - np.maximum.accumulate(np.where(valid, -1 - carried, at))
    return run


def forgetting(memory_s: float, dt_s: float) -> float:
    """The factor alpha of an exponential mean with a time constant of `memory_s`: 1 - exp(-dt/memory)."""
    return -math.expm1(-dt_s / memory_s)


def ema(state: FloatArray, x: FloatArray, alpha: float) -> tuple[FloatArray, FloatArray]:
    """Exponential mean s(t) = s(t-1) + alpha (x(t) - s(t-1)): state (k,), x (n, k) -> state (k,), s (n, k).

    Begin with zeros. About 0.1 us a value.
    """
    out = np.empty(x.shape)
    last = state.tolist()
    for column, values in enumerate(x.T.tolist()):
        s, trace = last[column], []
        for value in values:
            s += alpha * (value - s)
            trace.append(s)
        out[:, column], last[column] = trace, s
    return np.array(last), out
