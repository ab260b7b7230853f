"""The one decision about a vehicle: not judged, quiet, suspected, fault. Everything that judges reads its stage.

A slot is a monitor with its threshold; its ratio is its statistic over its threshold, which was set for its own share
of the alarm budget. So any one that decides may declare a fault, and the shares add up to the budget:

    calm  < 0.7 <=  held  < 0.8 <=  raised  <= 1 <  over        the highest ratio of all slots

A fault has a kind: what the alarms that declared it mean (`mavdiag.decision.kinds`), which also says when a rotor is
named.

A fault is latched: nothing clears it in flight, and its end turns it into an open inspection, which lasts through later
flights until it is acknowledged. A calm time is the end of a transient, not of a damage. So when every slot that was
over has been calm for 2 s, each by its own fresh values, the fault is only "no longer seen"; the next ratio above 1
begins another episode of it. Within an episode the most certain name of a rotor holds, and the next one may name
another. While no deciding slot has judged for a second and no fault is held, the stage is "not judged". A slot that
does not decide raises a suspicion at most, and only when it is over.

A rotor that was named and whose command falls is mended, or another one carries its load no longer: a trim that such a
fall explains better than the rise of any rotor does not count while the fault is held.

Time is looked at every 0.1 s of the vehicle's clock, when everything up to then is known. So the result does not depend
on how the data were cut: a live link and its recording give the same events, rotors, types and severities.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from mavdiag.decision.diagnosis import Change, Diagnosis, RotorSpan, Stage
from mavdiag.decision.events import Event, EventSpec, EventState
from mavdiag.decision.grading import FaultTypes, Gathered, assess
from mavdiag.decision.heights import CALM_BELOW, STALE_NS, Ahead, Height, height_of, look_ahead
from mavdiag.decision.kinds import KindReading, grown, named
from mavdiag.decision.looks import MANY, Looks, Reading, Waiting, cut, known_from
from mavdiag.monitors.base import FaultKind, RotorEvidence
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis
from mavdiag.units import NS_PER_S

__all__ = [
    "NEXT",
    "NOTHING_SEEN",
    "Change",
    "DecisionSpec",
    "DecisionState",
    "Diagnosis",
    "Event",
    "Height",
    "SlotSpec",
    "Stage",
    "landed",
]

CLEAR_NS = 2 * NS_PER_S  # all calm for so long ends a suspicion, or what is seen of a fault (our choice)
LOOK_NS = NS_PER_S // 10  # time between two looks (our choice)
# A propeller fault that names no rotor is declared so much later: a noisy sensor shows as one until then (our choice).
DOUBT_NS = 3 * LOOK_NS
# A name that is given up within so long of an episode was wrong; later it is another rotor's fault (our choice: the
# longest window of a monitor).
CORRECTED_NS = 5 * NS_PER_S
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
    (Stage.INSPECT, Height.OVER): (Stage.FAULT, "a monitor is above its threshold"),
}
"""Every other pair leaves the stage as it is: no height ends a fault or an inspection."""


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

    @property
    def key(self) -> tuple[str, Axis | None]:
        """Name and axis of the monitor."""
        return self.events.monitor, self.events.axis


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """A time in which a fault is seen.

    begun_ns: when it was declared or came back. ended_ns: since when it is calm, once it is no longer seen.
    over: the deciding slots that were over, by name and axis.
    calm_ns: since when all of these are calm; None if they are not.
    lead: by how much the named rotor led the next when it was most certain [logits].
    gathered, graded: what was gathered, and how many of the fixed times have passed.
    """

    begun_ns: int
    gathered: Gathered
    over: frozenset[tuple[str, Axis | None]] = frozenset()
    calm_ns: int | None = None
    ended_ns: int | None = None
    lead: float = 0.0
    graded: int = 0


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
    episode: the present one of the fault that is held, or its latest.
    """

    latest: tuple[Reading | None, ...]
    events: tuple[EventState, ...]
    waiting: tuple[tuple[Waiting, ...], ...]
    diagnosis: Diagnosis = NOTHING_SEEN
    looked_ns: int | None = None
    calm_ns: int | None = None
    over_ns: int | None = None
    episode: Episode | None = None

    def now(
        self, diagnosis: Diagnosis, latest: tuple[Reading | None, ...], events: tuple[EventState, ...]
    ) -> "DecisionState":
        """With these; quicker than `replace`, for every look does it."""
        times = (self.looked_ns, self.calm_ns, self.over_ns)
        return DecisionState(latest, events, self.waiting, diagnosis, *times, self.episode)


