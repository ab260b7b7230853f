"""Windows over arrays, where a NaN spoils its own windows alone, and a high-pass. Streams: `rows.running`."""

import math
from functools import lru_cache

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

BETA = 4.0  # of the Kaiser window: 45 dB of stop band (our choice)


@lru_cache(maxsize=64)  # a display asks for it in every step
def highpass(corner: float, taps: int) -> FloatArray:
    """Linear-phase high-pass, (taps,), corner as a share of the sample rate; windowed sinc, unit gain at half the rate.

    Its delay is (taps - 1)/2 samples. Read-only. Raises UsageError unless taps is odd, above 2 and 0 < corner < 0.5.
    """
    if taps < 3 or taps % 2 == 0 or not 0.0 < corner < 0.5:
        raise UsageError(
            f"a high-pass needs an odd number of taps and a corner below half the rate, not {taps}, {corner}"
        )
    k = np.arange(taps) - taps // 2
    low = 2 * corner * np.sinc(2 * corner * k) * np.kaiser(taps, BETA)
    high = -low / low.sum()
    high[taps // 2] += 1.0
    found = np.asarray(high / (high @ (-1.0) ** k), dtype=np.float64)
    found.setflags(write=False)
    return found


def window_mean(x: FloatArray, window: int) -> FloatArray:
    """Mean over each full window of rows, (n, k) -> (n - window + 1, k), none if there are fewer rows than that."""
    known, columns = max(0, len(x) - window + 1), x.shape[1]
    if known == 0:
        return np.empty((0, columns))
    # Each window is the end of one stretch of `window` rows and the begin of the next one.
    stretches = np.zeros((columns, -(-len(x) // window), window))
    stretches.reshape(columns, -1)[:, : len(x)] = x.T
    ends = np.empty(stretches.shape)
    np.add.accumulate(stretches[:, :, ::-1], axis=2, out=ends[:, :, ::-1])
    begins = np.add.accumulate(stretches, axis=2, out=stretches).reshape(columns, -1)[:, window - 1 :]
    begins[:, ::window] = 0.0  # these windows are whole stretches
    out = ends.reshape(columns, -1)[:, :known]
    out += begins[:, :known]
    out /= window
    return out.T


def means_from(values: FloatArray, starts: IntArray, window: int) -> FloatArray:
    """Means over the windows that begin at some rows, (k, n) -> (k, starts); one with a NaN is NaN."""
    if not len(starts):
        return np.empty((len(values), 0))
    windows = np.lib.stride_tricks.sliding_window_view(values, window, axis=1)
    return np.asarray(windows[:, starts].mean(axis=2), dtype=np.float64)


def window_all(flags: BoolArray, window: int) -> BoolArray:
    """Whether each full window of flags is True throughout, (n,) -> (n - window + 1,)."""
    bad = np.concatenate(([0], np.cumsum(~flags)))
    return np.asarray(bad[window:] == bad[: max(0, len(flags) - window + 1)], dtype=np.bool_)


def spans(flags: BoolArray) -> list[tuple[int, int]]:
    """Half-open spans [first, stop) of True, (n,).

    >>> spans(np.array([True, False, True, True]))
    [(0, 1), (2, 4)]
    """
    edges = np.flatnonzero(np.diff(flags, prepend=False, append=False))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


@lru_cache(maxsize=64)
def window_rows(window_s: float, dt_s: float) -> int:
    """Rows in a window at a sample time [s], at least 1. Raises UsageError if one is not positive."""
    if not (math.isfinite(window_s) and window_s > 0 and math.isfinite(dt_s) and dt_s > 0):
        raise UsageError(f"window {window_s} s and sample time {dt_s} s must be positive")
    return max(1, round(window_s / dt_s))


@lru_cache(maxsize=64)
def forgetting(memory_s: float, dt_s: float) -> float:
    """The factor alpha of an exponential mean with a time constant of `memory_s`: 1 - exp(-dt/memory)."""
    return -math.expm1(-dt_s / memory_s)
