"""The filtered rows of SRIV over all segments at once: what `sriv` needs of them is one small triangle.

1/A is linear and does not change with time: a filtered lagged signal is the lagged filtered signal, but for a free
response of 1/A, which is projected out anyway. So each signal is filtered once, segments of equal length together, and
the inputs stand in Z and in Phi alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.identify.data import Segment, triangle
from mavdiag.identify.model import Order
from mavdiag.telemetry import FloatArray

__all__ = ["Together", "together", "triangle_of"]

EVERY = 16  # of the rows that make the basis: they span what all rows span (our choice)
LEAST_SHARE = 1e-3  # of a basis vector in the rows; with less the basis does not suit them (our choice)
LEAST_DIAGONAL = 1e-8  # of a column beside the others; with less the columns are dependent (our choice)


@dataclass(frozen=True, slots=True, eq=False)
class Together:
    """Segments of one length, u and y (m, n) each."""

    u: FloatArray
    y: FloatArray


def together(segments: Sequence[Segment]) -> tuple[Together, ...]:
    """The segments by length."""
    lengths = dict.fromkeys(len(one) for one in segments)
    alike = ([one for one in segments if len(one) == length] for length in lengths)
    return tuple(Together(np.stack([one.u for one in some]), np.stack([one.y for one in some])) for some in alike)


def triangle_of(groups: Sequence[Together], order: Order, a: FloatArray, b: FloatArray) -> FloatArray | None:
    """R of the columns [Z Phi y] of `sriv._filtered` over all segments, (c, 2 (na + nb) + 1).

    By a Cholesky factor of the products in a basis in which the columns are nearly orthonormal, so that nothing is lost
    by squaring. None where there is no such basis: the columns are dependent, as with data without noise.
    """
    na, nb, _ = order
    columns = [_columns(one, order, a, b) for one in groups]
    basis = triangle(np.concatenate([rows[:, ::EVERY] for rows, _ in columns], axis=1).T)
    diagonal = np.abs(np.diag(basis))
    if len(basis) < basis.shape[1] or not (diagonal > LEAST_DIAGONAL * np.linalg.norm(basis, axis=0)).all():
        return None
    T = np.linalg.inv(basis).T
    products = np.zeros((len(T), len(T)))
    for rows, free in columns:
        whitened = T @ rows
        # the part of each segment in the free responses, (c, m na), is no error of the model
        parts = (whitened.reshape(-1, len(free)) @ free).reshape(len(T), -1)
        products += whitened @ whitened.T - parts @ parts.T
    try:
        root = np.linalg.cholesky(products).T
    except np.linalg.LinAlgError:
        return None
    if not np.diag(root).min() > LEAST_SHARE * np.sqrt(np.diag(products).max()):
        return None
    R = root @ basis
    inputs = list(range(na, na + nb))
    return np.asarray(R[:, [*range(na + nb), *range(na + nb, 2 * na + nb), *inputs, 2 * na + nb]], dtype=np.float64)


def _columns(group: Together, order: Order, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rows of all segments, one after the other: (c, m r) of c = 2 na + nb + 1 columns [-x_f u_f -y_f y_f(t)].

    And an orthonormal basis of the free responses of 1/A, (r, na).
    """
    from scipy.signal import lfilter  # 0.8 s to import: only offline work pays it

    na, nb, nk = order
    m, n = group.u.shape
    first = max(na, nb + nk - 1)
    x = lfilter(b, a, group.u)
    u_f, x_f, y_f = lfilter([1.0], a, np.stack((group.u, x, group.y)))
    lagged = [(x_f, lag, -1.0) for lag in range(1, na + 1)]
    lagged += [(u_f, lag, 1.0) for lag in range(nk, nk + nb)]
    lagged += [(y_f, lag, -1.0) for lag in range(1, na + 1)]
    out = np.empty((len(lagged) + 1, m, n - first))
    for row, (signal, lag, sign) in zip(out, [*lagged, (y_f, 0, 1.0)], strict=True):
        np.multiply(signal[:, first - lag : n - lag], sign, out=row)
    free, _ = np.linalg.qr(lfilter([1.0], a, np.eye(na, n - first)).T)
    return out.reshape(len(out), -1), np.asarray(free, dtype=np.float64)
