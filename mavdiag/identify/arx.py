"""The ARX model A(z^-1) y = B(z^-1) u + e with what is known of it; training data; least squares (T 4.1.2).

Least squares, the thesis's estimator, is biased by output noise.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.jit import cached
from mavdiag.telemetry import FloatArray

if TYPE_CHECKING:
    import control
    from numpy.typing import NDArray

Order: TypeAlias = tuple[int, int, int]  # na, nb, nk
Records: TypeAlias = FloatArray | Sequence[FloatArray]  # one record, or one per segment

BLOCK_ROWS = 256  # rows per block of `triangle`: fits the cache and stays below the size that BLAS threads
ROUNDING = 1e-5  # of the range of a rate: its command, in the same unit, moves no more by rounding (our choice)
EPSILON = float(np.finfo(np.float64).eps)
MIN_ROWS_PER_PARAMETER = 10  # our rule of thumb; below it a standard error means little


class Method(StrEnum):
    """Where a model's coefficients come from."""

    LS = "ls"  # least squares, the thesis's way
    SRIV = "sriv"  # simplified refined instrumental variable
    RLS = "rls"  # recursive least squares, a snapshot of a tracked model
    PUBLISHED = "published"  # printed in the thesis


def check_order(order: Order) -> Order:
    """The order as three plain integers. Raises IdentificationError unless na >= 1, nb >= 1 and nk >= 0."""
    whole = len(order) == 3 and all(isinstance(n, int | np.integer) and not isinstance(n, bool) for n in order)
    if not whole or order[0] < 1 or order[1] < 1 or order[2] < 0:
        raise IdentificationError(f"order {order} must be three whole numbers (na >= 1, nb >= 1, nk >= 0)")
    return int(order[0]), int(order[1]), int(order[2])


