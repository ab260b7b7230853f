"""`fit`: from flights to a model, with its quality stated and an unusable result refused; and sweeps of fits.

How good a model is: fit figures on other flights, and correlations of its residual (T 4.1.3, Model validation). A sweep
goes over model orders or filter windows, the thesis's way to choose both (T 5.3, 5.4, Fig 5.5).
"""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import TypeAlias

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import (
    ArxModel,
    Method,
    Order,
    Records,
    Segment,
    check_excitation,
    check_order,
    least_squares,
    polynomials,
    to_segments,
)
from mavdiag.identify.sriv import sriv
from mavdiag.telemetry import FloatArray

Flights: TypeAlias = tuple[Records, Records]  # u and y
Candidate: TypeAlias = tuple[Order, int, Flights, Flights | None]  # window in samples; training, validation flights

#: T 5.4 tried 2 and 3 poles, numerators 0-4, delays 0-4.
ORDERS: tuple[Order, ...] = tuple(product(range(1, 4), range(1, 6), range(5)))
LAGS = 25  # the usual depth of such tests, also MATLAB's resid default
Z99 = 2.5758293035489  # deviations to both sides that hold 99 % of a normal distribution


@dataclass(frozen=True, slots=True)
class Validation:
    """Free-run fit of a model on flights: of what was measured, y, and simulated, y_sim."""

    r2t: float  # R_T^2 = 1 - var(y - y_sim)/var(y), blind to a constant offset (T 5.4)
    nrmse_fit: float  # 100 (1 - |y - y_sim| / |y - mean y|) [%], which sees one (T 4.1.3)
    mse: float  # of y - y_sim [unit of y squared]
    samples: int


def validate(model: ArxModel, u: Records, y: Records, settle_s: float = 0.0) -> Validation:
    """Judge a model on flights: one record each of u and y, (n,), or one per flight.

    Each is simulated from rest; its first `settle_s` [s] do not count. All errors are pooled (T 5.3, 5.4).
    """
    segments = to_segments(u, y, model.order)
    if not 0.0 <= settle_s < math.inf:
        raise IdentificationError(f"the settling time must be 0 or more, not {settle_s} s")
    skip = round(settle_s / model.dt)
    y = np.concatenate([segment.y[skip:] for segment in segments])
    if len(y) == 0:
        raise IdentificationError(f"no record is longer than the settling time of {settle_s} s; lower it")
    if (spread := float(np.var(y))) == 0.0:
        raise IdentificationError("y is constant; there is nothing to explain")
    simulated = np.concatenate([model.simulate(segment.u)[skip:] for segment in segments])
    error, about_mean = y - simulated, float(np.linalg.norm(y - np.mean(y)))
    r2t = 1.0 - float(np.var(error)) / spread
    nrmse_fit = 100.0 * (1.0 - float(np.linalg.norm(error)) / about_mean)
    return Validation(r2t, nrmse_fit, float(np.mean(error**2)), len(y))


@dataclass(frozen=True, slots=True, eq=False)
class ResidualReport:
    """Correlations of a residual e with itself and with the input u (Ljung, System Identification 2e, sec. 16.6)."""

    acf: FloatArray  # (LAGS + 1,) of e(t) with e(t - lag), lag = 0..LAGS
    ccf: FloatArray  # of e(t) with u(t - lag)
    acf_band99: float  # half width that holds 99 % of a true model's values
    ccf_band99: float


def examine_residual(e: FloatArray, u: FloatArray) -> ResidualReport:
    """Correlate a residual e with itself and with the input u at the same rows, both (n,)."""
    if u.shape != e.shape or e.ndim != 1 or len(e) <= 2 * LAGS:
        raise IdentificationError(f"the residual tests need e and u of one length above {2 * LAGS}")
    acf, ccf, input_acf = (_correlations(x, z) for x, z in ((e, e), (e, u), (u, u)))
    # Bartlett: var ccf = sum over k = -lags..lags of r_e(k) r_u(k) / n, for coloured e and u
    widened = math.sqrt(max(1.0, 2 * float(acf @ input_acf) - 1.0))
    return ResidualReport(acf, ccf, Z99 / math.sqrt(len(e)), Z99 * widened / math.sqrt(len(e)))


def _correlations(x: FloatArray, z: FloatArray) -> FloatArray:
    """sum_t x(t) z(t - lag) / sqrt(sum x^2 sum z^2) of the mean-removed x and z at lags 0..LAGS."""
    x, z = x - np.mean(x), z - np.mean(z)
    scale = math.sqrt(float(x @ x) * float(z @ z))
    if scale == 0.0:
        raise IdentificationError("the residual or the input is constant; there is nothing to correlate")
    return np.array([x[lag:] @ z[: len(z) - lag] for lag in range(LAGS + 1)]) / scale


