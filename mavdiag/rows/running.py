"""Running figures of compiled loops: means over windows, and exponential ones.

The memory of a loop is one array; each figure has a part of it, from `at` on, zero before the first value. A figure is
a fold over its values, so any cut of them gives the same bits.
"""

from mavdiag.jit import jit, summing
from mavdiag.telemetry import FloatArray

FRESH = 2  # where the next values of a mean are put, before `push`: its part begins with a place and a run


def mean_size(window: int, columns: int) -> int:
    """Length of the part of a mean of so many columns over so many rows."""
    return FRESH + 2 * columns + window * columns


@jit
def push(mem: FloatArray, at: int, window: int, columns: int, good: bool) -> bool:
    """Take the values that were put to `at + FRESH` as a row of a window; a bad row counts as zero.

    Returns whether all rows of the window are there and good. Sums over the window stand behind the values (`total`),
    formed anew each time the window is through, so that what is rounded does not grow.
    """
    sums, ring, place = at + FRESH + columns, at + FRESH + 2 * columns, int(mem[at])
    for column in range(columns):
        value, old = mem[at + FRESH + column] if good else 0.0, ring + column * window + place
        mem[sums + column] += value - mem[old]
        mem[old] = value
    place += 1
    if place == window:
        place = 0
        for column in range(columns):
            mem[sums + column] = _sum(mem[ring + column * window : ring + (column + 1) * window])
    mem[at] = place
    mem[at + 1] = mem[at + 1] + 1.0 if good else 0.0
    return bool(mem[at + 1] >= window)


@summing
def _sum(values: FloatArray) -> float:
    found = 0.0
    for i in range(len(values)):
        found += values[i]
    return found


@jit
def total(mem: FloatArray, at: int, columns: int, column: int) -> float:
    """Sum of a column over the window."""
    return float(mem[at + FRESH + columns + column])


@jit
def follow(mem: FloatArray, at: int, value: float, alpha: float) -> float:
    """Exponential mean s <- s + alpha (value - s); returns the new s."""
    mem[at] += alpha * (value - mem[at])
    return float(mem[at])
