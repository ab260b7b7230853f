"""From healthy flights to a baseline: measure the link, identify the models, set the thresholds."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mavdiag import __version__
from mavdiag.airframe.layout import RotorLayout, detect_layout, layout_named
from mavdiag.baseline import (
    Airframe,
    Baseline,
    GateLimits,
    Link,
    MonitorEntry,
    Provenance,
    Scope,
    SourceLog,
    Window,
    sealed,
)
from mavdiag.chain import Front
from mavdiag.errors import InputError, UsageError
from mavdiag.identify import Method, Order
from mavdiag.learning.flights import Flight, LearntFlight, airborne, check_signals, front_for
from mavdiag.learning.monitors import KINDS, LearnContext, learn_monitors
from mavdiag.learning.run_length import ModelOptions, learn_axis
from mavdiag.link.profiles import PROFILES
from mavdiag.monitors.margin import MarginRule
from mavdiag.telemetry import Axis
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, ThresholdRule

__all__ = ["ALL_MONITORS", "LearnOptions", "learn", "thesis_options"]

LATENCY = "latency"
ALL_MONITORS = (LATENCY, *KINDS)
# Rotor layouts that a profile implies; of other vehicles it is found from their own flights, or told.
_FRAMES = {"qdrone2": "qdrone2", "spec": "qdrone2", "crazyflie": "crazyflie"}
_QDRONE2_HOVER = (1.504, 10_000 * math.pi / 30)  # T Table 5.1 and 3.2.2: 1.504 kg at about 10,000 rpm
_HOVERS = {"qdrone2": _QDRONE2_HOVER, "spec": _QDRONE2_HOVER}


@dataclass(frozen=True, slots=True)
class LearnOptions:
    """How to learn.

    axes: to model and to watch by the thesis's rule. window_s: Savitzky-Golay window. airframe: the name to give;
    scope: one airframe or a type. monitors: kinds to use. rule: how thresholds follow from healthy maxima.
    alarms_per_hour: budget of all monitors together. frame: rotor layout, None to find it. hover: mass [kg]
    and the rotor speed that carries it [rad/s], to tell vibration in g mm.
    """

    axes: tuple[Axis, ...] = (Axis.ROLL, Axis.PITCH)
    method: Method = Method.SRIV
    order: Order = (2, 2, 1)
    window_s: float = 0.1
    margin_rule: MarginRule = MarginRule.PERCENTILE_90
    airframe: str = "unnamed"
    scope: Scope = "airframe"
    monitors: tuple[str, ...] = ALL_MONITORS
    rule: ThresholdRule = ThresholdRule.GUMBEL
    alarms_per_hour: float = BUDGET_PER_HOUR
    frame: str | None = None
    hover: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        unknown = [name for name in self.monitors if name not in ALL_MONITORS]
        if unknown or not self.monitors:
            raise UsageError(f"no monitor {', '.join(unknown) or 'named'}; there are {', '.join(ALL_MONITORS)}")
        if not self.alarms_per_hour > 0:
            raise UsageError(f"alarms per hour must be positive, not {self.alarms_per_hour:g}")


def thesis_options(airframe: str = "unnamed", axes: tuple[Axis, ...] = (Axis.ROLL,)) -> LearnOptions:
    """The thesis's own way: one monitor, FML the longest healthy run, roll the primary axis (T 5.5)."""
    return LearnOptions(axes=axes, airframe=airframe, monitors=(LATENCY,), rule=ThresholdRule.MAXIMUM)


def learn(flights: Sequence[Flight], options: LearnOptions, *, created: str) -> Baseline:
    """A baseline from healthy flights. created: time stamp to record, ISO 8601 UTC.

    Raises InputError if a flight lacks a signal or is never airborne, and IdentificationError if the flights cannot
    carry the model; both name the flight or the axis and say what to do.
    """
    if not flights:
        raise InputError("no healthy flight to learn from")
    for flight in flights:
        check_signals(flight)
    front = front_for(flights, options.window_s)
    learnt = [airborne(front, flight) for flight in flights]
    profile, frame = flights[0].profile, _frame(learnt, flights[0].profile, options)
    share = options.alarms_per_hour / len(options.monitors)
    models, entries = [], []
    for axis in options.axes:
        per_axis = share / len(options.axes)
        how = ModelOptions(options.method, options.order, options.margin_rule)
        model, spec, threshold = learn_axis(
            learnt, axis, front.align.dt_s, how, rule=options.rule, budget_per_hour=per_axis
        )
        models.append(model)
        if LATENCY in options.monitors:
            entries.append(MonitorEntry(spec=spec, threshold=threshold))
    corner = PROFILES[profile].imu_corner_hz if profile in PROFILES else None
    context = LearnContext(frame, corner, options.hover or _HOVERS.get(profile), options.rule, share)
    others = [name for name in options.monitors if name != LATENCY]
    more, refusals = learn_monitors(others, [one.rows for one in learnt], context)
    return sealed(
        Baseline(
            airframe=Airframe(name=options.airframe, scope=options.scope, frame=None if frame is None else frame.name),
            link=_link(profile, front),
            window=Window(samples=front.rates.window, order=2),
            models=tuple(models),
            monitors=(*entries, *more),
            not_judgeable=tuple(refusals),
            healthy_hours=sum(one.judged_s for one in learnt) / 3600,
            provenance=_provenance(learnt, created),
        )
    )


def _frame(flights: Sequence[LearntFlight], profile: str, options: LearnOptions) -> RotorLayout | None:
    name = options.frame or _FRAMES.get(profile)
    return layout_named(name) if name else detect_layout([rows for one in flights for rows in one.rows])


def _provenance(flights: Sequence[LearntFlight], created: str) -> Provenance:
    logs = tuple(SourceLog(name=one.flight.name, sha256=one.flight.sha256, judged_s=one.judged_s) for one in flights)
    return Provenance(logs=logs, created=created, tool=f"mavdiag {__version__}")


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
