"""From healthy flights to a baseline: fit the monitors, judge with flights left out, set their thresholds.

    all flights             -> the fits that the baseline holds, and one fit without each fold (`Monitor.fit`)
    each flight, once more  -> its block maxima by the fits that did not see it (`thresholds.heldout`)

A single flight is cut into pieces, and each is judged by a fit to the rest. More flights (`extend`), which no fit has
seen, add to what thresholds, envelope and healthy trim rest on. New propellers change the trim, the vibration and what
the sensors feel of it: one short hover tells what these are now, and the old flights how much they vary.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from mavdiag import __version__
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.fingerprint import Outcome, compare, fingerprint_of, merged
from mavdiag.airframe.layout import layout_named
from mavdiag.baseline import (
    UNREACHED,
    Baseline,
    HealthyScores,
    Link,
    MonitorEntry,
    Provenance,
    Refusal,
    SourceLog,
    Window,
    check_link,
    sealed,
    without_mute,
)
from mavdiag.chain import front_of, suited
from mavdiag.errors import BaselineError, IdentificationError, InputError, UsageError
from mavdiag.identify import Method, Order
from mavdiag.learning.flights import KEPT_BYTES, HeldLog, LearntFlight, airborne, hold, sessions_of
from mavdiag.learning.rotors import of_log_kind, with_rotors
from mavdiag.learning.suspicions import courses, grade_of, least_damage, suspicions
from mavdiag.learning.teaching import one_vehicle, refuse, repeated, taught, turned, upsets
from mavdiag.link.profiles import PROFILES
from mavdiag.monitors import BY_NAME, by_name, monitor_of
from mavdiag.monitors.base import FaultKind, Flights, LearnContext, Monitor, walk
from mavdiag.monitors.conditions import covered_by
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.monitors.run_length import MarginRule, RunLength
from mavdiag.printable import counted
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.storage import Shelf, give_back, keep_freed
from mavdiag.telemetry import Axis, FloatArray, Log, Series, Signal, Telemetry, unix_ns
from mavdiag.thresholds.envelope import Covered
from mavdiag.thresholds.heldout import Scores, folds, maxima, pooled, score
from mavdiag.thresholds.rule import (
    BUDGET_PER_HOUR,
    FLIGHTS_PER_SUSPICION,
    ThresholdRule,
    law_of,
    shared_out,
    threshold_of,
)
from mavdiag.units import G

ALL_MONITORS = tuple(BY_NAME)
TOOL = f"mavdiag {__version__}"
NO_PROPELLERS = "none of its monitors judges propellers; fly longer"
MOST_SAID = 2  # findings that are told in full (our choice)


@dataclass(frozen=True, slots=True)
class LearnOptions:
    """How to learn. Raises UsageError for a monitor that there is not, or a budget that is not positive.

    axes, method, order, margin_rule: of the thesis's monitor: what it models and watches, how, and its margin.
    window_s: Savitzky-Golay window [s].
    airframe: the vehicle, as far as it is known.
    monitors: names of the monitors to use.
    rule, alarms_per_hour: how thresholds follow from healthy maxima, and the budget of all deciding monitors together.
    flights_per_suspicion: healthy flights of which one may be suspected, by all monitors together.
    sessions: how many sessions the flights were flown in, in equal parts and in their order; None for what their
        wall-clock times say, and for one each where a log has none.
    robust: what the guards of teaching find is left out instead of refused (see `mavdiag.learning.teaching`).
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
    flights_per_suspicion: float = FLIGHTS_PER_SUSPICION
    sessions: int | None = None
    robust: bool = False

    def __post_init__(self) -> None:
        for name in self.monitors:
            by_name(name)
        if not self.monitors:
            raise UsageError(f"no monitor named; there are {', '.join(ALL_MONITORS)}")
        if not 0 < self.alarms_per_hour < math.inf:
            raise UsageError(f"alarms per hour must be positive and finite, not {self.alarms_per_hour:g}")
        if not 1 < self.flights_per_suspicion < math.inf:
            raise UsageError(f"flights per suspicion must be a number above 1, not {self.flights_per_suspicion:g}")
        if self.sessions is not None and self.sessions < 1:
            raise UsageError(f"sessions must be 1 or more, not {self.sessions}")


