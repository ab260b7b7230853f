"""From healthy flights to a baseline: measure the link, identify the models, set the margins and latencies.

The residuals that set a margin come from a model that did not see the flight they belong to: the flights are dealt
into folds, and each fold is judged by a model of the others (with one flight there is nothing else to judge by, and
the baseline says so). The model that the baseline keeps is fitted to all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag import __version__
from mavdiag.baseline import (
    Airframe,
    AxisModel,
    Baseline,
    GateLimits,
    LatencyMonitor,
    Link,
    Provenance,
    SourceLog,
    Window,
    sealed,
)
from mavdiag.diagnose.calibrate import (
    MarginRule,
    ResidualPiece,
    false_alarms_per_flight,
    latency_of,
    margin_of,
)
from mavdiag.diagnose.monitors.base import Rows
from mavdiag.diagnose.residual import residual, start
from mavdiag.errors import IdentificationError, InputError
from mavdiag.identify import ArxModel, Method, Order, fit
from mavdiag.pipeline import Front
from mavdiag.quantities import NS_PER_S, Axis, FloatArray, Signal, Telemetry
from mavdiag.signal.align import AlignSpec, Grid, measure_grid
from mavdiag.signal.gate import GateSpec
from mavdiag.signal.rates import RateSpec
from mavdiag.signal.savgol import window_samples

__all__ = [
    "Flight",
    "LearnOptions",
    "LearntFlight",
    "airborne",
    "front_for",
    "gate_for",
    "learn",
    "residuals_of",
    "rows_of",
    "training_pieces",
]

FOLDS = 5  # as many models as that share the work of judging flights they did not see (our choice)
TRAIN_ROWS = 60_000  # one minute at 1 kHz: beyond it a model's standard errors no longer matter (our choice)
SETTLE_S = 1.0  # of each stretch that does not count in the figures of fit: it may begin in motion (our choice)
MIN_PIECE_S = 2.0  # shorter valid stretches do not train a model (our choice)
MAX_GAP_S = 0.035  # METHOD section 4: gaps up to 35 ms may be interpolated
SLOW_SETPOINT_PERIODS = 2.5  # a set-point stream slower than the gyro has gaps by nature (our choice)

# Airborne limits by log profile. A Crazyflie's log has no arming state; its limits are those that its recordings were
# found to need (height 0.38 m, thrust 25000 of 65535, 0.5 s and 0.6 s off the ends).
_GATES = {
    "crazyflie": GateSpec(min_height_m=0.38, min_thrust=0.38, need_armed=False, trim_start_s=0.5, trim_end_s=0.6),
}
_MAVLINK_GATE = GateSpec(min_thrust=0.1, need_armed=True)  # our choice: armed, and more than idle thrust


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """One healthy flight. sha256: of the file it came from, or of its bytes on the wire."""

    name: str
    sha256: str
    profile: str
    telemetry: Telemetry


@dataclass(frozen=True, slots=True)
class LearnOptions:
    """How to learn. window_s: Savitzky-Golay window; airframe: the name to give; scope: one airframe or a type."""

    axes: tuple[Axis, ...] = (Axis.ROLL, Axis.PITCH)
    method: Method = Method.SRIV
    order: Order = (2, 2, 1)
    window_s: float = 0.1
    margin_rule: MarginRule = MarginRule.PERCENTILE_90
    airframe: str = "unnamed"
    scope: str = "airframe"


@dataclass(frozen=True, slots=True, eq=False)
class LearntFlight:
    """A flight's rows of healthy flying, in order, and how long of them may be judged [s]."""

    flight: Flight
    rows: tuple[Rows, ...]
    judged_s: float


def gate_for(profile: str) -> GateSpec:
    """What counts as flying on a link of this profile."""
    return _GATES.get(profile, _MAVLINK_GATE)


def front_for(flights: Sequence[Flight], window_s: float) -> Front:
    """The front that suits all the flights. Raises InputError if they do not belong to one kind of link."""
    profiles = sorted({flight.profile for flight in flights})
    if len(profiles) != 1:
        raise InputError(f"the flights come over different links ({', '.join(profiles)}); learn from one kind")
    measured = [measure_grid(flight.telemetry) for flight in flights]
    periods = np.array([dt_s for dt_s, _ in measured])
    dt_s = float(np.median(periods))
    if np.any(np.abs(periods / dt_s - 1) > 0.02):
        slow, fast = 1 / periods.max(), 1 / periods.min()
        raise InputError(f"the flights have different gyro rates ({slow:.1f} to {fast:.1f} Hz); learn from one rate")
    grid = Grid.NATIVE if all(grid is Grid.NATIVE for _, grid in measured) else Grid.RESAMPLED
    align = AlignSpec(dt_s, grid, max_gap_s=_gap_limit(flights))
    return Front(align, gate_for(profiles[0]), RateSpec.of(dt_s, window_samples(dt_s, window_s)))


