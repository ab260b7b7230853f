"""Least-squares ARX, the thesis's estimator (T 4.1.2). Biased when the noise sits on the output: see `sriv`."""

from dataclasses import dataclass

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.data import EPSILON, Segment, lag_matrix, numerical_rank, triangle
from mavdiag.identify.model import Order
from mavdiag.telemetry import FloatArray

__all__ = ["Estimate", "least_squares", "polynomials", "regressors", "solve"]


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Raw outcome of an estimator.

    theta: (na + nb,) parameters.
    covariance: of theta, (na + nb, na + nb).
    loss: mean square of its own residual.
    rows: number of those residuals.
    iterations, converged: of the estimator's own loop, 0 and True without one.
    """

    theta: FloatArray
    covariance: FloatArray
    loss: float
    rows: int
    iterations: int = 0
    converged: bool = True


def regressors(segment: Segment, order: Order) -> tuple[FloatArray, FloatArray]:
    """Regressor matrix Phi (rows, na + nb) and target (rows,) of one segment, first row t = max(na, nb + nk - 1)."""
    na, nb, nk = order
    first = max(na, nb + nk - 1)
    # (rows,) = (rows, na + nb) @ (na + nb,)
    #
    # [ y(t)   ]   [ -y(t-1) ... -y(t-na)     u(t-nk)   ... u(t-nk-nb+1) ]   [ a_1 .. a_na,          ]
    # [ y(t+1) ] = [ -y(t)   ... -y(t-na+1)   u(t-nk+1) ... u(t-nk-nb+2) ] @ [ b_nk .. b_{nk+nb-1}   ]'
    # [ ...    ]   [ ...                                                 ]
    past_y = lag_matrix(segment.y, 1, na, first)
    past_u = lag_matrix(segment.u, nk, nb, first)
    return np.column_stack((-past_y, past_u)), segment.y[first:]


def polynomials(theta: FloatArray, order: Order) -> tuple[FloatArray, FloatArray]:
    """Split theta into a (na + 1,) with a[0] = 1 and b (nk + nb,) with nk leading zeros."""
    na, _, nk = order
    return np.concatenate(([1.0], theta[:na])), np.concatenate((np.zeros(nk), theta[na:]))


def solve(Z: FloatArray, Phi: FloatArray, target: FloatArray, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Solve Z' Phi theta = Z' target; return theta (d,) and (Z' Z)^-1 (d, d).

    Z = Phi is least squares. By an orthogonal factor of Z, so that no covariance is ever squared: slow flight data at
    1 kHz are nearly collinear. Raises IdentificationError if a column is nothing but the others to `tolerance`.
    """
    scale = np.linalg.norm(Z, axis=0)
    if not (np.isfinite(scale).all() and np.all(scale > 0.0)):
        raise IdentificationError("a regressor column is zero or overflows; check the input's scale")
    Q, R = np.linalg.qr(Z / scale)
    if numerical_rank(R, tolerance) < len(scale):
        raise IdentificationError("the regressors are linearly dependent; lower the order or fly a richer input")
    theta: FloatArray = np.linalg.lstsq(Q.T @ (Phi / scale), Q.T @ target, rcond=None)[0] / scale
    inverse = np.linalg.inv(R) / scale[:, None]
    return theta, inverse @ inverse.T


def least_squares(segments: tuple[Segment, ...], order: Order) -> Estimate:
    """Least-squares estimate over the stacked rows of all segments; no row reaches over a boundary.

    covariance = (Phi' Phi)^-1 e'e/(n - d); loss V = e'e/n.
    Raises IdentificationError if the regressors are linearly dependent.
    """
    stacked = np.concatenate([np.column_stack(regressors(segment, order)) for segment in segments])  # [ Phi  y ]
    n, d = len(stacked), order[0] + order[1]
    R = triangle(stacked)
    Phi, target = R[:, :d], R[:, d]
    theta, spread = solve(Phi, Phi, target, n * EPSILON)
    squares = float(np.sum((target - Phi @ theta) ** 2))
    return Estimate(theta, spread * squares / (n - d), squares / n, n)
