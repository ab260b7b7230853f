"""The one decision about a vehicle: not judged, quiet, suspected, fault. Everything that judges reads its stage.

A slot is a monitor with its threshold; its ratio is its statistic over its threshold, which was set for its own share
of the alarm budget. So any one that decides may declare a fault, and the shares add up to the budget:

    calm  < 0.7 <=  held  < 0.8 <=  raised  <= 1 <  over        the highest ratio of all slots

A fault has a kind: what the alarms that declared it mean (`mavdiag.decision.kinds`), which also says when a rotor is
named.

A fault lasts until all ratios have been calm for 2 s, or until the flight ends. While no deciding slot has judged for a
second, the stage is "not judged". A slot that does not decide raises a suspicion at most, and only when it is over.

Time is looked at every 0.1 s of the vehicle's clock, when everything up to then is known. So the result does not depend
on how the data were cut: a live link and its recording give the same events, rotors, types and severities.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from mavdiag.decision.diagnosis import Change, Diagnosis, Stage
from mavdiag.decision.events import Event, EventSpec, EventState
from mavdiag.decision.grading import FaultTypes, Gathered, assess
from mavdiag.decision.heights import STALE_NS, Ahead, Height, height_of, look_ahead
from mavdiag.decision.kinds import KindReading, grown, named
from mavdiag.decision.looks import MANY, Looks, Reading, Waiting, cut, known_from
from mavdiag.monitors.base import FaultKind, RotorEvidence
from mavdiag.rows.statistic import Statistic
from mavdiag.units import NS_PER_S

__all__ = ["NEXT", "Change", "DecisionSpec", "DecisionState", "Diagnosis", "Event", "Height", "SlotSpec", "Stage"]

CLEAR_NS = 2 * NS_PER_S  # all calm for so long ends a fault (our choice)
LOOK_NS = NS_PER_S // 10  # time between two looks (our choice)
# A propeller fault that names no rotor is declared so much later: a noisy sensor shows as one until then (our choice).
DOUBT_NS = 3 * LOOK_NS
NAN = float("nan")
NOTHING_SEEN = Diagnosis()


NEXT: dict[tuple[Stage, Height], tuple[Stage, str]] = {
    (Stage.NOT_JUDGED, Height.SETTLED): (Stage.QUIET, "monitors judge"),
    (Stage.NOT_JUDGED, Height.CALM): (Stage.QUIET, "monitors judge"),
    (Stage.NOT_JUDGED, Height.HELD): (Stage.QUIET, "monitors judge"),
    (Stage.NOT_JUDGED, Height.RAISED): (Stage.SUSPECTED, "a monitor comes near its threshold"),
    (Stage.NOT_JUDGED, Height.OVER): (Stage.FAULT, "a monitor is above its threshold"),
    (Stage.QUIET, Height.UNKNOWN): (Stage.NOT_JUDGED, "no monitor judges"),
    (Stage.QUIET, Height.RAISED): (Stage.SUSPECTED, "a monitor comes near its threshold"),
    (Stage.QUIET, Height.OVER): (Stage.FAULT, "a monitor is above its threshold"),
    (Stage.SUSPECTED, Height.UNKNOWN): (Stage.NOT_JUDGED, "no monitor judges"),
    (Stage.SUSPECTED, Height.OVER): (Stage.FAULT, "a monitor is above its threshold"),
    (Stage.SUSPECTED, Height.SETTLED): (Stage.QUIET, "all monitors have been calm again"),
    (Stage.FAULT, Height.UNKNOWN): (Stage.NOT_JUDGED, "no monitor judges"),
    (Stage.FAULT, Height.SETTLED): (Stage.QUIET, "all monitors have been calm again"),
}
"""Every other pair leaves the stage as it is."""


@dataclass(frozen=True, slots=True)
class SlotSpec:
    """A monitor's place in the decision; the fields are those of `Monitor`, threshold is the baseline's."""

    events: EventSpec
    unit: str
    decides: bool
    delay_s: float
    evidence: RotorEvidence | None
    feature: str | None
    kind: FaultKind = FaultKind.PROPELLER

    @property
    def threshold(self) -> float:
        """In the statistic's unit."""
        return self.events.threshold


