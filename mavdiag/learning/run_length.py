"""Models of the axes, and the thesis's margin and FML by residuals that the model did not see (T 4.4.3, 5.5).

The flights are dealt into folds, and each fold is judged by a model of the others; with one flight there is nothing
else to judge by. The model that the baseline keeps is fitted to all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.baseline import AxisModel
from mavdiag.errors import IdentificationError
from mavdiag.identify import ArxModel, Method, Order, fit
from mavdiag.learning.flights import LearntFlight
from mavdiag.monitors.exceedance import exceedance
from mavdiag.monitors.exceedance import start as no_run
from mavdiag.monitors.margin import MarginRule, ResidualPiece, latency_of, margin_of
from mavdiag.monitors.residual import residual, start
from mavdiag.monitors.run_length import RunLengthSpec
from mavdiag.telemetry import NS_PER_S, Axis, FloatArray
from mavdiag.thresholds.heldout import BLOCK_S, Scores
from mavdiag.thresholds.rule import Threshold, ThresholdRule, threshold_of

__all__ = ["ModelOptions", "learn_axis", "residuals_of", "train", "training_pieces"]

FOLDS = 5  # as many models as that share the work of judging flights they did not see (our choice)
TRAIN_ROWS = 60_000  # one minute at 1 kHz: beyond it a model's standard errors no longer matter (our choice)
SETTLE_S = 1.0  # of each stretch that does not count in the figures of fit: it may begin in motion (our choice)
MIN_PIECE_S = 2.0  # shorter valid stretches do not train a model (our choice)


@dataclass(frozen=True, slots=True)
class ModelOptions:
    """How models and margins are made."""

    method: Method = Method.SRIV
    order: Order = (2, 2, 1)
    margin_rule: MarginRule = MarginRule.PERCENTILE_90


def training_pieces(flight: LearntFlight, axis: Axis) -> list[tuple[FloatArray, FloatArray]]:
    """Unbroken valid stretches of u and y of one axis, long enough to train on."""
    pieces = []
    for rows in flight.rows:
        rates = rows.rates
        edges = np.flatnonzero(np.diff(rates.valid, prepend=False, append=False))
        for first, stop in zip(edges[::2], edges[1::2], strict=True):
            if (stop - first) * rates.dt_s >= MIN_PIECE_S:
                pieces.append((rates.u[first:stop, axis.column], rates.y[first:stop, axis.column]))
    return pieces


def train(flights: Sequence[LearntFlight], axis: Axis, dt_s: float, options: ModelOptions) -> ArxModel:
    """A model of one axis from as many of the flights as fit into TRAIN_ROWS. Raises IdentificationError."""
    chosen: list[tuple[FloatArray, FloatArray]] = []
    for flight in flights:
        if sum(len(u) for u, _ in chosen) < TRAIN_ROWS:
            chosen += training_pieces(flight, axis)
    if not chosen:
        raise IdentificationError(f"{axis}: no unbroken stretch of {MIN_PIECE_S:.0f} s to identify from; fly longer")
    try:
        model = fit(
            [u for u, _ in chosen],
            [y for _, y in chosen],
            options.order,
            dt=dt_s,
            method=options.method,
            settle_s=SETTLE_S,
        )
    except IdentificationError as error:
        raise IdentificationError(f"{axis}: {error}") from error
    if model.dc_gain < 0:
        raise IdentificationError(
            f"{axis}: the gyro turns against its set-point (gain {model.dc_gain:.2f}); check the sign conventions"
        )
    return model


def residuals_of(flight: LearntFlight, axis: Axis, model: ArxModel) -> list[ResidualPiece]:
    """Free-run residual of each piece of a flight."""
    pieces, state = [], start()
    for rows in flight.rows:
        state, r = residual(model, axis, state, rows.rates)
        pieces.append(ResidualPiece(rows.rates.t_ns, r, rows.rates.valid, rows.rates.dt_s))
    return pieces


def _unseen_residuals(
    flights: Sequence[LearntFlight], axis: Axis, model: ArxModel, dt_s: float, options: ModelOptions
) -> list[list[ResidualPiece]]:
    """Residuals of every flight by a model of the other folds; by `model` itself if there is only one flight."""
    if len(flights) == 1:
        return [residuals_of(flights[0], axis, model)]
    folds = min(FOLDS, len(flights))
    models = [
        train([one for i, one in enumerate(flights) if i % folds != fold], axis, dt_s, options) for fold in range(folds)
    ]
    return [residuals_of(flight, axis, models[i % folds]) for i, flight in enumerate(flights)]


def learn_axis(
    flights: Sequence[LearntFlight],
    axis: Axis,
    dt_s: float,
    options: ModelOptions,
    *,
    rule: ThresholdRule,
    budget_per_hour: float,
) -> tuple[AxisModel, RunLengthSpec, Threshold]:
    """Model, margin and FML of one axis. rule: FML as the longest healthy run, or as an extreme-value level of it."""
    model = train(flights, axis, dt_s, options)
    residuals = _unseen_residuals(flights, axis, model, dt_s, options)
    margin = margin_of(residuals, options.margin_rule)
    longest = latency_of(residuals, margin)
    if rule is ThresholdRule.MAXIMUM:
        judged_s = sum(one.judged_s for one in flights)
        scores = Scores(longest, judged_s, judged_s / len(flights))
    else:
        scores = _block_scores(residuals, margin)
    threshold = threshold_of(scores, flights=len(flights), budget_per_hour=budget_per_hour, rule=rule)
    spec = RunLengthSpec(
        axis=axis, margin_rad_s=margin, margin_rule=options.margin_rule, longest_run_s=tuple(longest.tolist())
    )
    return _axis_model(axis, model), spec, threshold


def _block_scores(flights: Sequence[Sequence[ResidualPiece]], margin: float) -> Scores:
    """Longest run within each block of flight; a remainder of half a block counts."""
    maxima: list[float] = []
    judged_s = 0.0
    for piece in (piece for flight in flights for piece in flight if piece.valid.any()):
        _, trace = exceedance(no_run(), piece.r, piece.valid, margin=margin, dt_s=piece.dt_s)
        t_s = (piece.t_ns - piece.t_ns[np.argmax(piece.valid)]) / NS_PER_S
        number = np.floor(t_s / BLOCK_S).astype(np.int64)
        for one in np.unique(number[number >= 0]):
            inside = (number == one) & piece.valid
            if one == 0 or np.count_nonzero(inside) * piece.dt_s >= BLOCK_S / 2:
                maxima.append(float(trace.fsd_s[inside].max(initial=0.0)))
        judged_s += float(np.count_nonzero(piece.valid)) * piece.dt_s
    return Scores(np.array(maxima), judged_s)


def _axis_model(axis: Axis, model: ArxModel) -> AxisModel:
    return AxisModel(
        axis=axis,
        order=model.order,
        method="ls" if model.method is Method.LS else "sriv",
        a=tuple(model.a.tolist()),
        b=tuple(model.b.tolist()),
        standard_errors=tuple(model.standard_errors.tolist()),
        r2t=model.r2t,
        nrmse_fit=model.nrmse_fit,
        mse=model.mse,
        rows=model.samples,
    )
