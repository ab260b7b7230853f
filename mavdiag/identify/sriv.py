"""SRIV: Young's simplified refined instrumental variable estimator, for noise on the output.

y = (B/A) u + e. The noisy past outputs of least squares are replaced by instruments, the outputs x that the last model
simulates from u alone, and everything is filtered by 1/A (P. C. Young, Recursive Estimation and Time-Series Analysis
2e, ch. 7; the data-based mechanistic school of T 4.1.1):

    Z_f' Phi_f theta = Z_f' y_f     Phi_f = 1/A [ -y(t-1)     .. -y(t-na)      u(t-nk) .. u(t-nk-nb+1) ]
    x = (B/A) u                     Z_f   = 1/A [ -x(t-1)     .. -x(t-na)      u(t-nk) .. u(t-nk-nb+1) ]

The filter's state before the first row of a segment adds a free response F x0: F is projected out of every column.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import (
    EPSILON,
    Order,
    Segment,
    filtered,
    least_squares,
    polynomials,
    reach,
    solve,
    triangle,
)
from mavdiag.telemetry import FloatArray

PATIENCE = 8  # iterations without progress before it gives up; good data settle in 3 to 8 (our choice)
PROGRESS = 1e-3  # a smaller relative gain in loss is none (our choice)
SETTLED = 1e-3  # of its standard error is the most that a parameter may still want to move
NEARLY_SETTLED = 0.1  # the same, where no step lowers the loss any more (the gradient leaves initial states out)
STEP_RELATIVE = 1e-9  # of the parameter itself counts as settled too: data without noise
MAX_DESCENT, MAX_HALVINGS = 15, 6  # Gauss-Newton steps, and halvings of one (our choice)
MAX_RADIUS = 0.99999  # reflected poles stay this far inside the unit circle (our choice)


def sriv(
    segments: Sequence[Segment], order: Order, figures: bool = True, near: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, bool]:
    """SRIV theta over all segments, its covariance, and whether it settled; started from least squares, or from `near`.

    What does not settle is finished by Gauss-Newton steps. covariance: nan without `figures`.
    """
    groups = [[one for one in segments if len(one) == n] for n in dict.fromkeys(map(len, segments))]
    data = [np.stack([*(one.u for one in group), *(one.y for one in group)], axis=1) for group in groups]
    settled = False
    if near is not None:
        with suppress(IdentificationError):
            point, settled = _refine(data, order, _evaluate(data, order, near))
    if not settled:
        a, b = polynomials(least_squares(segments, order)[0], order)
        first = _evaluate(data, order, np.concatenate((reflect_poles(a)[1:], b[order[2] :])))
        point, settled = _refine(data, order, first)
    if not settled:
        point, settled = _descend(data, order, point)
    covariance = _coloured(data, order, point) if figures else np.full_like(point.inverse, np.nan)
    return point.theta, covariance, settled


def reflect_poles(a: FloatArray) -> FloatArray:
    """The polynomial a (na + 1,) with its roots on or outside the unit circle mirrored to the inside."""
    roots = np.roots(a)
    radius = np.abs(roots)
    if np.all(radius < 1.0):
        return a
    far = np.maximum(radius, 1.0)
    scale = np.where(radius < 1.0, 1.0, np.minimum(1.0 / far, MAX_RADIUS) / far)
    return np.real(np.atleast_1d(np.poly(scale * roots)))


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    """A stable theta with its loss (mean squared output error, initial states free) and two ways on from it."""

    theta: FloatArray
    refined: FloatArray  # the SRIV solution with filter and instruments from theta
    descent: FloatArray  # the Gauss-Newton solution
    inverse: FloatArray  # (Z_f' Z_f)^-1
    errors: FloatArray  # standard errors of theta if the noise were white
    loss: float
    rows: int  # residuals in the loss

    def settled(self, target: FloatArray, share: float) -> bool:
        """Whether the way to `target` is at most that share of the standard errors, or rounding."""
        tolerance = np.maximum(share * self.errors, STEP_RELATIVE * np.abs(self.theta))
        return bool(np.all(np.abs(target - self.theta) <= tolerance))


def _evaluate(data: Sequence[FloatArray], order: Order, theta: FloatArray) -> _Point:
    """Solve Z_f' Phi_f refined = Z_f' y_f with filter and instruments from theta.

    y_f - Phi_f theta is the output error e and -Z_f its gradient: (Z_f' Z_f)^-1 Z_f' e is the Gauss-Newton step.
    """
    n, d = sum(group.shape[1] * (len(group) - reach(order)) for group in data) // 2, len(theta)
    R = np.concatenate([_reduced(_filtered(group, order, theta), order[0]) for group in data])
    Z, Phi, y = R[:, :d], R[:, d : 2 * d], R[:, -1]
    error = y - Phi @ theta
    refined, _ = solve(Z, Phi, y, n * EPSILON)
    move, inverse = solve(Z, Z, error, n * EPSILON)
    squares = float(error @ error)
    freedom = max(1, n - d - sum(group.shape[1] for group in data) // 2 * order[0])
    errors = np.sqrt(np.diag(inverse) * squares / freedom)
    return _Point(theta, refined, theta + move, inverse, errors, squares / n, n)


def _refine(data: Sequence[FloatArray], order: Order, point: _Point) -> tuple[_Point, bool]:
    """SRIV proper, unstable poles reflected: the last or else best point, and whether it settled."""
    best, best_at, iteration = point, 0, 0
    while iteration < best_at + PATIENCE:
        if point.settled(point.refined, SETTLED) and point.loss <= best.loss * (1.0 + PROGRESS):
            return point, True
        iteration += 1
        stable = reflect_poles(polynomials(point.refined, order)[0])
        point = _evaluate(data, order, np.concatenate((stable[1:], point.refined[order[0] :])))
        if point.loss < best.loss * (1.0 - PROGRESS):
            best, best_at = point, iteration
    return best, False


def _descend(data: Sequence[FloatArray], order: Order, point: _Point) -> tuple[_Point, bool]:
    """Gauss-Newton on the same equations: each step halved until the model is stable and better."""
    for _ in range(MAX_DESCENT):
        if point.settled(point.descent, SETTLED):
            return point, True
        for halvings in range(MAX_HALVINGS):
            theta = point.theta + (point.descent - point.theta) * 0.5**halvings
            if np.all(np.abs(np.roots(polynomials(theta, order)[0])) < 1.0):
                better = _evaluate(data, order, theta)
                if better.loss < point.loss:
                    break
        else:
            break
        point = better
    return point, point.settled(point.descent, NEARLY_SETTLED)


def _filtered(group: FloatArray, order: Order, theta: FloatArray) -> FloatArray:
    """Columns [Z_f -y_f(t-1) .. -y_f(t-na) y_f], (c, rows, m), of u and y of m pieces, (n, 2 m); free responses out."""
    (na, nb, nk), first, (n, both) = order, reach(order), group.shape
    A, B = (np.pad(one, (0, first + 1 - len(one))) for one in polynomials(theta, order))
    one, at_rest, m = np.eye(1, first + 1)[0], np.zeros((first + 1, both)), both // 2
    u_f, y_f = np.split(filtered(one, A, group, at_rest), 2, axis=1)
    x_f = filtered(B, A, np.ascontiguousarray(u_f), at_rest[:, :m])
    free = filtered(one, A, np.eye(n - first, na), np.zeros((first + 1, na)))
    lags, delays = range(1, na + 1), range(nk, nk + nb)
    lagged = [*((-x_f, lag) for lag in lags), *((u_f, lag) for lag in delays), *((-y_f, lag) for lag in lags), (y_f, 0)]
    columns = np.stack([signal[first - lag : n - lag] for signal, lag in lagged])
    lasts = 1 + int(np.flatnonzero(~(np.abs(free).max(axis=1) <= EPSILON**2))[-1])  # then it is less than any rounding
    Q, _ = np.linalg.qr(free[:lasts])
    columns[:, :lasts] -= Q @ (Q.T @ columns[:, :lasts])
    return columns


def _reduced(columns: FloatArray, na: int) -> FloatArray:
    """R of the columns [Z_f Phi_f y_f]."""
    c = len(columns)
    R, d = triangle(columns.reshape(c, -1).T), c - na - 1
    return R[:, [*range(d), *range(d, d + na), *range(na, d), c - 1]]


def _coloured(data: Sequence[FloatArray], order: Order, point: _Point) -> FloatArray:
    """cov theta = M S M, M = (Z_f' Z_f)^-1, S = sum_k r_e(k) sum_t z_f(t) z_f(t + k)', (na + nb, na + nb).

    (Soderstrom and Stoica, System Identification, ch. 8). r_e: autocovariance of the residual under a Bartlett window
    of sqrt(n) lags (our choice).
    """
    na, d, lags = order[0], len(point.theta), int(np.sqrt(point.rows))
    r_e, instruments = np.zeros(lags), []
    for group in data:
        columns = _filtered(group, order, point.theta).transpose(0, 2, 1)
        e = columns[-1] - np.tensordot(point.theta, np.concatenate((columns[d : d + na], columns[na:d])), 1)
        size = 1 << (e.shape[1] + lags).bit_length()  # circular products of this length are those of zeros around
        products = np.fft.irfft(np.square(np.abs(np.fft.rfft(e, size))).sum(axis=0), size)[: min(lags, e.shape[1])]
        r_e[: len(products)] += products / point.rows
        instruments.append((columns[:d], size))
    weights, S = r_e * (1.0 - np.arange(lags) / lags), np.zeros((d, d))
    for Z, size in instruments:
        both_sides = np.concatenate((weights, np.zeros(size + 1 - 2 * lags), weights[:0:-1]))
        smooth = np.fft.rfft(Z, size) * np.fft.rfft(both_sides)
        S += np.tensordot(Z, np.fft.irfft(smooth, size)[..., : Z.shape[2]], ((1, 2), (1, 2)))
    return np.asarray(point.inverse @ (0.5 * (S + S.T)) @ point.inverse, dtype=np.float64)