@dataclass(frozen=True, slots=True, eq=False)
class DecisionState:
    """All that the decision remembers.

    latest: of each slot its latest reading, None before the first.
    events: of each slot its open event.
    waiting: of each slot the values that were not looked at yet.
    diagnosis: what is held now.
    looked_ns: everything up to here was looked at; None before the first value.
    calm_ns: since when all ratios are calm; None if they are not.
    over_ns: since when one is over; None if none is.
    fault: the diagnosis of the latest fault, for events that close after it.
    lead: by how much the named rotor led the next when it was most certain [logits].
    gathered, graded: what was gathered since the fault was declared, and how many of the fixed times have passed.
    """

    latest: tuple[Reading | None, ...]
    events: tuple[EventState, ...]
    waiting: tuple[tuple[Waiting, ...], ...]
    diagnosis: Diagnosis = NOTHING_SEEN
    looked_ns: int | None = None
    calm_ns: int | None = None
    over_ns: int | None = None
    fault: Diagnosis | None = None
    lead: float = 0.0
    gathered: Gathered | None = None
    graded: int = 0

    def now(
        self, diagnosis: Diagnosis, latest: tuple[Reading | None, ...], events: tuple[EventState, ...]
    ) -> "DecisionState":
        """With these; quicker than `replace`, for every look does it."""
        times = (self.looked_ns, self.calm_ns, self.over_ns)
        rest = (*times, self.fault, self.lead, self.gathered, self.graded)
        return DecisionState(latest, events, self.waiting, diagnosis, *rest)