def fit(
    u: Records,
    y: Records,
    order: Order = (2, 2, 1),
    *,
    dt: float,
    method: Method | str = Method.SRIV,
    settle_s: float = 0.0,
    figures: bool = True,
    near: ArxModel | None = None,
    followed: FloatArray | None = None,
) -> ArxModel:
    """Identify A(z^-1) y = B(z^-1) u + e from one record or several (T 4.1.2, 5.4).

    u, y: (n,) each, or sequences of such arrays, one per flight. Offsets are not removed. order: (na, nb, nk). dt:
    sample time [s]. method: "sriv" (unbiased with noise on the output) or "ls" (the thesis's least squares). settle_s:
    start of each record that the figures of fit leave out [s]. figures: False leaves standard errors and figures of
    fit unknown, in half the time. near: a model of the same order and nearly the same data, from which SRIV begins.
    followed: an input that the output equals, (n,), which trains beside the records and is not in the figures of fit.

    >>> rng = np.random.default_rng(1)
    >>> u = rng.standard_normal(500)
    >>> true = ArxModel(np.array([1, -1.2, 0.52]), np.array([0, 0.5, 0.25]), 0.01, (2, 2, 1), Method.PUBLISHED)
    >>> model = fit(u, true.simulate(u), dt=0.01)
    >>> model.a.round(6).tolist(), model.b.round(6).tolist(), round(model.dc_gain, 3)
    ([1.0, -1.2, 0.52], [0.0, 0.5, 0.25], 2.344)

    Raises IdentificationError if the data cannot carry the model, or the model found is unstable.
    """
    order = check_order(order)
    if method not in (Method.LS, Method.SRIV):
        raise IdentificationError(f"method {str(method)!r} is not known; use 'sriv' or 'ls'")
    if not (math.isfinite(dt) and dt > 0):
        raise IdentificationError(f"the sample time must be positive, not {dt} s")
    segments = to_segments(u, y, order)
    check_excitation(segments, order)
    begin = near.theta if near is not None and near.order == order and near.stable else None
    trained = segments if followed is None else [*segments, Segment(followed, followed)]
    if method == Method.SRIV:
        theta, covariance, converged = sriv(trained, order, figures, begin)
    else:
        (theta, covariance), converged = least_squares(trained, order), True
    bare = ArxModel(*polynomials(theta, order), dt, order, Method(method))
    if not bare.stable:
        raise IdentificationError(
            f"the identified model is unstable (pole radius {np.abs(bare.poles[0]):.4f}); lower the order, use sriv, "
            "or record more excited flight"
        )
    if not figures:
        return bare
    if np.diag(covariance).min() < 0:  # but for rounding
        covariance = np.full_like(covariance, np.nan)
    quality = {**asdict(validate(bare, u, y, settle_s)), "samples": sum(map(len, segments))}
    with np.errstate(all="ignore"):  # a perfect fit, or a parameter of 0
        unsure = float(np.mean(np.diag(covariance) / theta**2))
        left = np.maximum((1.0 - quality["r2t"], unsure), 0.0)
        yic = float(np.sum(np.log(left))) if math.isfinite(unsure) else math.inf
    return replace(bare, covariance=covariance, **quality, yic=yic, converged=converged)


@dataclass(frozen=True, slots=True)
class SweepRow:
    """One candidate."""

    order: Order
    window: int  # samples, 0 in an order sweep
    model: ArxModel | None  # None where identification refused
    r2t_validation: float  # R_T^2 on the validation flights, nan without them
    refused: str  # why

    @property
    def score(self) -> float:
        """R_T^2 on the validation flights, or on the training flights where there are none; -inf if refused."""
        if self.model is None:
            return -math.inf
        return self.model.r2t if math.isnan(self.r2t_validation) else self.r2t_validation


def sweep(candidates: Iterable[Candidate], *, dt: float, method: Method | str = Method.SRIV) -> tuple[SweepRow, ...]:
    """Fit each candidate on its training flights and judge it on its validation flights; a row for each.

    R_T^2 is taken against data filtered with the candidate's own window, as in the thesis (T Fig 5.5).
    """
    rows = []
    for order, window, train, validation in candidates:
        try:
            model = fit(*train, order, dt=dt, method=method)
        except IdentificationError as error:
            rows.append(SweepRow(order, window, None, math.nan, str(error)))
            continue
        r2t = validate(model, *validation).r2t if validation is not None else math.nan
        rows.append(SweepRow(order, window, model, r2t, ""))
    return tuple(rows)


def best_row(rows: Iterable[SweepRow]) -> SweepRow:
    """The row with the lowest YIC among those whose R_T^2 is within 0.01 (our choice) of the best."""
    usable = {row: row.model.yic for row in rows if row.model is not None}
    if not usable:
        raise IdentificationError("no candidate could be identified; record longer or more excited flight")
    limit = max(row.score for row in usable) - 0.01
    return min((row for row in usable if row.score >= limit), key=usable.__getitem__)