@dataclass(frozen=True, slots=True, eq=False)
class ArxModel:
    """A(z^-1) y(t) = B(z^-1) u(t) + e(t), T Eq 4.1-4.5, with read-only arrays.

    a: (na + 1,), a[0] == 1. b: (nk + nb,) with nk leading zeros; unit of y per unit of u. dt: sample time [s].
    order: (na, nb, nk). covariance: (d, d) of the d = na + nb estimates `theta`, nan if unknown: by SRIV for output
    noise of any colour, by LS for white noise in the equation.
    r2t, nrmse_fit, mse: of the training data, nan where unknown, as `Validation`. samples: rows of them.
    yic: Young's information criterion, ln(1 - r2t) + ln(mean(se^2/theta^2)). converged: whether SRIV settled.
    Raises IdentificationError if the coefficients do not fit the order or are not finite. Only `fit` demands stability.
    """

    a: FloatArray
    b: FloatArray
    dt: float
    order: Order
    method: Method
    covariance: FloatArray = field(default_factory=lambda: np.empty(0))
    r2t: float = math.nan
    nrmse_fit: float = math.nan
    mse: float = math.nan
    yic: float = math.nan
    samples: int = 0
    converged: bool = True

    def __post_init__(self) -> None:
        na, nb, nk = check_order(self.order)
        d = na + nb
        covariance = self.covariance if len(self.covariance) else np.full((d, d), np.nan)
        arrays = {"a": self.a, "b": self.b, "covariance": covariance}
        if [values.shape for values in arrays.values()] != [(na + 1,), (nb + nk,), (d, d)]:
            raise IdentificationError(f"order {self.order} needs {na + 1} a, {nb + nk} b and {d} by {d} covariances")
        for name, values in arrays.items():
            copy = np.array(values, dtype=np.float64)
            copy.setflags(write=False)
            object.__setattr__(self, name, copy)
        if not (np.isfinite(self.a).all() and np.isfinite(self.b).all()):
            raise IdentificationError("the coefficients of a model must be finite numbers")
        if self.a[0] != 1.0 or np.any(self.b[:nk] != 0.0):
            raise IdentificationError("a model needs a[0] = 1 and nk leading zeros in b")
        if not (math.isfinite(self.dt) and self.dt > 0):
            raise IdentificationError(f"the sample time must be positive, not {self.dt} s")

    @property
    def lag(self) -> int:
        """Rows of past that the difference equation reaches back."""
        return reach(self.order)

    @property
    def theta(self) -> FloatArray:
        """The estimated parameters, (na + nb,): a1..a_na, then b_nk..b_{nk+nb-1}."""
        return np.concatenate((self.a[1:], self.b[self.order[2] :]))

    @property
    def standard_errors(self) -> FloatArray:
        """Square roots of the covariance's diagonal, (na + nb,), of `theta`."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), dtype=np.float64)

    @property
    def poles(self) -> "NDArray[np.complex128]":
        """Roots of z^na A(z^-1), (na,), largest modulus first."""
        roots = np.roots(self.a).astype(np.complex128)
        return roots[np.argsort(-np.abs(roots), kind="stable")]

    @property
    def stable(self) -> bool:
        """True if every pole is inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1.0))

    @property
    def dc_gain(self) -> float:
        """B(1)/A(1): steady output per unit of constant input; infinite with a pole at 1."""
        denominator = float(np.sum(self.a))
        return float(np.sum(self.b)) / denominator if denominator != 0.0 else math.inf

    def simulate(self, u: FloatArray) -> FloatArray:
        """Free-run output from rest for the inputs u, (n,) -> (n,) (T 5.5)."""
        b, a = (np.pad(one, (0, self.lag + 1 - len(one))) for one in (self.b, self.a))
        y: FloatArray = filtered(b, a, np.array(u, dtype=np.float64)[:, None], np.zeros((len(b), 1)))[:, 0]
        return y

    def predict(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """One-step prediction from the measured past, (n,), (n,) -> (n - lag,): row i predicts y[i + lag]."""
        if u.shape != y.shape or u.ndim != 1 or len(y) <= self.lag:
            raise IdentificationError(f"a prediction needs u and y of one length above {self.lag}")
        known = np.convolve(u, self.b)[: len(y)] - np.convolve(y, self.a)[: len(y)] + y
        return known[self.lag :]

    def to_control(self) -> "control.TransferFunction":
        """The same model as a python-control transfer function in z with this sample time."""
        import control  # seconds to import, and the detector must not carry it

        size = self.lag + 1  # in powers of z both polynomials need one length
        B, A = (np.pad(values, (0, size - len(values))) for values in (self.b, self.a))
        return control.TransferFunction(B, A, self.dt)


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelRecord:
    """An ArxModel as a baseline stores it: plain numbers, checked; stable; None or empty where a figure is unknown."""

    a: tuple[float, ...]
    b: tuple[float, ...]
    dt_s: float
    order: Order
    method: Method
    standard_errors: tuple[float, ...] = ()
    covariance: tuple[tuple[float, ...], ...] = ()
    r2t: float | None = None
    nrmse_fit: float | None = None
    mse: float | None = None
    samples: int = 0

    def __post_init__(self) -> None:
        if not self.model().stable:
            raise IdentificationError("the model is unstable")

    @classmethod
    def of(cls, model: ArxModel) -> "ModelRecord":
        """The record of a model."""
        known = bool(np.isfinite(model.covariance).all())
        r2t, fit, mse = (one if math.isfinite(one) else None for one in (model.r2t, model.nrmse_fit, model.mse))
        return cls(
            a=tuple(model.a.tolist()),
            b=tuple(model.b.tolist()),
            dt_s=model.dt,
            order=model.order,
            method=model.method,
            standard_errors=tuple(model.standard_errors.tolist()) if known else (),
            covariance=tuple(map(tuple, model.covariance.tolist())) if known else (),
            r2t=r2t,
            nrmse_fit=fit,
            mse=mse,
            samples=model.samples,
        )

    def model(self) -> ArxModel:
        """The model, ready to simulate."""
        a, b, covariance = map(np.array, (self.a, self.b, self.covariance))
        r2t, fit, mse = (math.nan if value is None else value for value in (self.r2t, self.nrmse_fit, self.mse))
        return ArxModel(a, b, self.dt_s, self.order, self.method, covariance, r2t, fit, mse, samples=self.samples)


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """An unbroken piece of flight: u and y on the same uniform grid, (n,) each."""

    u: FloatArray
    y: FloatArray

    def __len__(self) -> int:
        return len(self.y)


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
        why = f"too short: {rows} usable rows for {parameters} parameters; record {MIN_ROWS_PER_PARAMETER} for each"
        raise IdentificationError(why)
    for name, records in (("u", us), ("y", ys)):
        if max(float(np.ptp(record)) for record in records) == 0.0:
            raise IdentificationError(f"{name} is constant; fly a trajectory that moves this axis")
    return segments


def without_rounding(u: Sequence[FloatArray], y: Sequence[FloatArray]) -> list[FloatArray]:
    """Records of a command; zero if it was never given, and moves by rounding alone. y: records in the same unit."""
    range_u, range_y = (max(float(np.ptp(record)) for record in records) for records in (u, y))
    return [record * (range_u > ROUNDING * range_y) for record in u]


def _records(values: Records) -> list[FloatArray]:
    try:
        several = not isinstance(values, np.ndarray) and (len(values) == 0 or np.ndim(values[0]) > 0)
        records = values if several else [values]
        return [np.asarray(record).astype(np.float64, casting="safe", copy=False) for record in records]
    except (TypeError, ValueError) as error:
        raise IdentificationError(f"u and y must be arrays of real numbers, or sequences of such: {error}") from error


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
    """x(t - first_lag) .. x(t - first_lag - count + 1) for t = first_row .. n - 1: (n, ...) -> (count, rows, ...)."""
    return np.stack([x[first_row - lag : len(x) - lag] for lag in range(first_lag, first_lag + count)])


def regressors(segment: Segment, order: Order) -> tuple[FloatArray, FloatArray]:
    """Phi' (na + nb, rows) and target (rows,) of a segment, from t = `reach(order)` on."""
    na, nb, nk = order
    first = reach(order)
    # y(t) = [ -y(t-1) ... -y(t-na)  u(t-nk) ... u(t-nk-nb+1) ] @ [ a_1 .. a_na  b_nk .. b_{nk+nb-1} ]'
    Phi = np.concatenate((-lagged(segment.y, 1, na, first), lagged(segment.u, nk, nb, first)))
    return Phi, segment.y[first:]


@cached
def filtered(b: FloatArray, a: FloatArray, x: FloatArray, begun: FloatArray) -> FloatArray:
    """y of A y = B x, (n, m) -> (n, m), in the transposed direct form; b, a: (k,) with a[0] = 1.

    begun: (k, m) states that the columns begin with, the last one 0. scipy.signal has the same; to load it takes 1.5 s.
    """
    y, states = np.empty_like(x), begun.copy()
    for t in range(len(x)):
        now, out = x[t], y[t]
        for j in range(x.shape[1]):  # none of them waits for another
            out[j] = b[0] * now[j] + states[0, j]
        for k in range(1, len(b)):
            state, after, gain, share = states[k - 1], states[k], b[k], a[k]
            for j in range(x.shape[1]):
                state[j] = gain * now[j] - share * out[j] + after[j]
    return y


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


def least_squares(segments: Sequence[Segment], order: Order) -> tuple[FloatArray, FloatArray]:
    """Least-squares theta over the rows of all segments, and its covariance (Phi' Phi)^-1 e'e/(n - d)."""
    stacked = np.concatenate([np.vstack(regressors(segment, order)) for segment in segments], axis=1)  # [ Phi  y ]'
    d, n = order[0] + order[1], stacked.shape[1]
    R = triangle(stacked.T)
    Phi, target = R[:, :d], R[:, d]
    theta, spread = solve(Phi, Phi, target, n * EPSILON)
    return theta, spread * float(np.sum((target - Phi @ theta) ** 2)) / (n - d)
