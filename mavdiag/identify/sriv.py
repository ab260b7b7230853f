"""SRIV: Young's simplified refined instrumental variable estimator, for noise on the output.

The model is y = (B/A) u + e with e on the output. Least squares regresses on noisy past outputs and is biased; SRIV
replaces them by instruments, the outputs that the last model simulates from u alone, and filters everything by 1/A,
which makes the estimate efficient for white e and consistent for coloured e (P. C. Young, Recursive Estimation and
Time-Series Analysis 2e, ch. 7; the data-based mechanistic school of T 4.1.1).
"""

from dataclasses import dataclass

import numpy as np

from mavdiag.identify.arx import Estimate, least_squares, polynomials, regressors, solve
from mavdiag.identify.data import Segment
from mavdiag.identify.model import Order
from mavdiag.quantities import FloatArray

__all__ = ["reflect_poles", "sriv"]

MAX_ITERATIONS = 40  # our choice; good data take 3 to 10
STEP_OVER_ERROR = 1e-3  # converged when no parameter moves more than this share of its standard error ..
STEP_RELATIVE = 1e-9  # .. or, on data without noise, of itself
MAX_HALVINGS = 10  # of a step that leaves the unit circle (our choice)
MAX_RADIUS = 0.99999  # reflected poles stay this far inside the unit circle (our choice)


def reflect_poles(a: FloatArray) -> FloatArray:
    """The polynomial a (na + 1,) with its roots on or outside the unit circle mirrored to the inside."""
    roots = np.roots(a)
    radius = np.abs(roots)
    if np.all(radius < 1.0):
        return a
    outside = radius >= 1.0
    mirrored = np.where(outside, roots / np.maximum(radius, 1.0) ** 2, roots)
    mirrored = np.where(outside & (np.abs(mirrored) > MAX_RADIUS), roots / radius * MAX_RADIUS, mirrored)
    trailing = np.zeros(len(a) - 1 - len(roots))
    return np.concatenate((np.real(np.atleast_1d(np.poly(mirrored))), trailing))


def _filtered_rows(segment: Segment, order: Order, a: FloatArray, y_sim: FloatArray) -> FloatArray:
    """The columns [Z, Phi, y] of one segment, (rows, 2 (na + nb) + 1), filtered by 1/A, initial state removed."""
    from scipy.signal import lfilter  # 0.8 s to import: only offline work pays it

    # Phi_f = 1/A [ -y(t-1)     ... -y(t-na)      u(t-nk) ... u(t-nk-nb+1) ]
    # Z_f   = 1/A [ -y_sim(t-1) ... -y_sim(t-na)  u(t-nk) ... u(t-nk-nb+1) ]
    #
    # y(t) = phi(t)' theta + A e(t) holds on every complete row, wherever the segment begins. So rows are formed first
    # and filtered afterwards; what the filter does not know, its state before the first row, adds a free response
    # F x0 with unknown x0 (na,) to the filtered equation. Projecting the columns of F out leaves the error e itself.
    Phi, target = regressors(segment, order)
    Z, _ = regressors(Segment(segment.u, y_sim), order)
    columns = np.column_stack((Z, Phi, target))
    F = lfilter([1.0], a, np.eye(len(target), len(a) - 1), axis=0)
    Q, _ = np.linalg.qr(F)
    filtered = np.asarray(lfilter([1.0], a, columns, axis=0), dtype=np.float64)
    return filtered - Q @ (Q.T @ filtered)


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    """A stable theta, the SRIV solution `target` that follows from it with its errors, and theta's own loss."""

    theta: FloatArray
    target: FloatArray
    errors: FloatArray
    loss: float
    rows: int

    @property
    def settled(self) -> bool:
        tolerance = np.maximum(STEP_OVER_ERROR * self.errors, STEP_RELATIVE * np.abs(self.theta))
        return bool(np.all(np.abs(self.target - self.theta) <= tolerance))


def _evaluate(segments: tuple[Segment, ...], order: Order, theta: FloatArray) -> _Point:
    """Solve Z_f' Phi_f target = Z_f' y_f with filter and instruments from theta.

    y_f - Phi_f theta is the output error y - y_sim of theta (initial states free) and Z_f its gradient, so a fixed
    point is where the mean squared output error is stationary, and target - theta is the Gauss-Newton step to it.
    """
    from scipy.signal import lfilter  # 0.8 s to import: only offline work pays it

    a, b = polynomials(theta, order)
    rows = np.concatenate(
        [_filtered_rows(one, order, a, np.asarray(lfilter(b, a, one.u), dtype=np.float64)) for one in segments]
    )
    n, d = len(rows), len(theta)
    Z, Phi, y = rows[:, :d], rows[:, d : 2 * d], rows[:, -1]
    target, spread = solve(Z, Phi, y)
    squares = float(np.sum((y - Phi @ theta) ** 2))
    freedom = max(1, n - d - len(segments) * order[0])
    return _Point(theta, target, np.sqrt(spread * squares / freedom), squares / n, n)


def _reflected_step(order: Order, point: _Point) -> FloatArray:
    """`target`, its poles outside the unit circle mirrored to the inside."""
    return np.concatenate((reflect_poles(polynomials(point.target, order)[0])[1:], point.target[order[0] :]))


def _shortened_step(order: Order, point: _Point) -> FloatArray:
    """`target`, or as far towards it from theta as keeps the model stable, by halving."""
    theta = point.target
    for _ in range(MAX_HALVINGS):
        if np.all(np.abs(np.roots(polynomials(theta, order)[0])) < 1.0):
            return theta
        theta = 0.5 * (point.theta + theta)
    return point.theta


def sriv(segments: tuple[Segment, ...], order: Order) -> Estimate:
    """SRIV estimate over all segments, started from least squares.

    standard_errors = sqrt(diag (Z_f' Z_f)^-1 var(e)), right for white output noise. loss: mean squared output error
    with the initial state of each segment free. A step to an unstable model has its poles reflected; if that does not
    settle, the loop is run again with such steps cut short. If neither settles, the iterate with the smallest loss is
    returned and `converged` is False: such data hardly tell the parameters apart.
    Raises IdentificationError if they cannot tell them apart at all.
    """
    a, b = polynomials(least_squares(segments, order).theta, order)
    first = best = _evaluate(segments, order, np.concatenate((reflect_poles(a)[1:], b[order[2] :])))
    for next_theta in (_reflected_step, _shortened_step):
        point = first
        for iteration in range(1, MAX_ITERATIONS + 1):
            if point.settled:
                return Estimate(point.theta, point.errors, point.loss, point.rows, iteration)
            point = _evaluate(segments, order, next_theta(order, point))
            best = min(best, point, key=lambda one: one.loss)
    return Estimate(best.theta, best.errors, best.loss, best.rows, MAX_ITERATIONS, converged=False)