Fresh: TypeAlias = tuple[Reading, SlotSpec]
Step: TypeAlias = tuple[DecisionState, tuple[Event, ...], tuple[Change, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class DecisionSpec:
    """The slots, and the fault types that are known for this airframe (none: no type is named)."""

    slots: tuple[SlotSpec, ...]
    known: tuple[FaultTypes, ...] = ()

    def start(self) -> DecisionState:
        """Nothing seen yet."""
        n = len(self.slots)
        return DecisionState((None,) * n, (EventState(),) * n, ((),) * n)

    def step(self, state: DecisionState, found: Sequence[Statistic], until_ns: int, *, final: bool = False) -> Step:
        """Take the next values of every slot; everything that was known up to `until_ns` has come by now.

        final: look at `until_ns` too, since nothing follows: the end of a flight or of the data.
        """
        waiting = state.waiting
        if found:
            waiting = tuple(
                (*old, Waiting.of(new, slot.threshold)) if len(new) else old
                for slot, old, new in zip(self.slots, state.waiting, found, strict=True)
            )
        looks = self._times(state.looked_ns, waiting, until_ns, final)
        if not looks:
            return replace(state, waiting=waiting), (), ()
        times = np.array(looks)
        parts = [cut(some, slot.delay_s, times) for slot, some in zip(self.slots, waiting, strict=True)]
        events: list[Event] = []
        changes: list[Change] = []
        ahead = None if len(looks) < MANY else look_ahead(parts, state.latest, [slot.decides for slot in self.slots])
        passed = 0  # looks until here are done
        for number, t_ns in enumerate(looks):
            if number < passed:
                continue
            if ahead is not None and (passed := self._passed(state, ahead, number)) > number:
                state = self._after(state, ahead, number, passed)
                continue
            state, fresh = self._read(state, parts, number)
            state, change = self._decide(state, t_ns)
            if state.diagnosis.stage is Stage.FAULT:
                state, graded = self._grade(state, parts, number, t_ns)
                change = change or graded
            events += self._named(state, fresh)
            changes += [Change.of(state.diagnosis, t_ns)] if change else []
        state = replace(state, waiting=tuple(one.rest for one in parts), looked_ns=looks[-1])
        return state, tuple(events), tuple(changes)

    def end_flight(self, state: DecisionState, t_ns: int) -> Step:
        """The flight or its segment ended at that time: look at what is left, and close what is open."""
        state, events, changes = self.step(state, (), t_ns, final=True)
        closed = [
            event for slot, one in zip(self.slots, state.events, strict=True) for event in slot.events.end(one)[1]
        ]
        ended = Diagnosis(reason="not flying", since_ns=t_ns)
        if state.diagnosis.stage is not Stage.NOT_JUDGED:
            changes = (*changes, Change.of(ended, t_ns))
        events = (*events, *self._named(state, closed))
        return replace(self.start(), diagnosis=ended), events, changes

    def open_events(self, state: DecisionState) -> tuple[Event, ...]:
        """The events that last, with what is known of them."""
        return tuple(self._named(state, [one.open for one in state.events if one.open is not None]))

    def _times(
        self, looked_ns: int | None, waiting: Sequence[Sequence[Waiting]], until_ns: int, final: bool
    ) -> list[int]:
        """The times to look at: every 0.1 s since the last look, or since the first value."""
        known = (known_from(some, slot.delay_s) for slot, some in zip(self.slots, waiting, strict=True))
        begun = [t_ns for t_ns in known if t_ns is not None]
        if looked_ns is None and not begun:
            return []
        first_ns = min(begun) - 1 if looked_ns is None else looked_ns
        looks = list(range((first_ns // LOOK_NS + 1) * LOOK_NS, until_ns + 1, LOOK_NS))
        return [*looks, until_ns] if final and until_ns > first_ns and until_ns not in looks[-1:] else looks

    def _passed(self, state: DecisionState, ahead: Ahead, number: int) -> int:
        """The next look at which something may happen."""
        if any(one.open is not None for one in state.events):
            return number
        return ahead.until(state.diagnosis.stage, number)

    def _after(self, state: DecisionState, ahead: Ahead, first: int, stop: int) -> DecisionState:
        """The state after the looks [first, stop), at which nothing happens."""
        latest = ahead.latest(stop - 1)
        now = _leading(state.diagnosis, self._fresh(latest, ahead.parts[0].times[stop - 1]))
        return replace(
            state, latest=latest, calm_ns=ahead.calm_ns(first, stop, state.calm_ns), over_ns=None, diagnosis=now
        )

    def _fresh(self, latest: Sequence[Reading | None], t_ns: int) -> list[Fresh]:
        """The slots that count now, and their readings."""
        return [
            (reading, slot)
            for reading, slot in zip(latest, self.slots, strict=True)
            if reading is not None and t_ns - reading.t_ns <= STALE_NS
        ]

    def _read(self, state: DecisionState, parts: Sequence[Looks], number: int) -> tuple[DecisionState, list[Event]]:
        """Take one look's values: the latest reading and the events of every slot."""
        # What was read last ages while nothing is valid.
        latest = tuple([one.reading(number) or old for one, old in zip(parts, state.latest, strict=True)])
        events, fresh = state.events, list[Event]()
        for i, (slot, one) in enumerate(zip(self.slots, parts, strict=True)):
            ratio = one.highest[number]
            if ratio != ratio or (ratio <= 1.0 and events[i].open is None):  # nan: the look has no value
                continue
            if (part := one.part(number)) is not None:
                after, seen = slot.events.step(events[i], part)
                events = (*events[:i], after, *events[i + 1 :])
                fresh += seen
        return state.now(state.diagnosis, latest, events), fresh

    def _decide(self, state: DecisionState, t_ns: int) -> tuple[DecisionState, bool]:
        """Look the transition up, and see whether the rotor can be named; True if anything changed."""
        fresh = self._fresh(state.latest, t_ns)
        state, height = _height_now(state, fresh, t_ns)
        now = _leading(state.diagnosis, fresh)
        stage, reason = NEXT.get((now.stage, height), (now.stage, now.reason))
        changed = stage is not now.stage
        if changed:
            now = replace(now, stage=stage, reason=reason, since_ns=t_ns)
        if stage is not Stage.FAULT and not changed:
            return state.now(now, state.latest, state.events), False
        if stage is not Stage.FAULT:
            now = replace(now, rotor=None, confidence=None, fault_type=None, severity=None, kind=None)
            return replace(state, diagnosis=now, gathered=None, graded=0), True
        if changed:
            state = replace(state, gathered=Gathered(t_ns), graded=0)
        readings = _readings(fresh)
        kind = grown(now.kind, readings, t_ns - now.since_ns)
        if kind is not now.kind:
            now = replace(now, kind=kind, reason=now.reason if changed else f"it is a {kind}")
            changed = True
        now = _leading(now, fresh)
        if kind is FaultKind.SENSOR:
            now = replace(now, rotor=None, confidence=None, fault_type=None, severity=None)
        place = named(kind, readings, now.rotor is not None)
        lead = 0.0 if now.rotor is None else state.lead
        if place.rotor is not None and (now.rotor is None or place.lead > lead):  # the most certain name holds
            lead = place.lead
            if place.rotor != now.rotor:
                now = replace(now, reason=now.reason if changed else "the rotor is named")
                changed = True
            now = replace(now, rotor=place.rotor, confidence=place.confidence)
        return replace(state, diagnosis=now, fault=now, lead=lead), changed

    def _grade(
        self, state: DecisionState, parts: Sequence[Looks], number: int, t_ns: int
    ) -> tuple[DecisionState, bool]:
        """Gather the features, and name type and severity at each of the fixed times after the declaration."""
        gathered, now = state.gathered, state.diagnosis
        if gathered is None or state.graded >= len(self.known) or now.kind is not FaultKind.PROPELLER:
            return state, False
        for slot, one in zip(self.slots, parts, strict=True):
            part = None if slot.feature is None else one.part(number)
            if part is not None and slot.feature is not None:
                gathered = gathered.add(slot.feature, part, now.rotor)
        state = replace(state, gathered=gathered)
        if t_ns - gathered.since_ns < self.known[state.graded].after_s * NS_PER_S:
            return state, False
        found = assess(gathered, self.known[state.graded])
        after = replace(now, fault_type=found.fault_type, severity=found.severity)
        news = after != now
        after = replace(after, reason="the kind of fault is named") if news else after
        return replace(state, graded=state.graded + 1, diagnosis=after, fault=after), news

    def _named(self, state: DecisionState, events: Sequence[Event]) -> list[Event]:
        """The events with rotor, type and severity as they are known now, if they belong to the latest fault."""
        fault = state.fault
        if fault is None:
            return list(events)
        return [
            replace(
                event,
                rotor=fault.rotor,
                confidence=fault.confidence,
                fault_type=fault.fault_type,
                severity=fault.severity,
                kind=fault.kind,
            )
            if event.end_ns is None or event.end_ns >= fault.since_ns
            else event
            for event in events
        ]


def _readings(fresh: Sequence[Fresh]) -> list[KindReading]:
    return [
        KindReading(slot.kind, slot.decides, reading.ratio, slot.threshold, slot.evidence, reading.rotors)
        for reading, slot in fresh
    ]


def _height_now(state: DecisionState, fresh: Sequence[Fresh], t_ns: int) -> tuple[DecisionState, Height]:
    """How high the highest ratio is, and since when; see `DOUBT_NS` for what waits before it is over."""
    height = Height.UNKNOWN
    if any(slot.decides for _, slot in fresh):
        height = max(height_of(reading.ratio, slot.decides) for reading, slot in fresh)
    calm_ns = None if height is not Height.CALM else t_ns if state.calm_ns is None else state.calm_ns
    over_ns = None if height is not Height.OVER else t_ns if state.over_ns is None else state.over_ns
    if calm_ns != state.calm_ns or over_ns != state.over_ns:
        state = replace(state, calm_ns=calm_ns, over_ns=over_ns)
    if calm_ns is not None and t_ns - calm_ns >= CLEAR_NS:
        return state, Height.SETTLED
    if over_ns is None or t_ns - over_ns >= DOUBT_NS or state.diagnosis.stage is Stage.FAULT:
        return state, height
    readings = _readings(fresh)
    kind = grown(None, readings, 0)
    checked = any(one.kind is FaultKind.SENSOR for one in readings)  # without such monitors nothing is waited for
    doubtful = checked and kind is FaultKind.PROPELLER and named(kind, readings, False).rotor is None
    return state, Height.RAISED if doubtful else height


def _leading(diagnosis: Diagnosis, fresh: Sequence[Fresh]) -> Diagnosis:
    """The diagnosis with the present evidence of the highest ratio, first of those that are over and of its kind."""
    if not fresh:
        return replace(diagnosis, monitor=None, axis=None, unit="", statistic=NAN, threshold=NAN)
    kind = diagnosis.kind
    reading, slot = max(
        fresh, key=lambda pair: (pair[1].decides, pair[0].ratio > 1.0 and pair[1].kind is kind, pair[0].ratio)
    )
    named, it = slot.events, diagnosis
    statistic = max(reading.value, reading.ratio * slot.threshold)
    evidence = (named.monitor, named.axis, slot.unit, statistic, named.threshold)
    fault = (it.rotor, it.confidence, it.fault_type, it.severity, it.kind)
    return Diagnosis(it.stage, it.reason, it.since_ns, *evidence, *fault)
