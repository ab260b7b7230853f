"""Long lines made short for a picture: the lowest and the highest value of each column of pixels.

What the eye sees is the same, for a line that crosses a column many times fills it from lowest to highest.
"""

import numpy as np

from mavdiag.telemetry import FloatArray, IntArray

COLUMNS = 480  # of a figure across the page (our choice)
BREAK = 3.0  # a step of more than so many usual ones is a gap in the data (our choice)


def envelope(t: FloatArray, y: FloatArray, columns: int = COLUMNS) -> tuple[FloatArray, FloatArray]:
    """A line of at most two points a column and one for each gap; as it is where it is short already.

    t: (n,) not falling. y: (n,); nan leaves a gap, which stays one if it fills a column. Every value that is returned
    is one of y's, and the lowest and the highest of all y are among them.

    >>> t, y = envelope(np.arange(1000.0), np.tile([0.0, 1.0], 500), columns=4)
    >>> len(t), y.tolist()
    (8, [0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0])
    """
    if len(t) <= 2 * columns:
        return _with_breaks(t, y)
    column, first = columns_of(t, columns)
    low, high = np.fmin.reduceat(y, first), np.fmax.reduceat(y, first)
    last = np.append(first[1:], len(t)) - 1
    falling = y[last] < y[first]  # the order in which the two are drawn, so that slopes look as they are
    pairs = np.stack((np.where(falling, high, low), np.where(falling, low, high)), axis=1)
    times = np.stack((t[first], (t[first] + t[last]) / 2), axis=1)
    empty = np.flatnonzero(np.diff(column[first]) > 1) + 1
    return np.insert(times.ravel(), 2 * empty, times[empty - 1, 1]), np.insert(pairs.ravel(), 2 * empty, np.nan)


def highest(t: FloatArray, y: FloatArray, columns: int = COLUMNS) -> tuple[FloatArray, FloatArray]:
    """The highest value of each column, for what is filled from below; as `envelope`, with half of its points.

    >>> highest(np.arange(1000.0), np.tile([0.0, 1.0], 500), columns=4)[1].tolist()
    [1.0, 1.0, 1.0, 1.0]
    """
    if len(t) <= columns:
        return _with_breaks(t, y)
    column, first = columns_of(t, columns)
    times, high = t[first], np.fmax.reduceat(y, first)
    empty = np.flatnonzero(np.diff(column[first]) > 1) + 1
    return np.insert(times, empty, times[empty - 1]), np.insert(high, empty, np.nan)


def columns_of(t: FloatArray, columns: int) -> tuple[IntArray, IntArray]:
    """The column of each point, (n,), and the first point of each column that has any. t: (n,) not falling, n > 0."""
    span = float(t[-1] - t[0]) or 1.0
    column = np.minimum((t - t[0]) * (columns / span), columns - 1).astype(np.int64)
    return column, np.flatnonzero(np.diff(column, prepend=-1))


def _with_breaks(t: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The line with a nan in each gap, so that none is drawn across it. Times may repeat."""
    steps = np.diff(t)
    if len(t) < 3 or not (steps > 0).any():
        return t, y
    at = np.flatnonzero(steps > BREAK * float(np.median(steps[steps > 0]))) + 1
    return np.insert(t, at, t[at - 1]), np.insert(y, at, np.nan)
