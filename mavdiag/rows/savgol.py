"""Savitzky-Golay filters (T 4.3, Eq 4.6-4.14): a polynomial fitted to each window of 2m + 1 samples, at its centre.

Value and slope of input row i are known m samples later. Rows without a complete window give no output.
"""

import math

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray

WINDOW_S = 0.1  # T 5.3: 100 samples at 1 kHz, made odd
MIN_WINDOW = 5  # our floor: fewer samples than this smooth nothing at polynomial order 2


def window_samples(dt_s: float, window_s: float = WINDOW_S) -> int:
    """Odd number of samples, at least 5, that spans about `window_s` at a sample time of `dt_s` [s].

    A quarter sample of slack makes 999 Hz choose as 1 kHz. Raises UsageError unless 0 < dt_s and 0 < window_s <= 10.

    >>> [window_samples(dt) for dt in (0.001, 0.004, 0.01, 0.02)]
    [101, 25, 11, 5]
    """
    if not (math.isfinite(dt_s) and dt_s > 0 and 0 < window_s <= 10):
        raise UsageError(f"sample time {dt_s} s and window {window_s} s must be positive, the window at most 10 s")
    return max(MIN_WINDOW, 2 * math.floor(window_s / (2 * dt_s) + 0.25) + 1)


def coefficients(window: int, order: int = 2) -> FloatArray:
    """The filter matrix C of T Eq 4.11, (order + 1, window): row d gives the coefficient a_d of the polynomial.

    Raises UsageError unless `window` is odd and 0 <= order < window.
    """
    if window < 1 or window % 2 == 0 or not 0 <= order < window:
        raise UsageError(f"window {window} must be odd and longer than the polynomial order {order}")
    m, powers = window // 2, np.arange(order + 1)
    scale = float(max(m, 1))  # A of T Eq 4.10 with x = -m..m over m; row d of C is scaled back by m^d
    A = (np.arange(-m, m + 1) / scale)[:, None] ** powers
    C: FloatArray = np.linalg.pinv(A) / scale ** powers[:, None]
    return C
