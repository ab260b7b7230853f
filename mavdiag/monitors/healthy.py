"""What the fits to healthy flights share: which rows they take, and how large a residual may be (METHOD section 4)."""

from collections.abc import Sequence

import numpy as np

from mavdiag.telemetry import FloatArray, Three

__all__ = ["LIMIT", "MEMORY_S", "Three", "cut_to_share", "three", "variance_law"]

MEMORY_S = 0.35  # of the mean square of the command (METHOD section 4)
MIN_SHARE = 0.05  # of the mean square, left to k0 however busy the set-point (our choice)
LIMIT = 1e6  # healthy rms; a normalised residual is cut here (our choice)


def three(values: Sequence[float] | FloatArray) -> Three:
    """Three numbers as a tuple of plain floats."""
    first, second, third = (float(x) for x in values)
    return first, second, third


def cut_to_share(lengths: Sequence[int], most: int, least: int = 1) -> list[int]:
    """How many rows to take of pieces of these lengths, `most` in all: the same share of each, at least `least` rows.

    So every flight counts, and a fit of a type is not one of its first vehicle.

    >>> cut_to_share([100, 300], 200), cut_to_share([100, 300], 1000), cut_to_share([100, 300], 200, least=80)
    ([50, 150], [100, 300], [80, 150])
    """
    share = min(1.0, most / max(1, sum(lengths)))
    return [min(length, max(least, round(share * length))) for length in lengths]


def variance_law(squares: FloatArray, busy: FloatArray) -> tuple[float, float]:
    """k0 and k1 >= 0 of r^2 = k0 + k1 busy, (n,) each, by non-negative least squares; k0 at least 5 % of mean(r^2).

    >>> busy = np.array([0.0, 1.0, 2.0, 3.0])
    >>> [round(k, 6) for k in variance_law(1.0 + 0.5 * busy, busy)]
    [1.0, 0.5]
    """
    mean, size = float(squares.mean()), float(busy.mean())
    if size == 0.0:
        return mean, 0.0
    # [ n      sum x   ] [ k0 ]   [ sum r^2   ]      x = busy/mean(busy). Two unknowns: if one comes out negative, it is
    # [ sum x  sum x^2 ] [ k1 ] = [ sum x r^2 ]      zero and the other is its own least-squares solution.
    x = busy / size
    spread = float(np.mean(x * x)) - 1.0
    k1 = (float(np.mean(x * squares)) - mean) / spread if spread > 0 else 0.0
    if k1 <= 0:
        return mean, 0.0
    k0 = mean - k1
    if k0 < 0:
        k0, k1 = 0.0, float(np.mean(x * squares) / np.mean(x * x))
    return max(k0, MIN_SHARE * mean), k1 / size
