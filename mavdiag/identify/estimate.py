"""`fit`: from flights to a model, with its quality stated and an unusable result refused."""

import math
from dataclasses import asdict, replace

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import Records, check_excitation, least_squares, polynomials, to_segments
from mavdiag.identify.model import ArxModel, Method, Order, check_order
from mavdiag.identify.sriv import sriv
from mavdiag.identify.validate import free_run


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