Fresh: TypeAlias = tuple[Reading, SlotSpec]
Step: TypeAlias = tuple[DecisionState, tuple[Event, ...], tuple[Change, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class DecisionSpec:
    """The slots, and the fault types that are known for this airframe (none: no type is named)."""

    slots: tuple[SlotSpec, ...]
    known: tuple[FaultTypes, ...] = ()

    def start(self, held: Diagnosis = NOTHING_SEEN) -> DecisionState:
        """Nothing seen yet. held: what is known from before."""
        n = len(self.slots)
        return DecisionState((None,) * n, (EventState(),) * n, ((),) * n, held)

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
        ended = landed(state.diagnosis, t_ns)
        if ended.stage is not state.diagnosis.stage:
            changes = (*changes, Change.of(ended, t_ns))
        events = (*events, *self._named(state, closed))
        return self.start(ended), events, changes

    def acknowledge(self, state: DecisionState, t_ns: int) -> Step:
        """Close an open inspection: somebody has looked at the vehicle. In any other stage nothing happens."""
        if state.diagnosis.stage is not Stage.INSPECT:
            return state, (), ()
        diagnosis = Diagnosis(reason="the inspection is acknowledged", since_ns=t_ns)
        return replace(state, diagnosis=diagnosis, episode=None), (), (Change.of(diagnosis, t_ns),)

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
        stage, episode = state.diagnosis.stage, state.episode
        if stage is Stage.FAULT and not state.diagnosis.seen and (not episode or episode.graded >= len(self.known)):
            stage = Stage.INSPECT  # like it, a fault that is not seen waits for a ratio above 1
        return ahead.until(stage, number)

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
        held = state.diagnosis
        fresh = [
            (replace(reading, ratio=0.0), slot) if _falls(reading, slot, held) else (reading, slot)
            for reading, slot in self._fresh(state.latest, t_ns)
        ]
        state, height = _height_now(state, fresh, t_ns)
        stage, reason = NEXT.get((held.stage, height), (held.stage, held.reason))
        now, changed = replace(held, stage=stage, reason=reason), stage is not held.stage
        if changed:
            now = replace(now, since_ns=t_ns)
        if stage is not Stage.FAULT:
            return state.now(_leading(now, fresh), state.latest, state.events), changed
        if height is Height.OVER and not held.seen:
            changed, state = True, replace(state, episode=Episode(t_ns, Gathered(t_ns)))
            why = reason if stage is not held.stage else "the fault is seen again"
            declared_ns = t_ns if held.declared_ns is None else held.declared_ns
            kind = held.kind if held.stage is Stage.FAULT else None  # of another flight
            now = Diagnosis(stage, why, now.since_ns, kind=kind, declared_ns=declared_ns, seen=True, rotors=held.rotors)
        state, now, more = self._episode(state, now, fresh, t_ns)
        return replace(state, diagnosis=now), changed or more

    def _episode(
        self, state: DecisionState, now: Diagnosis, fresh: Sequence[Fresh], t_ns: int
    ) -> tuple[DecisionState, Diagnosis, bool]:
        """What is seen of a fault at a look: whether it still is, its kind, and its rotor."""
        episode = state.episode
        if episode is None or not now.seen:
            return state, now, False
        ratios = {slot.key: reading.ratio for reading, slot in fresh if slot.decides}
        over = episode.over | {key for key, ratio in ratios.items() if ratio > 1.0}
        calm = all(ratios.get(key, 1.0) < CALM_BELOW for key in over)
        calm_ns = (t_ns if episode.calm_ns is None else episode.calm_ns) if calm else None
        episode = replace(episode, over=over, calm_ns=calm_ns)
        if calm_ns is not None and t_ns - calm_ns >= CLEAR_NS:
            now = replace(now, seen=False, reason="no longer seen", rotors=_ended(now.rotors, calm_ns))
            return replace(state, episode=replace(episode, ended_ns=calm_ns)), now, True
        readings, was = _readings(fresh), now
        kind = grown(now.kind, readings, t_ns - episode.begun_ns)
        if kind is not now.kind:
            now = replace(now, kind=kind, reason=now.reason if now.kind is None else f"it is a {kind}")
        now = _leading(now, fresh)
        if kind is FaultKind.SENSOR:
            before = _ended(tuple(span for span in now.rotors if span.since_ns < episode.begun_ns), t_ns)
            now = replace(now, rotor=None, confidence=None, fault_type=None, severity=None, rotors=before)
        place = named(kind, readings, now.rotor is not None)
        if place.rotor is not None and (now.rotor is None or place.lead > episode.lead):  # the most certain name holds
            episode = replace(episode, lead=place.lead)
            if place.rotor != now.rotor:
                spans = _with_rotor(now, place.rotor, episode.begun_ns, t_ns)
                reason = now.reason if t_ns == episode.begun_ns else "the rotor is named"
                now = _leading(replace(now, rotor=place.rotor, reason=reason, rotors=spans), fresh)
            now = replace(now, confidence=place.confidence)
        news = now.kind is not was.kind or now.rotor != was.rotor
        return replace(state, episode=episode), now, news

    def _grade(
        self, state: DecisionState, parts: Sequence[Looks], number: int, t_ns: int
    ) -> tuple[DecisionState, bool]:
        """Gather the features, and name type and severity at each of the fixed times after the declaration."""
        episode, now = state.episode, state.diagnosis
        if episode is None or episode.graded >= len(self.known) or now.kind is not FaultKind.PROPELLER:
            return state, False
        gathered, known = episode.gathered, self.known[episode.graded]
        for slot, one in zip(self.slots, parts, strict=True):
            part = None if slot.feature is None else one.part(number)
            if part is not None and slot.feature is not None:
                gathered = gathered.add(slot.feature, part)
        episode = replace(episode, gathered=gathered)
        if t_ns - gathered.since_ns < known.after_s * NS_PER_S:
            return replace(state, episode=episode), False
        found = assess(gathered.features(now.rotor), known)
        after = replace(now, fault_type=found.fault_type, severity=found.severity)
        news = after != now
        after = replace(after, reason="the kind of fault is named") if news else after
        return replace(state, episode=replace(episode, graded=episode.graded + 1), diagnosis=after), news

    def _named(self, state: DecisionState, events: Sequence[Event]) -> list[Event]:
        """The events with rotor, type and severity as they are known now, if they belong to the latest episode."""
        episode, it = state.episode, state.diagnosis
        if episode is None:
            return list(events)
        named = {name: getattr(it, name) for name in ("rotor", "confidence", "fault_type", "severity", "kind")}
        ended_ns = episode.ended_ns
        return [
            replace(event, **named)
            if (event.end_ns is None or event.end_ns >= episode.begun_ns)
            and (ended_ns is None or event.start_ns <= ended_ns)
            else event
            for event in events
        ]


def _falls(reading: Reading, slot: SlotSpec, held: Diagnosis) -> bool:
    """Whether the fall of a rotor's command that was named explains a trim better than the rise of any rotor."""
    how, a = slot.evidence, reading.rotors
    if how is None or how.direct or not held.rotors or not a:
        return False
    lowest = min(a)
    return -lowest >= max(a) and any(a.index(lowest) + 1 == span.rotor for span in held.rotors)


def _with_rotor(now: Diagnosis, rotor: int, begun_ns: int, t_ns: int) -> tuple[RotorSpan, ...]:
    """The spans with a rotor that is named now: since the episode began, if no other one was named before it in it."""
    spans, since_ns = now.rotors, begun_ns
    if now.rotor is not None and t_ns - begun_ns < CORRECTED_NS:
        spans = spans[:-1]
    elif now.rotor is not None:
        spans, since_ns = _ended(spans, t_ns), t_ns
    if spans and spans[-1].rotor == rotor:
        return (*spans[:-1], replace(spans[-1], end_ns=None))
    return (*spans, RotorSpan(rotor, since_ns))


def _ended(spans: tuple[RotorSpan, ...], t_ns: int) -> tuple[RotorSpan, ...]:
    return tuple(replace(one, end_ns=max(one.since_ns, t_ns)) if one.end_ns is None else one for one in spans)


def landed(held: Diagnosis, t_ns: int) -> Diagnosis:
    """What is held once a flight has ended: an open inspection, or nothing."""
    if held.stage is Stage.INSPECT:
        return held
    if held.stage is not Stage.FAULT:
        return Diagnosis(reason="not flying", since_ns=t_ns)
    reason, spans = "the flight with the fault has ended", _ended(held.rotors, t_ns)
    return replace(held, stage=Stage.INSPECT, reason=reason, since_ns=t_ns, seen=False, rotors=spans)


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
    if over_ns is None or t_ns - over_ns >= DOUBT_NS or state.diagnosis.seen:
        return state, height
    readings = _readings(fresh)
    kind = grown(None, readings, 0)
    checked = any(one.kind is FaultKind.SENSOR for one in readings)  # without such monitors nothing is waited for
    doubtful = checked and kind is FaultKind.PROPELLER and named(kind, readings, False).rotor is None
    return state, Height.RAISED if doubtful else height


def _leading(diagnosis: Diagnosis, fresh: Sequence[Fresh]) -> Diagnosis:
    """The diagnosis with the present evidence of the highest ratio; a fault keeps the latest that was above.

    A trim that shows another rotor than the named one is no evidence of it.
    """
    it = diagnosis
    if it.stage in (Stage.FAULT, Stage.INSPECT):
        fresh = [
            (reading, slot)
            for reading, slot in fresh
            if it.seen
            and reading.ratio > 1.0
            and slot.decides
            and slot.kind is it.kind
            and _of_rotor(reading, slot, it)
        ]
        if not fresh:
            return it
    if not fresh:
        return replace(it, monitor=None, axis=None, unit="", statistic=NAN, threshold=NAN)
    reading, slot = max(
        fresh, key=lambda pair: (height_of(pair[0].ratio, pair[1].decides), pair[1].decides, pair[0].ratio)
    )
    evidence = max(reading.value, reading.ratio * slot.threshold)
    return replace(
        it,
        monitor=slot.events.monitor,
        axis=slot.events.axis,
        unit=slot.unit,
        statistic=evidence,
        threshold=slot.threshold,
    )


def _of_rotor(reading: Reading, slot: SlotSpec, diagnosis: Diagnosis) -> bool:
    """Whether evidence may stand beside the name of a rotor: a trim shows one rotor alone."""
    if diagnosis.rotor is None or slot.evidence is None or slot.evidence.direct or not reading.rotors:
        return True
    return reading.rotors.index(max(reading.rotors)) + 1 == diagnosis.rotor
