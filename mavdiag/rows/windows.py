"""Sliding windows and a high-pass whose every output depends on its own window alone.

So a stream that is cut anywhere gives the same figures, and a NaN spoils the windows that hold it and no other. numpy
only: importing scipy.signal takes 0.8 s.
"""

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import BoolArray, FloatArray

__all__ = ["highpass", "spans", "window_all", "window_mean"]

BETA = 4.0  # of the Kaiser window: 45 dB of stop band (our choice)


def highpass(corner: float, taps: int) -> FloatArray:
    """Linear-phase high-pass, (taps,), corner as a share of the sample rate; windowed sinc, unit gain at half the rate.

    Its delay is (taps - 1)/2 samples; a constant does not pass. Raises UsageError unless taps is odd and above 2 and
    0 < corner < 0.5.

    >>> taps = highpass(0.06, 61)
    >>> gain = abs(np.exp(-2j * np.pi * np.outer([0.0, 0.03, 0.06, 0.1, 0.167], np.arange(61))) @ taps)
    >>> gain.round(2).tolist()
    [0.0, 0.0, 0.5, 1.0, 1.0]
    """
    if taps < 3 or taps % 2 == 0 or not 0.0 < corner < 0.5:
        raise UsageError(
            f"a high-pass needs an odd number of taps and a corner below half the rate, not {taps}, {corner}"
        )
    k = np.arange(taps) - taps // 2
    low = 2 * corner * np.sinc(2 * corner * k) * np.kaiser(taps, BETA)
    high = -low / low.sum()
    high[taps // 2] += 1.0
    return np.asarray(high / (high @ (-1.0) ** k), dtype=np.float64)


def window_mean(x: FloatArray, window: int) -> FloatArray:
    """Mean over each full window of rows, (n, k) -> (n - window + 1, k), none if there are fewer rows than that.

    >>> window_mean(np.array([[1.0], [3.0], [5.0]]), 2)[:, 0].tolist()
    [2.0, 4.0]
    """
    known = max(0, len(x) - window + 1)
    out = np.empty((known, x.shape[1]))
    if known:
        ones = np.ones(window)
        for column in range(x.shape[1]):
            out[:, column] = np.correlate(np.ascontiguousarray(x[:, column]), ones)  # mode "valid"
        out /= window
    return out


def window_all(flags: BoolArray, window: int) -> BoolArray:
    """Whether each full window of flags is True throughout, (n,) -> (n - window + 1,)."""
    known = max(0, len(flags) - window + 1)
    if known == 0 or flags.all():
        return np.ones(known, dtype=np.bool_)
    bad = np.concatenate(([0], np.cumsum(~flags)))
    whole: BoolArray = bad[window:] == bad[:known]
    return whole


def spans(flags: BoolArray) -> list[tuple[int, int]]:
    """Half-open spans [first, stop) of True, (n,).

    >>> spans(np.array([True, False, True, True]))
    [(0, 1), (2, 4)]
    """
    edges = np.flatnonzero(np.diff(flags, prepend=False, append=False))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
