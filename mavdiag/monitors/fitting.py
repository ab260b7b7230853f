"""What fits to healthy flights share: answers that a flight keeps, traces, and how large a residual may be."""

from collections.abc import Callable, Hashable, Sequence
from typing import Any, TypeVar

import numpy as np

from mavdiag.errors import InputError
from mavdiag.identify.arx import filtered
from mavdiag.jit import cached
from mavdiag.monitors.base import Flights, Monitor, walk
from mavdiag.rows.block import TRACE
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray, Three
from mavdiag.thresholds.heldout import Looks

MEMORY_S = 0.35  # of the mean square of the command (METHOD section 4)
REST_SHARE = 0.003  # of rows, believed at rest beside those that are flown (our choice)
MIN_SHARE = 0.05  # of the mean square, left to k0 however busy the set-point (our choice)
SCORINGS, RANK = 4, 1e-12  # of the variance law; from where on its two columns differ (our choices)
Found = TypeVar("Found")


def of_each(flights: Flights, key: Hashable, find: Callable[[Sequence[Rows]], Found]) -> list[Found]:
    """What `find` gives of each flight, from memory where the flight keeps it. key: of all that it depends on."""
    return [flight.once(key, find) if isinstance(flight, Looks) else find(flight) for flight in flights]


def need_commanded(flights: Flights) -> None:
    """Raises InputError if no flight has rows whose gyro and set-point may be compared."""
    if not any(of_each(flights, "commanded", lambda flight: any(rows.rates.commanded.any() for rows in flight))):
        raise InputError("no flight with a gyro and an attitude set-point")


def traced(monitor: Monitor[Any], flight: Sequence[Rows], more: int) -> FloatArray:
    """What `run` writes of a flight, with so many inner figures, (4 + more, k)."""
    pieces = (out for ((_, out),) in walk([monitor], flight, more))
    return np.concatenate([np.empty((TRACE + more, 0)), *pieces], axis=1)


def smoothed(x: FloatArray, alpha: float, start: FloatArray | None = None) -> FloatArray:
    """The exponential mean of whole records, (n, k) -> (n, k), from `start`, (k,), or zeros: `rows.running.follow`."""
    begun = np.zeros((2, x.shape[1]))
    begun[0] = 0.0 if start is None else (1.0 - alpha) * start
    return filtered(np.array([alpha, 0.0]), np.array([1.0, alpha - 1.0]), np.ascontiguousarray(x), begun)


def three(values: Sequence[float] | FloatArray) -> Three:
    """Three numbers as a tuple of plain floats."""
    first, second, third = (float(x) for x in values)
    return first, second, third


def cut_to_share(lengths: Sequence[int], most: int, least: int = 1) -> list[int]:
    """How many rows to take of pieces of these lengths, `most` in all: the same share of each, at least `least` rows.

    >>> cut_to_share([100, 300], 200), cut_to_share([100, 300], 200, least=80)
    ([50, 150], [80, 150])
    """
    share = min(1.0, most / max(1, sum(lengths)))
    return [min(length, max(least, round(share * length))) for length in lengths]


def held_law(
    y: FloatArray, x: FloatArray, prior: FloatArray, covariance: FloatArray, floor: float, window: int, held: float = 0
) -> tuple[FloatArray, FloatArray]:
    """b of y = x b, (n,) and (n, k), by least squares with a prior, (k,) and (k, k); and its covariance, (k, k).

    floor: the least noise that is believed. window: how many ticks count as one. held: see `updated`.
    """
    law, P = prior, covariance
    for _ in range(3):  # the noise is what the law before leaves
        noise = max(float(np.square(y - x @ law).sum()) / max(len(y), 1), floor**2) * window
        law, P = updated(prior, covariance, y, x, noise, held)
    return law, P


def updated(
    prior: FloatArray, covariance: FloatArray, y: FloatArray, x: FloatArray, noise: float, held: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of b after y = x b, (n,) and (n, k), with so much noise (variance).

    held: rms of what may go with any column of x in all rows: they tell b + c, c ~ N(0, D), D = held^2/mean(x^2), with
    the information I = x'x/noise, so b with (I^-1 + D)^-1 = (1 + I D)^-1 I.
    """
    trust, told = np.linalg.inv(covariance), x.T @ x / noise
    squares = np.square(x).sum(axis=0)
    D = np.divide(held**2 * len(x), squares, out=np.zeros(len(prior)), where=squares > 0.0)
    share = np.linalg.inv(np.eye(len(prior)) + told * D)
    P = np.asarray(np.linalg.inv(share @ told + trust), dtype=np.float64)
    return P @ (share @ (x.T @ y / noise) + trust @ prior), P


@cached
def variance_law(squares: FloatArray, busy: FloatArray) -> tuple[float, float]:
    """k0 and k1 >= 0 of var(r) = k0 + k1 busy, (n,) each, by maximum likelihood of Gaussian r.

    Fisher scoring: least squares of r^2, weighted by 1/var^2 of the law before. k0 is at least 5 % of mean(r^2). Of
    1,000 rows 3 more are believed at rest, with that mean, for flight at one rate does not tell k0 from k1.
    """
    mean, size, k1 = squares.mean(), busy.mean(), 0.0
    if size == 0.0:
        return mean, k1
    k0, rest = mean, REST_SHARE * len(busy)
    for _ in range(SCORINGS):
        # [ sum w    sum w x   ] [ k0 ]   [ sum w r^2   ]    x = busy/mean(busy). Two unknowns: if one is negative it is
        # [ sum w x  sum w x^2 ] [ k1 ] = [ sum w x r^2 ]    zero and the other is its own least-squares solution.
        weight, first, second, plain, product = rest / k0**2, 0.0, 0.0, rest * mean / k0**2, 0.0
        for i in range(len(busy)):
            x, w = busy[i] / size, 1.0 / (k0 + k1 * busy[i] / size) ** 2
            weight, first, second = weight + w, first + w * x, second + w * x * x
            plain, product = plain + w * squares[i], product + w * x * squares[i]
        determinant = weight * second - first**2
        k1 = max(0.0, (weight * product - first * plain) / determinant) if determinant > RANK * weight * second else 0.0
        k0 = (plain - k1 * first) / weight
        if k0 < 0.0:
            k0, k1 = 0.0, product / second
        k0 = max(k0, MIN_SHARE * mean)
    return k0, k1 / size
