"""Training data, checked, and least squares on it, the thesis's estimator (T 4.1.2). It is biased by output noise."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.model import Order
from mavdiag.telemetry import FloatArray

Records: TypeAlias = FloatArray | Sequence[FloatArray]  # one record, or one per segment

BLOCK_ROWS = 256  # rows per block of `triangle`: fits the cache and stays below the size that BLAS threads
EPSILON = float(np.finfo(np.float64).eps)
MIN_ROWS_PER_PARAMETER = 10  # our rule of thumb; below it a standard error means little


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """An unbroken piece of flight: u and y on the same uniform grid, (n,) each, or (m, n) of m pieces of one length."""

    u: FloatArray
    y: FloatArray

    def __len__(self) -> int:
        return int(self.y.shape[-1])


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """theta: (na + nb,), with its covariance. iterations, converged: of the estimator's own loop."""

    theta: FloatArray
    covariance: FloatArray
    iterations: int = 0
    converged: bool = True


def to_segments(u: Records, y: Records, order: Order) -> tuple[Segment, ...]:
    """Pair u with y, record by record. Raises IdentificationError unless the data can carry `order`."""
    us, ys = _records(u), _records(y)
    if len(us) != len(ys) or not us:
        raise IdentificationError(f"{len(us)} records of u and {len(ys)} of y: give one of each per segment")
    segments = tuple(Segment(*pair) for pair in zip(us, ys, strict=True))
    for i, segment in enumerate(segments, start=1):
        for wrong in _faults(segment, order, f"segment {i}" if len(us) > 1 else "the data"):
            raise IdentificationError(wrong)
    parameters, rows = order[0] + order[1], sum(len(segment) - reach(order) for segment in segments)
    if rows < MIN_ROWS_PER_PARAMETER * parameters:
        raise IdentificationError(
            f"too short: {rows} usable rows for {parameters} parameters; record {MIN_ROWS_PER_PARAMETER} rows for each"
        )
    for name, records in (("u", us), ("y", ys)):
        if max(float(np.ptp(record)) for record in records) == 0.0:
            raise IdentificationError(f"{name} is constant; fly a trajectory that moves this axis")
    return segments


def _records(values: Records) -> list[FloatArray]:
    several = not isinstance(values, np.ndarray) and (len(values) == 0 or np.ndim(values[0]) > 0)
    return [np.asarray(record, dtype=np.float64) for record in (values if several else [values])]


def _faults(segment: Segment, order: Order, name: str) -> Iterator[str]:
    u, y, lag = segment.u, segment.y, reach(order)
    if u.ndim != 1 or y.ndim != 1:
        yield f"{name}: give u and y as one-dimensional arrays, not {u.shape} and {y.shape}"
    if len(u) != len(y):
        yield f"{name}: u has {len(u)} samples and y has {len(y)}; align them first"
    if len(y) <= lag:
        yield f"{name} is too short: {len(y)} samples, order {order} needs more than {lag}"
    if not (np.isfinite(u).all() and np.isfinite(y).all()):
        yield f"{name} holds NaN or infinite samples; split the data there into segments"


def reach(order: Order) -> int:
    """Rows of past that the difference equation reaches back: max(na, nb + nk - 1)."""
    na, nb, nk = order
    return max(na, nb + nk - 1)


def lagged(x: FloatArray, first_lag: int, count: int, first_row: int) -> FloatArray:
    """x(t - first_lag) .. x(t - first_lag - count + 1) for t = first_row .. n - 1: (..., n) -> (count, ..., rows)."""
    n = x.shape[-1]
    return np.stack([x[..., first_row - lag : n - lag] for lag in range(first_lag, first_lag + count)])


def regressors(segment: Segment, order: Order) -> tuple[FloatArray, FloatArray]:
    """Phi' (na + nb, ..., rows) and target (..., rows) of a segment, from t = `reach(order)` on."""
    na, nb, nk = order
    first = reach(order)
    # y(t) = [ -y(t-1) ... -y(t-na)  u(t-nk) ... u(t-nk-nb+1) ] @ [ a_1 .. a_na  b_nk .. b_{nk+nb-1} ]'
    Phi = np.concatenate((-lagged(segment.y, 1, na, first), lagged(segment.u, nk, nb, first)))
    return Phi, segment.y[..., first:]


def polynomials(theta: FloatArray, order: Order) -> tuple[FloatArray, FloatArray]:
    """Split theta into a (na + 1,) with a[0] = 1 and b (nk + nb,) with nk leading zeros."""
    na, _, nk = order
    return np.concatenate(([1.0], theta[:na])), np.concatenate((np.zeros(nk), theta[na:]))


def triangle(rows: FloatArray) -> FloatArray:
    """R of rows = Q R, (n, c) -> (min(n, c), c), in blocks: R of stacked Rs is R of the whole."""
    n, c = rows.shape
    whole = n // BLOCK_ROWS
    if whole < 2:
        return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)
    blocks = np.asarray(np.linalg.qr(rows[: whole * BLOCK_ROWS].reshape(whole, BLOCK_ROWS, c), mode="r"))
    return triangle(np.concatenate((blocks.reshape(-1, c), rows[whole * BLOCK_ROWS :])))


def check_excitation(segments: Sequence[Segment], order: Order) -> None:
    """Raise IdentificationError unless u is persistently exciting of order na + nb (Ljung, Sys. Id. 2e, 13.2)."""
    needed = order[0] + order[1]
    usable = [lagged(segment.u, 0, needed, needed - 1) for segment in segments if len(segment) >= needed]
    U = np.concatenate(usable, axis=1).T if usable else np.zeros((1, needed))
    rank = np.linalg.matrix_rank(triangle(U), rtol=max(U.shape) * EPSILON)
    if rank < needed:
        raise IdentificationError(
            f"u is persistently exciting of order {rank}, this model needs {needed}: fly sharper or more varied inputs"
        )


def solve(Z: FloatArray, Phi: FloatArray, target: FloatArray, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Solve Z' Phi theta = Z' target; return theta (d,) and (Z' Z)^-1 (d, d). Z = Phi is least squares.

    Raises IdentificationError if a column is nothing but the others to `tolerance`.
    """
    scale = np.linalg.norm(Z, axis=0)
    if not (np.isfinite(scale).all() and np.all(scale > 0.0)):
        raise IdentificationError("a regressor column is zero or overflows; check the input's scale")
    Q, R = np.linalg.qr(Z / scale)
    if np.linalg.matrix_rank(R, rtol=tolerance) < len(scale):
        raise IdentificationError("the regressors are linearly dependent; lower the order or fly a richer input")
    theta: FloatArray = np.linalg.lstsq(Q.T @ (Phi / scale), Q.T @ target, rcond=None)[0] / scale
    inverse = np.linalg.inv(R) / scale[:, None]
    return theta, inverse @ inverse.T


def least_squares(segments: Sequence[Segment], order: Order) -> Estimate:
    """Least-squares estimate over the rows of all segments: covariance = (Phi' Phi)^-1 e'e/(n - d)."""
    stacked = np.concatenate([np.vstack(regressors(segment, order)) for segment in segments], axis=1)  # [ Phi  y ]'
    d, n = order[0] + order[1], stacked.shape[1]
    R = triangle(stacked.T)
    Phi, target = R[:, :d], R[:, d]
    theta, spread = solve(Phi, Phi, target, n * EPSILON)
    return Estimate(theta, spread * float(np.sum((target - Phi @ theta) ** 2)) / (n - d))