def thesis_options() -> LearnOptions:
    """The thesis's own way: one monitor, FML the longest healthy run, roll the primary axis (T 5.5)."""
    return LearnOptions(axes=(Axis.ROLL,), monitors=(RunLength.name,), rule=ThresholdRule.MAXIMUM)


Fitted: TypeAlias = tuple[Monitor[Any], Scores]  # by its fit to all flights, and on flights that a fit did not see


def learn(flights: Iterable[Log], options: LearnOptions, *, created: str) -> Baseline:
    """A baseline from healthy flights. created: time stamp to record, ISO 8601 UTC; UsageError is raised for another.

    Each flight is taken once, and put aside: flights that are read as they are taken, `(read_log(path) for path in
    paths)`, are never in memory together. A monitor that cannot work on such flights is recorded with its reason.
    Raises InputError if a flight lacks the gyro or never flies, and IdentificationError if no monitor can work.
    """
    unix_ns(created)
    with Shelf() as shelf:
        keep_freed(KEPT_BYTES)  # half of the page faults
        held = [hold(log, shelf) for log in flights]
        give_back()
        if not held:
            raise InputError("no healthy flight to learn from")
        first, link = held[0].label, PROFILES.get(held[0].label.profile)
        airframe = of_log_kind(options.airframe, first.profile)
        told_hz = first.parameters.get(link.imu_corner_parameter, 0.0) if link is not None else 0.0
        if airframe.imu_corner_hz is None and told_hz > 0.0:
            airframe = replace(airframe, imu_corner_hz=told_hz)
        found = taught(held, options.window_s, airframe.gate, robust=options.robust)
        airframe, ordered = with_rotors(airframe, found.flights)
        found = replace(found, flights=tuple(ordered))
        if airframe.scope != "type":
            found = one_vehicle(found, airframe.layout, robust=options.robust)
        front, learnt, rows = found.front, found.flights, [flight.rows for flight in found.flights]
        sessions = sessions_of([flight.label for flight in learnt], options.sessions)
        corner_hz = airframe.imu_corner_hz or (link.corner_hz(first.parameters) if link is not None else None)
        thesis = options.axes, options.method, options.order, options.margin_rule
        context = LearnContext(airframe, corner_hz, front.align.dt_s, front.rates.window, *thesis)
        fitted, refusals = _fit_all(rows, sessions, options, context)
        give_back()
        if not fitted:
            reasons = "; ".join(f"{refusal.monitor}: {refusal.reason}" for refusal in refusals)
            raise IdentificationError(f"no monitor can judge such flights ({reasons})")
        promises = options.alarms_per_hour, options.flights_per_suspicion
        how = {name: getattr(front.align, name) for name in ("dt_s", "grid", "max_gap_s")}
        baseline = Baseline(
            airframe=airframe,
            link=Link(profile=first.profile, gate=front.gate, **how),
            window=Window(samples=front.rates.window, order=2),
            link_quality=front.align.quality,
            monitors=tuple(
                _entry(monitor.spec, scores, sessions, share, options.rule)
                for (monitor, scores), share in zip(fitted, _shares(fitted, sessions, promises), strict=True)
            ),
            not_judgeable=tuple(refusals),
            envelope=covered_by(rows),
            healthy_hours=sum(flight.judged_s for flight in learnt) / 3600,
            provenance=Provenance(
                logs=_sources(learnt, sessions, [monitor for monitor, _ in fitted]),
                created=created,
                tool=TOOL,
                left_out=found.left_out,
                notes=found.notes,
            ),
            fingerprint=fingerprint_of(rows, airframe.layout),
        )
        return sealed(_assessed(baseline, learnt))


def _assessed(baseline: Baseline, flights: Sequence[LearntFlight]) -> Baseline:
    """The baseline with its worth by these flights, without mute monitors; IdentificationError if none is left."""
    give_back()
    found = courses([entry.spec for entry in baseline.monitors], flights)
    limits = {entry.spec.kind: entry.threshold.value for entry in baseline.monitors}
    least = least_damage(found, limits, baseline.airframe)
    judging, refusals = without_mute(baseline.monitors, "learn from calmer flights, or from more of them")
    if not judging:
        raise IdentificationError(f"no monitor can judge such flights ({'; '.join(one.reason for one in refusals)})")
    refused = (*baseline.not_judgeable, *refusals)
    blind = [one.monitor for one in refused if UNREACHED in one.reason]
    none = all(monitor_of(one.spec).kind is not FaultKind.PROPELLER for one in judging)
    texts = baseline.weak, *map(str, suspicions(found, baseline.airframe)), NO_PROPELLERS * none
    said = list(dict.fromkeys(filter(None, texts)))
    more = f" (and {counted(len(said) - MOST_SAID, 'more such finding')})" if len(said) > MOST_SAID else ""
    weak = "; ".join(said[:MOST_SAID]) + more
    return baseline.model_copy(
        update={
            "monitors": judging,
            "not_judgeable": refused,
            "least_damage": least,
            "weak": weak,
            "grade": grade_of(least, weak=bool(weak), blind=blind, supported=baseline.supported),
        }
    )


