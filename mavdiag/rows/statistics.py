"""Percentiles by a named definition, so that a margin means the same number in every tool."""

from typing import Literal, TypeAlias, get_args

import numpy as np

from mavdiag.errors import InputError, UsageError
from mavdiag.telemetry import FloatArray

__all__ = ["DEFINITIONS", "PercentileDefinition", "percentile"]

PercentileDefinition: TypeAlias = Literal[
    "inverted_cdf",  # 1
    "averaged_inverted_cdf",  # 2
    "closest_observation",  # 3
    "interpolated_inverted_cdf",  # 4
    "hazen",  # 5: MATLAB's and Octave's prctile
    "weibull",  # 6
    "linear",  # 7: numpy's default
    "median_unbiased",  # 8
    "normal_unbiased",  # 9
]

#: The nine definitions of Hyndman and Fan (The American Statistician 50, 1996), in their numbering from 1.
DEFINITIONS: tuple[PercentileDefinition, ...] = get_args(PercentileDefinition)


def percentile(x: FloatArray, q: float, definition: PercentileDefinition = "hazen") -> float:
    """The q-th percentile of all values of x, in the unit of x; 0 <= q <= 100.

    The product uses Hazen's definition everywhere (the i-th of n sorted values is the 100 (i - 1/2)/n percentile),
    since the thesis worked with MATLAB, whose prctile is that.

    >>> percentile(np.array([1.0, 2.0, 3.0, 4.0]), 90)
    4.0
    >>> round(percentile(np.array([1.0, 2.0, 3.0, 4.0]), 90, "linear"), 6)
    3.7

    Raises InputError if x is empty or holds NaN, UsageError if q is outside 0..100 or the definition is unknown.
    """
    if not 0 <= q <= 100:
        raise UsageError(f"a percentile is between 0 and 100, not {q}")
    if definition not in DEFINITIONS:
        raise UsageError(f"percentile definition {definition!r} is not known; use one of {', '.join(DEFINITIONS)}")
    if x.size == 0 or bool(np.isnan(x).any()):
        raise InputError("a percentile needs at least one value and no NaN")
    return float(np.percentile(x, q, method=definition))
