"""By how much the rates of two gyro streams may differ before their rows are those of two systems."""

import math

from mavdiag.rows.align import Grid

__all__ = ["NATIVE_TOLERANCE", "rate_tolerance"]

NATIVE_TOLERANCE = 0.02  # of the row period: the poles of a model shift by as much (our choice)
ATTENUATION = 0.01  # change of a gain within the pass band that a fit does not notice (our choice)
WIDEST = 0.2  # of the period; beyond it the noise above the pass band differs, too (our choice)


def rate_tolerance(grid: Grid, dt_s: float, window_s: float) -> float:
    """Greatest relative difference of mean gyro periods that a model of rows bears.

    Native rows are the samples themselves. A model that takes its rows for dt apart while they are (1 + d) dt apart has
    each pole z = exp(s dt) at s/(1 + d): its frequencies and damping rates are wrong by the share d, so d is at most
    2 %. Resampled rows have one period whatever the samples have. What is left is linear interpolation, which passes
    sinc(f T)^2 of a sine of frequency f between samples T apart, about 1 - (pi f T)^2/3. A period of (1 + d) T changes
    this by 2/3 (pi f T)^2 d, which may reach 1 % at the corner of the Savitzky-Golay filter: about 1/window for order 2
    (R. W. Schafer, IEEE Signal Processing Magazine 28(4), 2011, Eq 5, 3/(1.6 n) of half the rate for n samples).

    dt_s: row period [s]. window_s: length of the Savitzky-Golay filter [s].

    >>> [round(rate_tolerance(Grid.RESAMPLED, dt_s, 0.1), 3) for dt_s in (0.02, 0.01, 0.004)]
    [0.038, 0.152, 0.2]
    >>> rate_tolerance(Grid.NATIVE, 0.01, 0.1)
    0.02
    """
    if grid is Grid.NATIVE:
        return NATIVE_TOLERANCE
    loss = 2.0 / 3.0 * (math.pi * dt_s / max(window_s, dt_s)) ** 2
    return min(WIDEST, max(NATIVE_TOLERANCE, ATTENUATION / loss))