def _fit_all(
    flights: Flights, sessions: Sequence[int], options: LearnOptions, context: LearnContext
) -> tuple[list[Fitted], list[Refusal]]:
    """Every named monitor that can work on these flights, and the reason of each that cannot."""
    pairs, found, refused = list(folds(flights, sessions=sessions)), {}, dict[type[Monitor[Any]], str]()
    kinds = tuple(dict.fromkeys(map(by_name, options.monitors)))
    for kind in kinds:
        try:
            kind.need_stream(1 / context.dt_s, context.imu_corner_hz, context.airframe.hover_rad_s)
            specs = kind.fit(flights, context)
            near = replace(context, figures=False, near=specs)
            found[kind] = specs, [[kind(spec) for spec in kind.fit(rest, near)] for _, rest in pairs]
        except (InputError, IdentificationError) as error:
            refused[kind] = str(error)
        give_back()
    parts = defaultdict[tuple[str, Axis | None], list[Scores]](list)
    numbers = {id(flight): number for number, flight in enumerate(flights)}  # pieces are of flight 0
    for fold, (left_out, _) in enumerate(pairs):
        monitors = [monitor for _, fits in found.values() for monitor in fits[fold]]
        for flight in left_out:
            for monitor, scores in zip(monitors, _scores(monitors, flight, numbers.get(id(flight), 0)), strict=True):
                parts[monitor.name, monitor.axis].append(scores)
    fitted, refusals = list[Fitted](), list[Refusal]()
    basis = context.airframe.layout_basis if context.airframe.layout is None else ""
    unknown = f" ({basis})" if basis else ""
    for kind in kinds:
        specs, fits = found.get(kind, ((), ()))
        scored = [(monitor, pooled(parts[kind.name, monitor.axis])) for monitor in map(kind, specs)]
        reasons = [refused[kind] + unknown * ("layout" in refused[kind])] if kind in refused else []
        if kind in found and not any(len(scores.maxima) for _, scores in scored):
            scored, reasons = [], ["the healthy flights are too short to score the statistic on; fly longer"]
        for monitor, scores in scored:
            if not len(scores.maxima):
                reasons.append(f"{monitor.axis}: too little healthy flight to score it; fly longer")
            elif any(monitor.axis not in [one.axis for one in fit] for fit in fits):
                why = "without a part of the flights it cannot be modelled; fly more that moves this axis"
                reasons.append(f"{monitor.axis}: {why}")
            else:
                fitted.append((monitor, scores))
        if kind is RunLength and scored:
            flat = "it cannot be modelled; fly a trajectory that moves this axis"
            modelled = [monitor.axis for monitor, _ in scored]
            reasons += [f"{axis}: {flat}" for axis in options.axes if axis not in modelled]
        refusals += [Refusal(monitor=kind.name, reason=reason) for reason in reasons]
    return fitted, refusals


def _scores(monitors: Sequence[Monitor[Any]], flight: Sequence[Rows], number: int) -> list[Scores]:
    found: list[list[tuple[FloatArray, float]]] = [[] for _ in monitors]
    for judged in walk(monitors, flight):
        for parts, (one, _) in zip(found, judged, strict=True):
            parts.append((one.value[one.valid], one.period_s))
    return [maxima(parts, number) for parts in found]


def _shares(
    fitted: Sequence[Fitted], sessions: Sequence[int], promises: tuple[float, float]
) -> list[tuple[float, float]]:
    """Each monitor's share of alarms per hour and flights per suspicion (`shared_out`). One alone decides."""
    laws = [law_of(scores, tuple(sessions), monitor.prior) for monitor, scores in fitted]
    decides = [monitor.decides for monitor, _ in fitted]
    return shared_out(laws, decides if any(decides) else [True] * len(fitted), *promises)


