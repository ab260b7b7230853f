"""From healthy flights to a baseline: measure the link, fit the monitors, set their thresholds."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from mavdiag import __version__
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.fingerprint import fingerprint_of
from mavdiag.baseline import Baseline, sealed, without_mute
from mavdiag.baseline_parts import HealthyScores, Link, MonitorEntry, Provenance, Refusal, SourceLog, Window
from mavdiag.errors import IdentificationError, InputError, UsageError
from mavdiag.identify import Method, Order
from mavdiag.learning.damage import grade_of, least_damage
from mavdiag.learning.fits import fits
from mavdiag.learning.flights import LearntFlight, sessions_of
from mavdiag.learning.guards import courses, suspicions
from mavdiag.learning.held import HeldLog, held
from mavdiag.learning.rotors import of_log_kind, with_rotors
from mavdiag.learning.teaching import Taught, believing, one_vehicle, taught_of
from mavdiag.link.profiles import PROFILES
from mavdiag.monitors import BY_NAME, by_name, monitor_of
from mavdiag.monitors.base import FaultKind, Flights, LearnContext
from mavdiag.monitors.conditions import covered_by
from mavdiag.monitors.run_length import MarginRule, RunLength
from mavdiag.rows.front import Front
from mavdiag.storage import Shelf
from mavdiag.telemetry import Axis, Log
from mavdiag.thresholds.heldout import Scores
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, ThresholdRule, threshold_of

__all__ = ["ALL_MONITORS", "LearnOptions", "learn", "plain_scores", "sources", "thesis_options"]

ALL_MONITORS = tuple(BY_NAME)
MOST_SAID = 2  # findings that are told in full (our choice)


@dataclass(frozen=True, slots=True)
class LearnOptions:
    """How to learn.

    axes: the axes that the thesis's monitor models and watches.
    method, order: how its models are fitted.
    window_s: Savitzky-Golay window [s].
    margin_rule: the margin of the thesis's monitor.
    airframe: the vehicle, as far as it is known.
    monitors: names of the monitors to use.
    rule: how thresholds follow from healthy maxima.
    alarms_per_hour: budget of all deciding monitors together.
    sessions: how many sessions the flights were flown in, in equal parts and in their order; None for what their
        wall-clock times say, and for one each where a log has none.
    robust: what the guards of teaching find is left out instead of refused (see `mavdiag.learning.guards`).
    Raises UsageError for a monitor that there is not, or a budget that is not positive.
    """

    axes: tuple[Axis, ...] = (Axis.ROLL, Axis.PITCH)
    method: Method = Method.SRIV
    order: Order = (2, 2, 1)
    window_s: float = 0.1
    margin_rule: MarginRule = MarginRule.PERCENTILE_90
    airframe: Airframe = field(default_factory=Airframe)
    monitors: tuple[str, ...] = ALL_MONITORS
    rule: ThresholdRule = ThresholdRule.GUMBEL
    alarms_per_hour: float = BUDGET_PER_HOUR
    sessions: int | None = None
    robust: bool = False

    def __post_init__(self) -> None:
        for name in self.monitors:
            by_name(name)
        if not self.monitors:
            raise UsageError(f"no monitor named; there are {', '.join(ALL_MONITORS)}")
        if not self.alarms_per_hour > 0:
            raise UsageError(f"alarms per hour must be positive, not {self.alarms_per_hour:g}")
        if self.sessions is not None and self.sessions < 1:
            raise UsageError(f"sessions must be 1 or more, not {self.sessions}")


def thesis_options(airframe: Airframe | None = None, axes: tuple[Axis, ...] = (Axis.ROLL,)) -> LearnOptions:
    """The thesis's own way: one monitor, FML the longest healthy run, roll the primary axis (T 5.5)."""
    return LearnOptions(
        axes=axes, airframe=airframe or Airframe(), monitors=(RunLength.name,), rule=ThresholdRule.MAXIMUM
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """A monitor's fit to all flights, and what its statistic reached on flights that a fit did not see."""

    spec: Any
    scores: Scores
    decides: bool


def learn(flights: Iterable[Log], options: LearnOptions, *, created: str) -> Baseline:
    """A baseline from healthy flights. created: time stamp to record, ISO 8601 UTC.

    Each flight is taken once, and put aside on a shelf that goes to disk if there are many: flights that are read as
    they are taken, `(read_log(path) for path in paths)`, are never in memory together.

    A monitor that cannot work on such flights is recorded with its reason, and hinders no other.
    Raises InputError if a flight lacks the gyro or never flies, and IdentificationError if no monitor can work; both
    say what to do.
    """
    with Shelf() as shelf:
        return _learnt([held(log, shelf) for log in flights], options, created, shelf)


def _learnt(logs: Sequence[HeldLog], options: LearnOptions, created: str, shelf: Shelf) -> Baseline:
    if not logs:
        raise InputError("no healthy flight to learn from")
    first = logs[0].label
    airframe = _filtered(of_log_kind(options.airframe, first.profile), first)
    found = believing(taught_of(logs, options.window_s, airframe.gate, shelf, robust=options.robust), shelf)
    airframe, ordered = with_rotors(airframe, found.flights)
    found = replace(found, flights=tuple(ordered))
    if airframe.scope != "type":
        found = one_vehicle(found, airframe.layout, robust=options.robust)
    front, learnt, rows = found.front, found.flights, [one.rows for one in found.flights]
    sessions = sessions_of([one.label for one in learnt], options.sessions)
    unknown = airframe.layout_basis if airframe.layout is None else ""
    context = _context(options, airframe, front, first)
    fitted, refusals = _fit_all(rows, sessions, options, context, unknown, shelf)
    if not fitted:
        reasons = "; ".join(f"{one.monitor}: {one.reason}" for one in refusals)
        raise IdentificationError(f"no monitor can judge such flights ({reasons})")
    entries = _entries(fitted, options, sessions)
    baseline = Baseline(
        airframe=airframe,
        link=Link(
            profile=first.profile,
            dt_s=front.align.dt_s,
            grid=front.align.grid,
            max_gap_s=front.align.max_gap_s,
            gate=front.gate,
        ),
        window=Window(samples=front.rates.window, order=2),
        link_quality=front.align.quality,
        monitors=tuple(entries),
        not_judgeable=tuple(refusals),
        envelope=covered_by(rows),
        healthy_hours=sum(one.judged_s for one in learnt) / 3600,
        provenance=_provenance(found, sessions, created),
        fingerprint=fingerprint_of(rows, airframe.layout),
    )
    return sealed(assessed(baseline, learnt))


def assessed(baseline: Baseline, flights: Sequence[LearntFlight]) -> Baseline:
    """The baseline with what these flights of it say of its worth, and without monitors that cannot alarm.

    Raises IdentificationError if none is left.
    """
    found = courses([entry.spec for entry in baseline.monitors], flights)
    limits = {entry.spec.kind: entry.threshold.value for entry in baseline.monitors}
    least = least_damage(found, limits, baseline.airframe)
    judging, refusals = without_mute(baseline.monitors, "learn from calmer flights, or from more of them")
    if not judging:
        raise IdentificationError(f"no monitor can judge such flights ({'; '.join(one.reason for one in refusals)})")
    said = [str(one) for one in suspicions(found, baseline.airframe)]
    more = f" (and {len(said) - MOST_SAID} more such findings)" if len(said) > MOST_SAID else ""
    weak = "; ".join(said[:MOST_SAID]) + more
    return baseline.model_copy(
        update={
            "monitors": judging,
            "not_judgeable": (*baseline.not_judgeable, *refusals),
            "least_damage": least,
            "weak": weak,
            "grade": grade_of(least, weak=bool(weak), blind=[one.monitor for one in refusals]),
        }
    )


def _filtered(airframe: Airframe, flight: Log) -> Airframe:
    """The airframe with the corner of its IMU's filter, where it was not told and the vehicle's parameters have it."""
    name = PROFILES[flight.profile].imu_corner_parameter if flight.profile in PROFILES else ""
    told_hz = flight.parameters.get(name, 0.0)
    return replace(airframe, imu_corner_hz=told_hz) if airframe.imu_corner_hz is None and told_hz > 0.0 else airframe


def _context(options: LearnOptions, airframe: Airframe, front: Front, flight: Log) -> LearnContext:
    link = PROFILES.get(flight.profile)
    corner_hz = airframe.imu_corner_hz or (link.corner_hz(flight.parameters) if link is not None else None)
    return LearnContext(
        airframe=airframe,
        imu_corner_hz=corner_hz,
        dt_s=front.align.dt_s,
        window=front.rates.window,
        axes=options.axes,
        method=options.method,
        order=options.order,
        margin_rule=options.margin_rule,
    )


def _fit_all(
    flights: Flights, sessions: Sequence[int], options: LearnOptions, context: LearnContext, unknown: str, shelf: Shelf
) -> tuple[list[_Fitted], list[Refusal]]:
    """Every named monitor that can work on these flights, and the reason of each that cannot."""
    fitted: list[_Fitted] = []
    refusals: list[Refusal] = []
    for one in fits(dict.fromkeys(map(by_name, options.monitors)), flights, sessions, context, shelf):
        kind, name, reason = one.kind, one.kind.name, one.refusal
        if reason:
            refusals.append(
                Refusal(monitor=name, reason=f"{reason} ({unknown})" if unknown and "layout" in reason else reason)
            )
            continue
        for spec in one.specs:
            axis = monitor_of(spec).axis
            if axis in one.scores:
                fitted.append(_Fitted(spec, one.scores[axis], kind.decides))
            else:
                refusals.append(
                    Refusal(monitor=name, reason=f"{axis}: too little healthy flight to score it; fly longer")
                )
        refusals += [
            Refusal(monitor=name, reason=f"{axis}: it cannot be modelled; fly a trajectory that moves this axis")
            for axis in (options.axes if kind is RunLength else ())
            if axis not in {spec.axis for spec in one.specs}
        ]
    return fitted, refusals


def _entries(fitted: Sequence[_Fitted], options: LearnOptions, sessions: Sequence[int]) -> list[MonitorEntry]:
    """Specification and threshold of each monitor. The budget is shared by those that decide, and then by axes.

    The monitors of sensors and losses have one share together: what finds propellers stays sharp.
    """
    names = {one.spec.kind for one in fitted if one.decides} or {one.spec.kind for one in fitted}
    shares = Counter(_sharing(name) for name in names)
    entries = []
    for one in fitted:
        same = sum(other.spec.kind == one.spec.kind for other in fitted)
        threshold = threshold_of(
            one.scores,
            flights=len(sessions),
            sessions=len(set(sessions)),
            budget_per_hour=options.alarms_per_hour / len(shares) / max(1, shares[_sharing(one.spec.kind)]) / same,
            guard=by_name(one.spec.kind).guard,
            rule=options.rule,
        )
        entries.append(MonitorEntry(spec=one.spec, threshold=threshold, scores=plain_scores(one.scores)))
    return entries


def _sharing(name: str) -> str:
    """With whom a monitor shares the budget: alone, or with all that find no propeller."""
    kind = by_name(name).kind
    return name if kind is FaultKind.PROPELLER else "others"


def plain_scores(scores: Scores) -> HealthyScores:
    """Scores as a baseline keeps them, to six digits."""
    maxima, spans_s = (tuple(float(f"{x:.6g}") for x in part.tolist()) for part in (scores.maxima, scores.spans_s))
    return HealthyScores(maxima=maxima, spans_s=spans_s)


def sources(flights: Sequence[LearntFlight], sessions: Sequence[int], propellers: int = 0) -> tuple[SourceLog, ...]:
    """The flights as a baseline names them. propellers: number of the set that they flew with."""
    return tuple(
        SourceLog(
            name=one.label.name,
            sha256=one.label.sha256,
            judged_s=one.judged_s,
            started_ns=max(0, one.label.started_ns),
            session=session,
            propellers=propellers,
        )
        for one, session in zip(flights, sessions, strict=True)
    )


def _provenance(found: Taught, sessions: Sequence[int], created: str) -> Provenance:
    logs, tool = sources(found.flights, sessions), f"mavdiag {__version__}"
    return Provenance(logs=logs, created=created, tool=tool, left_out=found.left_out, notes=found.notes)
