"""Shares and rates with their 95 % confidence intervals.

share:  Wilson, JASA 22 (1927)
rate:   chi2(0.025, 2k) / 2T  to  chi2(0.975, 2k + 2) / 2T                      Garwood, Biometrika 28 (1936)
"""

from dataclasses import dataclass

__all__ = ["Rate", "Share", "poisson", "wilson"]


@dataclass(frozen=True, slots=True)
class Share:
    """hits of `of`, with the interval of the true share; 0 to 1 if `of` is 0."""

    hits: int
    of: int
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Rate:
    """count in so many hours, and the interval of the true rate [1/h]; without hours it is 0 to infinity (None)."""

    count: int
    hours: float
    low: float
    high: float | None


def wilson(hits: int, of: int) -> Share:
    """The share and its interval.

    >>> one = wilson(8, 10)
    >>> round(one.low, 3), round(one.high, 3)
    (0.49, 0.943)
    """
    if of == 0:
        return Share(0, 0, 0.0, 1.0)
    from scipy.stats import binomtest  # scipy.stats takes a second to load

    interval = binomtest(hits, of).proportion_ci(method="wilson")
    return Share(hits, of, float(interval.low), float(interval.high))


def poisson(count: int, hours: float) -> Rate:
    """The rate's exact interval.

    >>> round(poisson(0, 10.0).high, 3)        # ln(40) / 10
    0.369
    """
    from scipy.stats import chi2

    if hours <= 0.0:
        return Rate(count, 0.0, 0.0, None)
    low = float(chi2.ppf(0.025, 2 * count)) / (2 * hours) if count else 0.0
    return Rate(count, hours, low, float(chi2.ppf(0.975, 2 * count + 2)) / (2 * hours))
