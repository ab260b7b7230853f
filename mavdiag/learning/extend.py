"""A baseline with more healthy flights: a new session, or a new set of propellers on the same airframe.

The fits stay as they are; the new flights, which no fit has seen, add to what the thresholds rest on, to the envelope
and to the healthy trim. New propellers change the trim, the vibration and what the sensors feel of it, so one short
hover tells what these are now, and the old flights still tell how much they vary.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from mavdiag.airframe.fingerprint import Outcome, compare, fingerprint_of, merged
from mavdiag.baseline import SESSION_GAP_NS, Baseline, MonitorEntry, check_link, sealed
from mavdiag.chain import front_of
from mavdiag.errors import InputError
from mavdiag.learning.flights import HeldLog, airborne, hold, sessions_of
from mavdiag.learning.guards import repeated, upsets
from mavdiag.learning.learn import assessed, plain_scores, sources
from mavdiag.learning.teaching import refuse
from mavdiag.monitors import monitor_of
from mavdiag.monitors.base import Flights, LearnContext
from mavdiag.monitors.conditions import covered_by
from mavdiag.storage import Shelf
from mavdiag.telemetry import Log
from mavdiag.thresholds.envelope import Covered
from mavdiag.thresholds.heldout import Scores, folds, pooled, score
from mavdiag.thresholds.rule import threshold_of


def extend(baseline: Baseline, flights: Iterable[Log], *, new_propellers: bool = False, created: str) -> Baseline:
    """The baseline with more healthy flights of its airframe. created: time stamp to record, ISO 8601 UTC.

    new_propellers: they were flown with a new set; one hover of 15 s is enough.
    Raises InputError, naming the flight, for one that is in it already, is named twice, never flies or falls, or is of
    another vehicle; BaselineError for one over another link; IdentificationError for one too short for a monitor.
    """
    with Shelf() as shelf:
        return _extended(baseline, [hold(flight, shelf) for flight in flights], shelf, new_propellers, created)


def _extended(
    baseline: Baseline, flights: Sequence[HeldLog], shelf: Shelf, new_propellers: bool, created: str
) -> Baseline:
    if not flights:
        raise InputError("no healthy flight to add; name one or more logs")
    _check(baseline, flights)
    front, known = front_of(baseline), baseline.fingerprint
    learnt = [airborne(front, flight, shelf) for flight in flights]
    refuse(upsets(learnt))
    if known is not None and not new_propellers:
        for one in learnt:
            likeness = compare(known, one.rows, baseline.airframe.layout)
            if likeness.outcome is Outcome.FAR:
                raise InputError(f"{one.label.name}: another vehicle: {likeness.sentence(baseline.airframe.name)}")
    old, rows = baseline.provenance.logs, [flight.rows for flight in learnt]
    propellers = baseline.propellers + new_propellers
    sessions, before = _sessions(baseline, [flight.label for flight in flights]), {log.session for log in old}
    entries = []
    for entry in baseline.monitors:
        spec, ratio = entry.spec, 1.0
        if new_propellers:
            spec, ratio, fresh = _moved(baseline, entry, rows)
        else:
            fresh = [score(monitor_of(spec), flight, number=len(old) + i) for i, flight in enumerate(rows)]
        held = entry.scores
        before_scores = Scores(ratio * np.array(held.maxima), np.array(held.spans_s), np.array(held.flights))
        scores = pooled([before_scores, *fresh])
        threshold = threshold_of(
            scores,
            sessions=[*(log.session for log in old), *sessions],
            budget_per_hour=entry.threshold.budget_per_hour,
            prior=monitor_of(spec).prior,
            rule=entry.threshold.rule,
        )
        spec = spec if new_propellers else monitor_of(spec).extended(rows, len(before))
        entries.append(MonitorEntry(spec=spec, threshold=threshold, scores=plain_scores(scores)))
    fresh_print = fingerprint_of(rows, baseline.airframe.layout)
    longer = baseline.model_copy(
        update={
            "monitors": tuple(entries),
            "envelope": _joined(baseline.envelope, covered_by(rows)),
            # new propellers have a trim and noise of their own
            "fingerprint": fresh_print if new_propellers or known is None else merged(known, fresh_print),
            "healthy_hours": baseline.healthy_hours + sum(flight.judged_s for flight in learnt) / 3600,
            "provenance": baseline.provenance.model_copy(
                update={"logs": (*old, *sources(learnt, sessions, propellers)), "created": created}
            ),
        }
    )
    return sealed(assessed(longer, learnt))


def _check(baseline: Baseline, flights: Sequence[HeldLog]) -> None:
    known = {one.sha256 for one in baseline.provenance.logs if one.sha256}
    for flight in flights:
        if flight.label.sha256 in known:
            raise InputError(f"{flight.label.name}: is in the baseline already; leave it out")
        check_link(baseline, profile=flight.label.profile, dt_s=flight.dt_s)
    refuse(repeated(flights))


def _sessions(baseline: Baseline, flights: Sequence[Log]) -> list[int]:
    """The session of each new flight: that of the nearest flight of the baseline within an hour, else a new one."""
    logs = baseline.provenance.logs
    first = max(one.session for one in logs) + 1
    numbers = [first + number for number in sessions_of(flights)]
    for i, flight in enumerate(flights):
        apart = [(abs(one.started_ns - flight.started_ns), one.session) for one in logs if one.started_ns]
        if flight.started_ns and apart and min(apart)[0] <= SESSION_GAP_NS:
            numbers[i] = min(apart)[1]
    return numbers


def _moved(baseline: Baseline, entry: MonitorEntry, flights: Flights) -> tuple[Any, float, list[Scores]]:
    """The fit for new propellers, the factor of the old scores, and the new flights' scores.

    The healthy level is that of the new flights. Each is scored by a fit to the others, or to its other pieces.
    """
    airframe, monitor, fresh = baseline.airframe, monitor_of(entry.spec), list[Scores]()
    context = LearnContext(airframe, airframe.imu_corner_hz, baseline.link.dt_s, baseline.window.samples)
    spec, ratio = monitor.renewed(flights, context)
    first = len(baseline.provenance.logs)
    numbers = {id(flight): first + i for i, flight in enumerate(flights)}
    for left_out, rest in folds(flights):
        held_out = monitor_of(spec if spec == entry.spec else monitor.renewed(rest, context)[0])
        fresh += [score(held_out, flight, number=numbers.get(id(flight), first)) for flight in left_out]
    return spec, ratio, fresh


def _joined(one: Sequence[Covered], other: Sequence[Covered]) -> tuple[Covered, ...]:
    """What both covered together; a condition that one does not carry restricts as the other says."""
    spans = {covered.condition: covered for covered in one}
    for covered in other:
        known = spans.get(covered.condition, covered)
        low, high = min(known.low, covered.low), max(known.high, covered.high)
        spans[covered.condition] = Covered(covered.condition, low, high)
    return tuple(spans.values())
