"""Sliding windows of a flight, their spectra, and running means: what several contenders share."""

import numpy as np

from mavdiag.telemetry import FloatArray

__all__ = ["band_powers", "cut", "mean_over"]


def cut(x: FloatArray, length: int, hop: int) -> FloatArray:
    """Windows of (n, c) values: (k, length, c); window i ends at row i hop + length - 1."""
    return np.moveaxis(np.lib.stride_tricks.sliding_window_view(x, length, axis=0)[::hop], -1, 1)


def band_powers(windows: FloatArray, bands: int) -> FloatArray:
    """Log mean power of `bands` equal bands from the first line above zero to Nyquist, (k, length, c) -> (k, bands c).

    Windows lose their mean and are weighted by Hann's window.
    """
    length = windows.shape[1]
    weight = np.hanning(length)[:, None]
    lines = np.abs(np.fft.rfft((windows - windows.mean(axis=1, keepdims=True)) * weight, axis=1)[:, 1:]) ** 2
    edges = np.linspace(0, lines.shape[1], bands + 1).astype(np.int64)[:-1]
    power = np.add.reduceat(lines, edges, axis=1) / np.diff(edges, append=lines.shape[1])[:, None]
    logs: FloatArray = np.log(power + 1e-12)
    return logs.reshape(len(windows), -1)


def mean_over(x: FloatArray, rows: int) -> FloatArray:
    """Mean of each row and the `rows` - 1 before it, (n, ...) -> (n - rows + 1, ...)."""
    total = np.cumsum(x, axis=0)
    total[rows:] = total[rows:] - total[:-rows]
    return np.asarray(total[rows - 1 :] / rows, dtype=np.float64)