def rows_of(front: Front, telemetry: Telemetry) -> tuple[Rows, ...]:
    """All rows of a whole flight."""
    state, rows = front.step(front.start(), telemetry)
    _, rest = front.finish(state)
    return (*rows, *rest)


def learn(flights: Sequence[Flight], options: LearnOptions, *, created: str) -> Baseline:
    """A baseline from healthy flights. created: time stamp to record, ISO 8601 UTC.

    Raises InputError if a flight lacks a signal or is never airborne, and IdentificationError if the flights cannot
    carry the model; both name the flight or the axis and say what to do.
    """
    if not flights:
        raise InputError("no healthy flight to learn from")
    for flight in flights:
        _check_signals(flight)
    front = front_for(flights, options.window_s)
    learnt = [airborne(front, flight) for flight in flights]
    models, monitors = [], []
    for axis in options.axes:
        model, monitor = _learn_axis(learnt, axis, front.align.dt_s, options)
        models.append(model)
        monitors.append(monitor)
    return sealed(
        Baseline(
            airframe=Airframe(name=options.airframe, scope="type" if options.scope == "type" else "airframe"),
            link=_link(flights[0].profile, front),
            window=Window(samples=front.rates.window, order=2),
            models=tuple(models),
            monitors=tuple(monitors),
            healthy_hours=sum(one.judged_s for one in learnt) / 3600,
            provenance=Provenance(
                logs=tuple(
                    SourceLog(name=one.flight.name, sha256=one.flight.sha256, judged_s=one.judged_s) for one in learnt
                ),
                created=created,
                tool=f"mavdiag {__version__}",
            ),
        )
    )


def _check_signals(flight: Flight) -> None:
    for signal in (Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT):
        try:
            flight.telemetry.need(signal)
        except InputError as error:
            raise InputError(f"{flight.name}: {error}") from error


def _gap_limit(flights: Sequence[Flight]) -> float:
    """35 ms, or a few periods of a set-point stream that is slower than that."""
    steps = [np.diff(np.unique(flight.telemetry.need(Signal.ATTITUDE_SETPOINT).t_ns)) for flight in flights]
    period_s = float(np.median(np.concatenate(steps))) / NS_PER_S if any(len(s) for s in steps) else 0.0
    return max(MAX_GAP_S, SLOW_SETPOINT_PERIODS * period_s)


def airborne(front: Front, flight: Flight) -> LearntFlight:
    """The flying part of a flight. Raises InputError if it is under a second."""
    rows = rows_of(front, flight.telemetry)
    judged_s = float(sum(int(one.rates.valid.sum()) for one in rows)) * front.align.dt_s
    if judged_s < MIN_PIECE_S:
        raise InputError(f"{flight.name}: only {judged_s:.1f} s of airborne flight, too short to learn from")
    return LearntFlight(flight, rows, judged_s)


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


def _train(flights: Sequence[LearntFlight], axis: Axis, dt_s: float, options: LearnOptions) -> ArxModel:
    """A model of one axis from as many of the flights as fit into TRAIN_ROWS."""
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
    flights: Sequence[LearntFlight], axis: Axis, model: ArxModel, dt_s: float, options: LearnOptions
) -> list[list[ResidualPiece]]:
    """Residuals of every flight by a model of the other folds; by `model` itself if there is only one flight."""
    if len(flights) == 1:
        return [residuals_of(flights[0], axis, model)]
    folds = min(FOLDS, len(flights))
    models = [
        _train([one for i, one in enumerate(flights) if i % folds != fold], axis, dt_s, options)
        for fold in range(folds)
    ]
    return [residuals_of(flight, axis, models[i % folds]) for i, flight in enumerate(flights)]


def _learn_axis(
    flights: Sequence[LearntFlight], axis: Axis, dt_s: float, options: LearnOptions
) -> tuple[AxisModel, LatencyMonitor]:
    model = _train(flights, axis, dt_s, options)
    residuals = _unseen_residuals(flights, axis, model, dt_s, options)
    margin = margin_of(residuals, options.margin_rule)
    longest = latency_of(residuals, margin)
    monitor = LatencyMonitor(
        axis=axis,
        margin_rad_s=margin,
        margin_rule=options.margin_rule,
        fml_s=float(longest.max()),
        longest_run_s=tuple(longest.tolist()),
        false_alarms_per_flight=false_alarms_per_flight(len(flights)),
    )
    return _axis_model(axis, model), monitor


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


def _link(profile: str, front: Front) -> Link:
    gate = front.gate
    return Link(
        profile=profile,
        dt_s=front.align.dt_s,
        grid=front.align.grid,
        max_gap_s=front.align.max_gap_s,
        gate=GateLimits(
            min_height_m=gate.min_height_m,
            min_thrust=gate.min_thrust,
            need_armed=gate.need_armed,
            trim_start_s=gate.trim_start_s,
            trim_end_s=gate.trim_end_s,
        ),
    )
