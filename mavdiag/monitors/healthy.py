"""What the fits to healthy flights share: which rows they take, and how large a residual may be (METHOD section 4)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.telemetry import FloatArray, Three

MEMORY_S = 0.35  # of the mean square of the command (METHOD section 4)
MIN_SHARE = 0.05  # of the mean square, left to k0 however busy the set-point (our choice)
# Healthy rms; what is larger counts only where more rows have it than a glitch spoils. A Gaussian residual reaches it
# in years (our choice).
LIMIT, MOST = 6.0, 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Of rows of k columns. count: how many there are. mean: (k,). squares: (k,) sum of squares about the mean."""

    count: int
    mean: FloatArray
    squares: FloatArray

    def about(self, centre: FloatArray) -> FloatArray:
        """Mean square about another centre, (k,)."""
        return np.asarray(self.squares / self.count + np.square(self.mean - centre), dtype=np.float64)


def moments(rows: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Number, mean and squares about the mean of rows, (n, k) -> (1,), (k,), (k,): a part of a summary."""
    if len(rows) == 0:
        return np.zeros(1), np.zeros(rows.shape[1]), np.zeros(rows.shape[1])
    mean = rows.mean(axis=0)
    return np.array([float(len(rows))]), mean, np.square(rows - mean).sum(axis=0)


def joined_moments(parts: Sequence[Sequence[FloatArray]]) -> Moments:
    """Moments of the rows of all parts together, each as `moments` gives it, one of which at least has rows.

    >>> x = np.arange(10.0)[:, None]
    >>> found = joined_moments([moments(x[:3]), moments(x[3:])])
    >>> found.count, found.mean.tolist(), found.squares.tolist()
    (10, [4.5], [82.5])
    """
    counts = np.array([part[0][0] for part in parts])[:, None]
    means = np.stack([part[1] for part in parts])
    total = float(counts.sum())
    mean = (counts * means).sum(axis=0) / total
    squares = np.stack([part[2] for part in parts]).sum(axis=0) + (counts * np.square(means - mean)).sum(axis=0)
    return Moments(int(total), mean, squares)


def smoothed(x: FloatArray, alpha: float, start: FloatArray | None = None) -> FloatArray:
    """The exponential mean of whole records, (n, k) -> (n, k), from `start`, (k,), or zeros: `rows.windows.ema`."""
    from scipy.signal import lfilter  # 0.8 s to import: only offline work pays it

    if len(x) == 0:
        return x
    before = np.zeros(x.shape[1]) if start is None else start
    out, _ = lfilter([alpha], [1.0, alpha - 1.0], x, axis=0, zi=(1.0 - alpha) * before[None])
    return np.asarray(out, dtype=np.float64)


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
    products = (busy * busy, busy * squares)
    return variance_law_of(float(squares.mean()), float(busy.mean()), *(float(one.mean()) for one in products))


def variance_law_of(mean: float, size: float, square: float, product: float) -> tuple[float, float]:
    """As `variance_law`, from the means of r^2, busy, busy^2 and busy r^2."""
    if size == 0.0:
        return mean, 0.0
    # [ n      sum x   ] [ k0 ]   [ sum r^2   ]      x = busy/mean(busy). Two unknowns: if one comes out negative, it is
    # [ sum x  sum x^2 ] [ k1 ] = [ sum x r^2 ]      zero and the other is its own least-squares solution.
    square, product = square / size**2, product / size
    spread = square - 1.0
    k1 = (product - mean) / spread if spread > 0 else 0.0
    if k1 <= 0:
        return mean, 0.0
    k0 = mean - k1
    if k0 < 0:
        k0, k1 = 0.0, product / square
    return max(k0, MIN_SHARE * mean), k1 / size
