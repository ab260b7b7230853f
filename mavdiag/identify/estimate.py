"""`fit`: from flights to a model, with its quality stated and an unusable result refused; and sweeps of fits.

A sweep goes over model orders or filter windows, the thesis's way to choose both (T 5.3, 5.4, Fig 5.5).
"""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import TypeAlias

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import Records, check_excitation, least_squares, polynomials, to_segments
from mavdiag.identify.model import ArxModel, Method, Order, check_order
from mavdiag.identify.sriv import sriv
from mavdiag.identify.validate import free_run, validate

Flights: TypeAlias = tuple[Records, Records]  # u and y
Candidate: TypeAlias = tuple[Order, int, Flights, Flights | None]  # window in samples; training, validation flights

#: T 5.4 tried 2 and 3 poles, numerators 0-4, delays 0-4.
ORDERS: tuple[Order, ...] = tuple(product(range(1, 4), range(1, 6), range(5)))


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
) -> ArxModel:
    """Identify A(z^-1) y = B(z^-1) u + e from one record or several (T 4.1.2, 5.4).

    u, y: (n,) each, or sequences of such arrays, one per flight. Offsets are not removed. order: (na, nb, nk). dt:
    sample time [s]. method: "sriv" (unbiased with noise on the output) or "ls" (the thesis's least squares). settle_s:
    start of each record that the figures of fit leave out [s]. figures: False leaves standard errors and figures of
    fit unknown, in half the time. near: a model of the same order and nearly the same data, from which SRIV begins.

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
    estimate = sriv(segments, order, figures, begin) if method == Method.SRIV else least_squares(segments, order)
    bare = ArxModel(*polynomials(estimate.theta, order), dt, order, Method(method))
    if not bare.stable:
        raise IdentificationError(
            f"the identified model is unstable (pole radius {np.abs(bare.poles[0]):.4f}); lower the order, use sriv, "
            "or record more excited flight"
        )
    if not figures:
        return bare
    quality = free_run(bare, segments, settle_s)
    with np.errstate(all="ignore"):  # a perfect fit, or a parameter of 0
        unsure = float(np.mean(np.diag(estimate.covariance) / estimate.theta**2))
        yic = float(np.sum(np.log(np.maximum((1.0 - quality.r2t, unsure), 0.0)))) if math.isfinite(unsure) else math.inf
    return replace(
        bare,
        standard_errors=np.empty(0),
        covariance=estimate.covariance,
        **{**asdict(quality), "samples": sum(map(len, segments))},
        yic=yic,
        iterations=estimate.iterations,
        converged=estimate.converged,
    )


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


def best_row(rows: Iterable[SweepRow], tolerance: float = 0.01) -> SweepRow:
    """The row with the lowest YIC among those whose R_T^2 is within `tolerance` (our choice) of the best."""
    usable = {row: row.model.yic for row in rows if row.model is not None}
    if not usable:
        raise IdentificationError("no candidate could be identified; record longer or more excited flight")
    limit = max(row.score for row in usable) - tolerance
    return min((row for row in usable if row.score >= limit), key=usable.__getitem__)
