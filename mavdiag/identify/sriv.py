"""SRIV: Young's simplified refined instrumental variable estimator, for noise on the output.

The model is y = (B/A) u + e with e on the output. Least squares regresses on noisy past outputs and is biased; SRIV
replaces them by instruments, the outputs that the last model simulates from u alone, and filters everything by 1/A,
which makes the estimate efficient for white e and consistent for coloured e (P. C. Young, Recursive Estimation and
Time-Series Analysis 2e, ch. 7; the data-based mechanistic school of T 4.1.1).
"""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import Estimate, least_squares, polynomials, regressors, solve
from mavdiag.identify.data import EPSILON, Segment, triangle
from mavdiag.identify.model import Order
from mavdiag.identify.together import Together, together, triangle_of
from mavdiag.identify.uncertainty import coloured_covariance
from mavdiag.telemetry import FloatArray

__all__ = ["reflect_poles", "sriv"]

PATIENCE = 8  # iterations without progress before it gives up; good data settle in 3 to 8 (our choice)
PROGRESS = 1e-3  # a smaller relative gain in loss is none (our choice)
SETTLED = 1e-3  # of its standard error is the most that a parameter may still want to move
NEARLY_SETTLED = 0.1  # the same, where no step lowers the loss any more (the gradient leaves initial states out)
STEP_RELATIVE = 1e-9  # of the parameter itself counts as settled too: data without noise
MAX_DESCENT, MAX_HALVINGS = 15, 6  # Gauss-Newton steps, and halvings of one (our choice)
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


def _filtered(segment: Segment, order: Order, a: FloatArray, b: FloatArray) -> FloatArray:
    """Triangle of the columns [Z Phi y] of one segment, 2 (na + nb) + 1 square, filtered by 1/A, free response out."""
    from scipy.signal import lfilter  # 0.8 s to import: only offline work pays it

    # Phi_f = 1/A [ -y(t-1)     ... -y(t-na)      u(t-nk) ... u(t-nk-nb+1) ]
    # Z_f   = 1/A [ -y_sim(t-1) ... -y_sim(t-na)  u(t-nk) ... u(t-nk-nb+1) ]        y_sim = (B/A) u
    #
    # y(t) = phi(t)' theta + A e(t) holds on every complete row, wherever the segment begins. So rows are formed first
    # and filtered afterwards; what the filter does not know, its state before the first row, adds a free response
    # F x0 with unknown x0 (na,) to the filtered equation. Projecting F out leaves the error e itself: in the triangle
    # of [ F_f Z_f Phi_f y_f ] that is the part below and to the right of F.
    na = order[0]
    y_sim = np.asarray(lfilter(b, a, segment.u), dtype=np.float64)
    Phi, y = regressors(segment, order)
    Z, _ = regressors(Segment(segment.u, y_sim), order)
    columns = np.vstack((np.eye(na, len(y)), Z.T, Phi.T, y))
    filtered = np.asarray(lfilter([1.0], a, columns), dtype=np.float64)
    return triangle(np.ascontiguousarray(filtered.T))[na:, na:]


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    """A stable theta with its loss (mean squared output error, initial states free) and two ways on from it.

    refined: the SRIV solution with filter and instruments from theta. descent: the Gauss-Newton solution. Both stand
    still at the same theta. errors: standard errors of theta if the noise were white. rows: residuals in the loss.
    """

    theta: FloatArray
    refined: FloatArray
    descent: FloatArray
    errors: FloatArray
    loss: float
    rows: int

    def settled(self, target: FloatArray, share: float) -> bool:
        """True if the way to `target` is at most that share of the standard errors, or rounding."""
        tolerance = np.maximum(share * self.errors, STEP_RELATIVE * np.abs(self.theta))
        return bool(np.all(np.abs(target - self.theta) <= tolerance))


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """The segments, and the same by length."""

    segments: tuple[Segment, ...]
    groups: tuple[Together, ...]


def _evaluate(data: _Data, order: Order, theta: FloatArray) -> _Point:
    """Solve Z_f' Phi_f refined = Z_f' y_f with filter and instruments from theta.

    y_f - Phi_f theta is the output error e = y - y_sim and -Z_f its gradient. So Z_f' e = 0, where SRIV stands still,
    is where the mean squared output error is stationary, and theta + (Z_f' Z_f)^-1 Z_f' e is the Gauss-Newton step.
    """
    a, b = polynomials(theta, order)
    n, d = sum(len(one) - max(len(a), len(b)) + 1 for one in data.segments), len(theta)
    rows = triangle_of(data.groups, order, a, b)
    if rows is None:
        rows = np.concatenate([_filtered(one, order, a, b) for one in data.segments])
    Z, Phi, y = rows[:, :d], rows[:, d : 2 * d], rows[:, -1]
    error = y - Phi @ theta
    refined, _ = solve(Z, Phi, y, n * EPSILON)
    move, spread = solve(Z, Z, error, n * EPSILON)
    squares = float(error @ error)
    freedom = max(1, n - d - len(data.segments) * order[0])
    return _Point(theta, refined, theta + move, np.sqrt(np.diag(spread) * squares / freedom), squares / n, n)


