"""Savitzky-Golay filters: smoothing and differentiation on the valid part of a signal (T 4.3, Eq 4.6-4.14).

A polynomial is fitted to each window of 2m + 1 samples; its value, or its slope, at the centre is the output. The
output that belongs to input row i is known m samples later: **the delay is m samples** (50 ms at the default window
of 0.1 s), the same for the value and for the slope, which is why the rate and the differentiated setpoint are both
filtered with one window (T 4.3.4). Rows without a complete window give no output; nothing is padded. Rows are filtered
by running moments in `rows.rates`. numpy only: importing scipy.signal takes 0.8 s.
"""

import math

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray

WINDOW_S = 0.1  # T 5.3: 100 samples at 1 kHz, made odd
MIN_WINDOW = 5  # our floor: fewer samples than this smooth nothing at polynomial order 2


def window_samples(dt_s: float, window_s: float = WINDOW_S) -> int:
    """Odd number of samples, at least 5, that spans about `window_s` at a sample time of `dt_s` [s].

    An even count goes up to the next odd one. A quarter sample of slack in m makes a measured rate of 999 Hz choose
    the same window as 1 kHz.

    >>> [window_samples(dt) for dt in (0.001, 0.004, 0.01, 0.02)]
    [101, 25, 11, 5]

    Raises UsageError if either span is not positive and finite.
    """
    if not (math.isfinite(dt_s) and dt_s > 0 and math.isfinite(window_s) and window_s > 0):
        raise UsageError(f"sample time {dt_s} s and window {window_s} s must be positive")
    m = math.floor(window_s / (2 * dt_s) + 0.25)
    return max(MIN_WINDOW, 2 * m + 1)


def coefficients(window: int, order: int = 2) -> FloatArray:
    """The filter matrix C of T Eq 4.11, shape (order + 1, window): row d gives the polynomial coefficient a_d.

    Row 0 yields the smoothed value, row 1 the slope per sample, 2 x row 2 the second derivative per sample squared
    (T Eq 4.7-4.9). Raises UsageError unless `window` is odd and 0 <= order < window.
    """
    if window < 1 or window % 2 == 0 or not 0 <= order < window:
        raise UsageError(f"window {window} must be odd and longer than the polynomial order {order}")
    m = window // 2
    scale = float(max(m, 1))
    # T Eq 4.10 with x = -m..m over m, so that the columns have like size; row d of C is scaled back by m^d.
    #     [ 1  -m      ...  (-m)^n     ]
    # A = [ 1  -(m-1)  ...  (-(m-1))^n ]    (window, order + 1)
    #     [ ...                        ]
    #     [ 1   m      ...  m^n        ]
    powers = np.arange(order + 1)
    A = (np.arange(-m, m + 1) / scale)[:, None] ** powers
    C: FloatArray = np.linalg.pinv(A) / scale ** powers[:, None]
    return C