def _entry(
    spec: Any, scores: Scores, sessions: Sequence[int], promises: tuple[float, float], rule: ThresholdRule
) -> MonitorEntry:
    """A fit with its threshold, and the scores to six digits. promises: alarms per hour, flights per suspicion."""
    budget, flights = promises
    threshold = threshold_of(
        scores,
        sessions=sessions,
        budget_per_hour=budget,
        flights_per_suspicion=flights,
        prior=monitor_of(spec).prior,
        rule=rule,
    )
    maxima, spans_s = (tuple(float(f"{x:.6g}") for x in part.tolist()) for part in (scores.maxima, scores.spans_s))
    held = HealthyScores(maxima=maxima, spans_s=spans_s, flights=tuple(scores.flights.tolist()))
    return MonitorEntry(spec=spec, threshold=threshold, scores=held)


def _sources(
    flights: Sequence[LearntFlight], sessions: Sequence[int], monitors: Iterable[Monitor[Any]], propellers: int = 0
) -> tuple[SourceLog, ...]:
    """The flights as a baseline names them. propellers: number of the set that they flew with."""
    trim = next((monitor for monitor in monitors if isinstance(monitor, RotorTrim)), None)
    return tuple(
        SourceLog(
            name=one.label.name,
            sha256=one.label.sha256,
            judged_s=one.judged_s,
            started_ns=max(0, one.label.started_ns),
            session=session,
            propellers=propellers,
            trim=() if trim is None else trim.whole(one.rows),
        )
        for one, session in zip(flights, sessions, strict=True)
    )


def extend(baseline: Baseline, flights: Iterable[Log], *, new_propellers: bool = False, created: str) -> Baseline:
    """The baseline with more healthy flights of its airframe; created: as of `learn`.

    new_propellers: they were flown with a new set; one hover of 15 s is enough.
    Raises InputError, naming the flight, for one that is in it already, is named twice, never flies or falls, or is of
    another vehicle; BaselineError for one over another link; IdentificationError for one too short for a monitor.
    """
    unix_ns(created)
    with Shelf() as shelf:
        held = [hold(flight, shelf) for flight in flights]
        if not held:
            raise InputError("no healthy flight to add; name one or more logs")
        _check(baseline, held)
        known = baseline.fingerprint
        learnt = [airborne(front_of(suited(baseline, flight.label)), flight) for flight in held]
        modelled = [one.spec.axis.column for one in baseline.monitors if one.spec.kind == RunLength.name]
        refuse((*upsets(learnt), *turned(learnt, modelled)))
        if known is not None and not new_propellers:
            for one in learnt:
                likeness = compare(known, one.rows, baseline.airframe.layout)
                if likeness.outcome is Outcome.FAR:
                    raise InputError(f"{one.label.name}: {likeness.sentence(baseline.airframe.name)}")
        old, rows = baseline.provenance.logs, [flight.rows for flight in learnt]
        propellers = baseline.propellers + new_propellers
        sessions = _sessions(baseline, [flight.label for flight in held])
        present = [number for number, log in enumerate(old) if log.propellers == propellers]
        fitted = list[Fitted]()
        for entry in baseline.monitors:
            reached, spans_s, numbers = map(np.array, (entry.scores.maxima, entry.scores.spans_s, entry.scores.flights))
            if new_propellers:
                spec, ratio, fresh = _moved(baseline, entry, rows)
                reached = ratio * reached
            else:
                monitor, own = monitor_of(entry.spec), np.isin(numbers, present)
                fresh = [score(monitor, flight, number=len(old) + i) for i, flight in enumerate(rows)]
                spec, more = monitor.extended(rows, len(np.unique(numbers[own])))
                reached = reached + more * own
            fitted.append((monitor_of(spec), pooled([Scores(reached, spans_s, numbers), *fresh])))
        all_sessions = [*(log.session for log in old), *sessions]
        shares = zip(baseline.monitors, fitted, _shares(fitted, all_sessions, baseline.promised), strict=True)
        entries = [
            _entry(one.spec, scores, all_sessions, share, was.threshold.rule) for was, (one, scores), share in shares
        ]
        fresh_print = fingerprint_of(rows, baseline.airframe.layout)
        monitors = (monitor_of(entry.spec) for entry in entries)
        longer = baseline.model_copy(
            update={
                "monitors": tuple(entries),
                "envelope": _joined(baseline.envelope, covered_by(rows)),
                # new propellers have a trim and noise of their own
                "fingerprint": fresh_print if new_propellers or known is None else merged(known, fresh_print),
                "healthy_hours": baseline.healthy_hours + sum(flight.judged_s for flight in learnt) / 3600,
                "provenance": baseline.provenance.model_copy(
                    update={"logs": (*old, *_sources(learnt, sessions, monitors, propellers)), "created": created}
                ),
            }
        )
        return sealed(_assessed(longer, learnt))


