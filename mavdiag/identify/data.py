"""Training data: segments that are stacked, never joined, and checked before anything is estimated."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.model import Order
from mavdiag.telemetry import FloatArray

__all__ = [
    "EPSILON",
    "Records",
    "Segment",
    "check_excitation",
    "lag_matrix",
    "numerical_rank",
    "to_segments",
    "triangle",
]

Records: TypeAlias = FloatArray | Sequence[FloatArray]  # one record, or one per segment

BLOCK_ROWS = 256  # rows per block of `triangle`: fits the cache and stays below the size that BLAS threads
EPSILON = float(np.finfo(np.float64).eps)
MIN_ROWS_PER_PARAMETER = 10  # our rule of thumb; below it a standard error means little


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """An unbroken piece of flight: u and y, both (n,), on the same uniform grid."""

    u: FloatArray
    y: FloatArray

    def __len__(self) -> int:
        return len(self.y)


def _records(values: Records) -> list[FloatArray]:
    if isinstance(values, np.ndarray) or (len(values) > 0 and np.ndim(values[0]) == 0):
        return [np.asarray(values, dtype=np.float64)]
    return [np.asarray(record, dtype=np.float64) for record in values]


def _check_segment(u: FloatArray, y: FloatArray, order: Order, name: str) -> None:
    na, nb, nk = order
    lag = max(na, nb + nk - 1)
    if u.ndim != 1 or y.ndim != 1:
        raise IdentificationError(f"{name}: give u and y as one-dimensional arrays, not {u.shape} and {y.shape}")
    if len(u) != len(y):
        raise IdentificationError(f"{name}: u has {len(u)} samples and y has {len(y)}; align them first")
    if len(y) <= lag:
        raise IdentificationError(f"{name} is too short: {len(y)} samples, order {order} needs more than {lag}")
    if not (np.isfinite(u).all() and np.isfinite(y).all()):
        raise IdentificationError(f"{name} holds NaN or infinite samples; split the data there into segments")


def to_segments(u: Records, y: Records, order: Order) -> tuple[Segment, ...]:
    """Pair u with y, record by record, and check that the data can carry `order`.

    Raises IdentificationError if records do not pair up, differ in length, hold NaN, are too short, or are constant.
    """
    us, ys = _records(u), _records(y)
    if len(us) != len(ys) or not us:
        raise IdentificationError(f"{len(us)} records of u and {len(ys)} of y: give one of each per segment")
    for i, (one_u, one_y) in enumerate(zip(us, ys, strict=True), start=1):
        _check_segment(one_u, one_y, order, f"segment {i}" if len(us) > 1 else "the data")
    na, nb, nk = order
    rows = sum(len(one) - max(na, nb + nk - 1) for one in ys)
    if rows < MIN_ROWS_PER_PARAMETER * (na + nb):
        raise IdentificationError(
            f"too short: {rows} usable rows for {na + nb} parameters; record {MIN_ROWS_PER_PARAMETER} rows for each"
        )
    for name, records in (("u", us), ("y", ys)):
        if max(float(np.ptp(one)) for one in records) == 0.0:
            raise IdentificationError(f"{name} is constant; fly a trajectory that moves this axis")
    return tuple(Segment(one_u, one_y) for one_u, one_y in zip(us, ys, strict=True))


def lag_matrix(x: FloatArray, first_lag: int, count: int, first_row: int) -> FloatArray:
    """Columns x(t - first_lag) .. x(t - first_lag - count + 1) for the rows t = first_row .. n - 1."""
    n = len(x)
    return np.column_stack([x[first_row - lag : n - lag] for lag in range(first_lag, first_lag + count)])


def triangle(rows: FloatArray) -> FloatArray:
    """R of rows = Q R, (n, c) -> (min(n, c), c): all that a linear fit needs to know of any number of rows.

    Sums of products of columns are those of R's columns, but nothing was squared to get there. In blocks, so that it
    stays in the cache and in one thread: R of stacked Rs is R of the whole.
    """
    n, c = rows.shape
    whole = n // BLOCK_ROWS
    if whole < 2:
        return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)
    blocks = np.asarray(np.linalg.qr(rows[: whole * BLOCK_ROWS].reshape(whole, BLOCK_ROWS, c), mode="r"))
    return triangle(np.concatenate((blocks.reshape(-1, c), rows[whole * BLOCK_ROWS :])))


def numerical_rank(A: FloatArray, tolerance: float) -> int:
    """Number of singular values of A above `tolerance` times the largest."""
    singular = np.linalg.svd(A, compute_uv=False)
    return int(np.sum(singular > tolerance * singular[0]))


def check_excitation(segments: tuple[Segment, ...], order: Order) -> None:
    """Raise IdentificationError unless u is persistently exciting of order na + nb.

    That many parameters can be told apart only if the covariance of na + nb successive inputs has full rank (Ljung,
    System Identification 2e, sec. 13.2). The rank is taken at double precision: noise on u passes.
    """
    needed = order[0] + order[1]
    # [ u(t) u(t-1) ... u(t-needed+1) ]    (N, needed)
    usable = [segment.u for segment in segments if len(segment) >= needed]
    U = np.concatenate([lag_matrix(u, 0, needed, needed - 1) for u in usable]) if usable else np.zeros((1, needed))
    rank = numerical_rank(triangle(U), max(U.shape) * EPSILON)
    if rank < needed:
        raise IdentificationError(
            f"u is persistently exciting of order {rank}, this model needs {needed}: fly sharper or more varied inputs"
        )