def _refine(data: _Data, order: Order, point: _Point) -> tuple[_Point, int, bool]:
    """SRIV proper: always the full step, unstable poles reflected. The last or else best point, iterations, settled."""
    best, best_at, iteration = point, 0, 0
    while iteration < best_at + PATIENCE:
        if point.settled(point.refined, SETTLED) and point.loss <= best.loss * (1.0 + PROGRESS):
            return point, iteration, True
        iteration += 1
        stable = reflect_poles(polynomials(point.refined, order)[0])
        point = _evaluate(data, order, np.concatenate((stable[1:], point.refined[order[0] :])))
        if point.loss < best.loss * (1.0 - PROGRESS):
            best, best_at = point, iteration
    return best, iteration, False


def _descend(data: _Data, order: Order, point: _Point) -> tuple[_Point, int, bool]:
    """Gauss-Newton on the same equations: each step halved until the model is stable and better."""
    for iteration in range(MAX_DESCENT):
        if point.settled(point.descent, SETTLED):
            return point, iteration, True
        for halvings in range(MAX_HALVINGS):
            theta = point.theta + (point.descent - point.theta) * 0.5**halvings
            if np.all(np.abs(np.roots(polynomials(theta, order)[0])) < 1.0):
                better = _evaluate(data, order, theta)
                if better.loss < point.loss:
                    break
        else:
            break
        point = better
    return point, iteration, point.settled(point.descent, NEARLY_SETTLED)


def _hastened(data: _Data, order: Order, theta: FloatArray) -> tuple[_Point, int, bool]:
    """SRIV from a theta that is near already, with extrapolation. The last point, iterations, settled.

    SRIV comes nearer by a like factor in each step. So the steps' own differences tell where they lead (Anderson's
    mixing of depth 2; H. F. Walker and P. Ni, SIAM J. Numer. Anal. 49 (2011) 1715): half the iterations.
    """
    thetas, steps = [], []
    for iteration in range(PATIENCE):
        point = _evaluate(data, order, theta)
        if point.settled(point.refined, SETTLED):
            return point, iteration, True
        thetas.append(theta)
        steps.append(point.refined - theta)
        theta = point.refined
        if iteration:
            changes = np.diff(steps[-3:], axis=0).T
            weights = 1.0 / np.maximum(point.errors, STEP_RELATIVE * np.abs(theta))[:, None]
            share = np.linalg.lstsq(changes * weights, steps[-1] * weights[:, 0], rcond=None)[0]
            theta = theta - (np.diff(thetas[-3:], axis=0).T + changes) @ share
        theta = np.concatenate((reflect_poles(polynomials(theta, order)[0])[1:], theta[order[0] :]))
    return point, PATIENCE, False


def sriv(segments: tuple[Segment, ...], order: Order, figures: bool = True, near: FloatArray | None = None) -> Estimate:
    """SRIV estimate over all segments, started from least squares, or from a theta that is near already.

    Both ways end at the same theta, to a thousandth of its standard error for white noise.

    covariance: right for output noise of any colour, see `uncertainty`; nan without `figures`. loss: mean squared
    output error with the initial state of each segment free. If the iteration does not settle, which happens where the
    order is not that of the data, it is finished by Gauss-Newton steps on the same equations. `converged` is False if
    those do not settle either: such data, or such an order, hardly tell the parameters apart.
    Raises IdentificationError if they cannot tell them apart at all.
    """
    data = _Data(segments, together(segments))
    if near is not None:
        with suppress(IdentificationError):
            point, iterations, settled = _hastened(data, order, near)
            if settled:
                return _estimate(data, order, point, iterations, settled, figures)
    a, b = polynomials(least_squares(segments, order).theta, order)
    first = _evaluate(data, order, np.concatenate((reflect_poles(a)[1:], b[order[2] :])))
    point, iterations, settled = _refine(data, order, first)
    if not settled:
        point, more, settled = _descend(data, order, point)
        iterations += more
    return _estimate(data, order, point, iterations, settled, figures)


def _estimate(data: _Data, order: Order, point: _Point, iterations: int, settled: bool, figures: bool) -> Estimate:
    d = len(point.theta)
    covariance = coloured_covariance(data.segments, order, point.theta) if figures else np.full((d, d), np.nan)
    return Estimate(point.theta, covariance, point.loss, point.rows, iterations, settled)