def _check(baseline: Baseline, flights: Sequence[HeldLog]) -> None:
    known = {one.sha256 for one in baseline.provenance.logs if one.sha256}
    for flight in flights:
        if flight.label.sha256 in known:
            raise InputError(f"{flight.label.name}: is in the baseline already; leave it out")
        try:
            check_link(baseline, profile=flight.label.profile, dt_s=flight.dt_s)
        except BaselineError as error:
            raise BaselineError(f"{flight.label.name}: {error}") from error
    refuse(repeated(flights))


def _sessions(baseline: Baseline, flights: Sequence[Log]) -> list[int]:
    """The session of each new flight: of the nearest old one that the wall clock chains it to, else its own."""
    logs, sessions, own = baseline.provenance.logs, list[int](), dict[int, int]()
    chains, first = sessions_of([*logs, *flights]), max(one.session for one in logs) + 1
    for flight, chain in zip(flights, chains[len(logs) :], strict=True):
        old = (log for log, other in zip(logs, chains[: len(logs)], strict=True) if other == chain)
        near = min(old, key=lambda log: abs(log.started_ns - flight.started_ns), default=None)
        sessions.append(own.setdefault(chain, first + len(own)) if near is None else near.session)
    return sessions


def _moved(baseline: Baseline, entry: MonitorEntry, flights: Flights) -> tuple[Any, float, list[Scores]]:
    """The fit for new propellers, the factor of the old scores, and the new flights' scores by fits to the others."""
    airframe, monitor, fresh = baseline.airframe, monitor_of(entry.spec), list[Scores]()
    context = LearnContext(airframe, airframe.imu_corner_hz, baseline.link.dt_s, baseline.window.samples)
    spec, ratio = monitor.renewed(flights, context)
    first = len(baseline.provenance.logs)
    numbers = {id(flight): first + i for i, flight in enumerate(flights)}  # pieces are of the first
    for left_out, rest in folds(flights):
        held_out = monitor_of(spec if spec == entry.spec else monitor.renewed(rest, context)[0])
        fresh += [score(held_out, flight, number=numbers.get(id(flight), first)) for flight in left_out]
    return spec, ratio, fresh


def _joined(one: Sequence[Covered], other: Sequence[Covered]) -> tuple[Covered, ...]:
    """What both covered together; a condition that one does not carry restricts as the other says."""
    spans = dict[Condition, tuple[float, float]]()
    for own in (*one, *other):
        low, high = spans.get(own.condition, (own.low, own.high))
        spans[own.condition] = min(low, own.low), max(high, own.high)
    return tuple(Covered(condition, *span) for condition, span in spans.items())


def warm() -> None:
    """Compile what learns, or load it from where it is kept, by learning a flight of 15 s that is made up."""
    rng, t_ns = np.random.default_rng(0), 10_000_000 * np.arange(1500)
    u, noise = np.repeat(rng.normal(0.0, 0.5, (30, 3)), 50, axis=0), 0.02 * rng.standard_normal((1500, 4))
    angles, force = 0.01 * np.cumsum(u, axis=0), noise[:, :3] - (0.0, 0.0, G)
    values = {Signal.ATTITUDE_SETPOINT: angles, Signal.ATTITUDE: angles, Signal.BODY_RATE: u + noise[:, :3]}
    values |= {Signal.SPECIFIC_FORCE: force, Signal.THRUST_SETPOINT: np.full((1500, 1), 0.5)}
    values |= {Signal.ACTUATOR: 0.5 + noise, Signal.ROTOR_SPEED: 1e3 * np.sqrt(0.5 + noise)}
    flight = Telemetry(tuple(Series(signal, t_ns, t_ns, found) for signal, found in values.items()))
    options = LearnOptions(airframe=Airframe(layout=layout_named("x")))
    learn([Log("made up", "", "qdrone2", flight)], options, created="1970-01-01")
