"""The one decision about a vehicle: not judged, quiet, suspected, fault. Everything that judges reads its stage.

A slot is a monitor with its threshold; its ratio is its statistic over its threshold, which was set for its own share
of the alarm budget. So any one that decides may declare a fault, and the shares add up to the budget:

    calm  < 0.7 <=  held  < s <=  raised  <= 1 <  over        the highest ratio of all slots

s is where its flight is one of the few healthy ones that may be suspected (`thresholds.rule`). A slot that does not
decide raises a suspicion at most. A suspicion is for maintenance and may wait: it rests on 2 s of flight, the memory of
a raised statistic and the time since, for damage lasts and a gust passes. A fault is latched: when every slot that was
over has been calm for 2 s, each by its own fresh values, it is only "no longer seen"; the next ratio above 1 begins
another episode. The end of a flight turns it into an open inspection, until it is acknowledged. Within an episode the
most certain name of a rotor holds. A trim that the fall of a named rotor's command explains better than the rise of any
does not count while a fault is held: that rotor is mended, or another one carries its load no longer.

Time is looked at every 80 ms of the vehicle's clock, when everything up to then is known, so that a live link and its
recording give the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from mavdiag.decision.diagnosis import Change, Diagnosis, Event, RotorSpan, Stage
from mavdiag.decision.grading import FaultTypes, Gathered, assess
from mavdiag.decision.kinds import Reading, grown, named
from mavdiag.kernel import AT, CALM_BELOW, LOOK_NS, NAN, STALE_LOOKS, Alarm, Height, Looked, Slot
from mavdiag.monitors.base import FaultKind, Feature
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

# What the rest of the project takes from here; the values are those of `decision.diagnosis`.
__all__ = ["LOOK_NS", "NOTHING_SEEN", "Change", "DecisionSpec", "Diagnosis", "Event", "Stage", "landed"]

CLEAR_NS = 2 * NS_PER_S  # all calm for so long ends a suspicion, or what is seen of a fault (our choice)
# A propeller fault that names no rotor is declared once it is still seen so much later: until then a noisy sensor
# shows as one, and so do stamps that scatter, for then no later value is judged (our choice).
DOUBT_NS = 3 * NS_PER_S // 10
# Of flight that a suspicion rests on: two windows of the innovation (our choice, after a recorded healthy flight whose
# three axes were disturbed together for 1 s).
SUSPICION_S = 2.0
# A name that is given up within so long of an episode was wrong; later it is another rotor's fault (our choice: the
# longest window of a monitor).
CORRECTED_NS = 5 * NS_PER_S
NOTHING_SEEN = Diagnosis()


_WAYS = (  # from these stages, at these heights: to which one, and why
    ((Stage.QUIET, Stage.SUSPECTED), (Height.UNKNOWN,), Stage.NOT_JUDGED, "no monitor judges"),
    ((Stage.NOT_JUDGED,), (Height.SETTLED, Height.CALM, Height.HELD), Stage.QUIET, "monitors judge"),
    ((Stage.SUSPECTED,), (Height.SETTLED,), Stage.QUIET, "all monitors have been calm again"),
    ((Stage.NOT_JUDGED, Stage.QUIET), (Height.RAISED,), Stage.SUSPECTED, "a monitor is where few healthy flights come"),
    (set(Stage) - {Stage.FAULT}, (Height.OVER,), Stage.FAULT, "a monitor is above its threshold"),
)
#: Every other pair leaves the stage as it is: no height ends a fault or an inspection.
NEXT: dict[tuple[Stage, Height], tuple[Stage, str]] = {
    (came, height): (stage, reason) for stages, heights, stage, reason in _WAYS for came in stages for height in heights
}
#: Heights that leave a stage as it is, whatever came before them; a fault is looked at every time while it is seen.
LEFT_ALONE: dict[Stage, tuple[Height, ...]] = {
    Stage.NOT_JUDGED: (Height.UNKNOWN,),
    Stage.QUIET: (Height.CALM, Height.HELD),
    Stage.SUSPECTED: (Height.HELD,),
    Stage.FAULT: (),
    Stage.INSPECT: (Height.UNKNOWN, Height.CALM, Height.HELD, Height.RAISED),
}


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """A time in which a fault is seen.

    before: the rotors that were named until then. over: the deciding slots that were over. calm_ns: since when all of
    these are calm. ended_ns: the same, once it is no longer seen. lead: of the named rotor when it was most certain
    [logits]. graded: fixed times that have passed.
    """

    begun_ns: int
    gathered: Gathered
    before: tuple[RotorSpan, ...] = ()
    over: frozenset[Slot] = frozenset()
    calm_ns: int | None = None
    ended_ns: int | None = None
    lead: float = 0.0
    graded: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class DecisionState:
    """What is held; since when all ratios are calm, one is raised or over, and one is over (None if not); the latest
    episode of a fault."""

    diagnosis: Diagnosis = NOTHING_SEEN
    since_ns: tuple[int | None, int | None, int | None] = (None, None, None)
    episode: Episode | None = None


Step: TypeAlias = tuple[DecisionState, tuple[Event, ...], tuple[Change, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class DecisionSpec:
    """The slots, and the fault types that are known for this airframe (none: no type is named)."""

    slots: tuple[Slot, ...]
    known: tuple[FaultTypes, ...] = ()

    def step(self, state: DecisionState, looked: Looked) -> Step:
        """Take looks that are whole."""
        events: list[Event] = []
        changes: list[Change] = []
        left_alone, before, final, told = self._left_alone(state), None, len(looked.heights) - 1, list(looked.alarms)
        for number, height in enumerate(looked.heights):
            if height == before is not None and not told and number < final:
                continue  # it is left alone, as the look before was
            look, last = looked.first + number, number == final
            t_ns = look * LOOK_NS if looked.end_ns is None else looked.end_ns
            alarms: list[Alarm] = []
            while told and (told[0].look <= look or last):
                alarms.append(told.pop(0))
            if not alarms and height is not None and height in left_alone:
                state, before = _since(state, height, t_ns), height
                if last and state.diagnosis.stage not in (Stage.FAULT, Stage.INSPECT):
                    slot = looked.leads[number]
                    best = Reading.of(self.slots[slot], looked.readings[number, slot].tolist()) if slot >= 0 else None
                    state = replace(state, diagnosis=_shown_by(state.diagnosis, best))
                continue
            rows, oldest = zip(self.slots, looked.readings[number].tolist(), strict=True), t_ns / LOOK_NS - STALE_LOOKS
            fresh = [Reading.of(slot, row) for slot, row in rows if row[AT] >= oldest]
            state, change = self._decide(state, fresh, t_ns)
            if state.diagnosis.stage is Stage.FAULT:
                state, graded = self._grade(state, looked.sums[number], t_ns)
                change = change or graded
            events += self.named(state, alarms)
            changes += [Change.of(state.diagnosis, t_ns)] if change else []
            left_alone, before = self._left_alone(state), None
        return state, tuple(events), tuple(changes)

    def end_segment(
        self, state: DecisionState, looked: Looked, ended: Sequence[Alarm], t_ns: int, *, flies: bool = False
    ) -> Step:
        """The flight or its segment ended, with these alarms open. flies: it may still fly, so that a fault stays."""
        state, events, changes = self.step(state, looked)
        if flies and state.diagnosis.stage is Stage.FAULT:
            events = (*events, *self.named(state, ended))
            return DecisionState(state.diagnosis, episode=state.episode), events, changes
        held = landed(state.diagnosis, t_ns, "the data broke off" if flies else "not flying")
        if held.stage is not state.diagnosis.stage:
            changes = (*changes, Change.of(held, t_ns))
        return DecisionState(held), (*events, *self.named(state, ended)), changes

    def acknowledge(self, state: DecisionState, t_ns: int) -> Step:
        """Close an open inspection: somebody has looked at the vehicle. In any other stage nothing happens."""
        if state.diagnosis.stage is not Stage.INSPECT:
            return state, (), ()
        diagnosis = Diagnosis(reason="the inspection is acknowledged", since_ns=t_ns)
        return DecisionState(diagnosis, state.since_ns), (), (Change.of(diagnosis, t_ns),)

    def named(self, state: DecisionState, alarms: Sequence[Alarm]) -> tuple[Event, ...]:
        """Alarms as events, with the rotor, type and severity known now if they belong to the latest episode."""
        episode, it, found = state.episode, state.diagnosis, list[Event]()
        for alarm in alarms:
            slot, end_ns = self.slots[alarm.slot], None if alarm.end_ns < 0 else alarm.end_ns
            event = Event(*slot.key, alarm.start_ns, end_ns, alarm.statistic, slot.threshold, alarm.level)
            begun = episode is not None and (end_ns is None or end_ns >= episode.begun_ns)
            if begun and episode and (episode.ended_ns is None or event.start_ns <= episode.ended_ns):
                whose = {name: getattr(it, name) for name in ("rotor", "confidence", "fault_type", "severity", "kind")}
                event = replace(event, **whose)
            found.append(event)
        return tuple(found)

    def _left_alone(self, state: DecisionState) -> tuple[Height, ...]:
        held, episode = state.diagnosis, state.episode
        if held.stage is Stage.FAULT and not held.seen and (not episode or episode.graded >= len(self.known)):
            return LEFT_ALONE[Stage.INSPECT]  # like it, a fault that is not seen waits for a ratio above 1
        return LEFT_ALONE[held.stage]

    def _decide(self, state: DecisionState, fresh: list[Reading], t_ns: int) -> tuple[DecisionState, bool]:
        """Look the transition up, and see whether the rotor can be named; True if anything changed."""
        held = state.diagnosis
        if held.rotors:
            fresh = [one._replace(ratio=0.0) if one.rotors and _falls(one, held) else one for one in fresh]
        state, height = _height_now(state, fresh, t_ns)
        stage, reason = NEXT.get((held.stage, height), (held.stage, held.reason))
        changed, now = stage is not held.stage, held
        if changed:
            now = replace(held, stage=stage, reason=reason, since_ns=t_ns)
        if stage is not Stage.FAULT:
            now, news = _suspected_rotor(now, fresh, height)
            return replace(state, diagnosis=_led(now, fresh)), changed or news
        if height is Height.OVER and not held.seen:
            why = "the fault is seen again" if held.stage is stage else reason
            declared_ns = t_ns if held.declared_ns is None else held.declared_ns
            now = Diagnosis(stage, why, now.since_ns, declared_ns=declared_ns, seen=True, rotors=held.rotors)
            changed, state = True, replace(state, episode=Episode(t_ns, Gathered(t_ns), held.rotors))
        if state.episode is None or not now.seen:
            return state, changed
        episode, after = self._episode(state.episode, now, fresh, t_ns)
        news = after.seen is not now.seen or after.kind is not now.kind or after.rotor != now.rotor
        return replace(state, diagnosis=_led(after, fresh), episode=episode), changed or news

    def _episode(
        self, episode: Episode, now: Diagnosis, fresh: Sequence[Reading], t_ns: int
    ) -> tuple[Episode, Diagnosis]:
        ratios = {reading.slot: reading.ratio for reading in fresh if reading.slot.decides}
        over = episode.over | {slot for slot, ratio in ratios.items() if ratio > 1.0}
        calm = all(ratios.get(slot, 1.0) < CALM_BELOW for slot in over)
        calm_ns = (t_ns if episode.calm_ns is None else episode.calm_ns) if calm else None
        if (over, calm_ns) != (episode.over, episode.calm_ns):
            episode = replace(episode, over=over, calm_ns=calm_ns)
        if calm_ns is not None and t_ns - calm_ns >= CLEAR_NS:
            now = replace(now, seen=False, reason="no longer seen", rotors=_ended(now.rotors, calm_ns))
            return replace(episode, ended_ns=calm_ns), now
        kind = grown(now.kind, fresh, t_ns - episode.begun_ns)
        if kind is not now.kind:
            now = replace(now, kind=kind, reason=now.reason if now.kind is None else f"it is a {kind}")
        if kind is FaultKind.SENSOR:
            now = replace(now, rotor=None, confidence=None, fault_type=None, severity=None, rotors=episode.before)
        place = named(kind, fresh, now.rotor is not None)
        if place.rotor is not None and (now.rotor is None or place.lead > episode.lead):  # the most certain name holds
            episode = replace(episode, lead=place.lead)
            if place.rotor != now.rotor:
                spans = _with_rotor(now, place.rotor, episode, t_ns)
                reason = now.reason if t_ns == episode.begun_ns else "the rotor is named"
                now = replace(now, rotor=place.rotor, reason=reason, rotors=spans)
            now = replace(now, confidence=place.confidence)
        return episode, now

    def _grade(self, state: DecisionState, sums: FloatArray, t_ns: int) -> tuple[DecisionState, bool]:
        episode, now = state.episode, state.diagnosis
        if episode is None or episode.graded >= len(self.known) or now.kind is not FaultKind.PROPELLER:
            return state, False
        gathered, known = episode.gathered, self.known[episode.graded]
        for slot, record in zip(self.slots, sums, strict=True):
            if slot.monitor.feature is not None:
                gathered = gathered.add(slot.monitor.feature, record, t_ns - round(slot.monitor.delay_s * NS_PER_S))
        episode = replace(episode, gathered=gathered)
        if t_ns - gathered.since_ns < known.after_s * NS_PER_S:
            return replace(state, episode=episode), False
        if now.seen and Feature.MOTION not in gathered.sums:  # without it nothing is named: it is gathered anew
            return replace(state, episode=replace(episode, gathered=Gathered(t_ns))), False
        found = assess(gathered.features(now.rotor), known)
        after = replace(now, fault_type=found.fault_type, severity=found.severity)
        news = after != now
        why = "the kind of fault is named" if found.fault_type else "the kind of fault is no longer certain"
        after = replace(after, reason=why) if news else after
        return replace(state, diagnosis=after, episode=replace(episode, graded=episode.graded + 1)), news


def height_of(ratio: float, slot: Slot) -> Height:
    """The height of a slot's ratio."""
    if ratio > 1.0 and slot.decides:
        return Height.OVER
    if ratio >= slot.suspected or ratio > 1.0:
        return Height.RAISED
    return Height.HELD if slot.decides and ratio >= CALM_BELOW else Height.CALM


def landed(held: Diagnosis, t_ns: int, why: str = "not flying") -> Diagnosis:
    """What is held once a flight has ended: an open inspection, or nothing, and why."""
    if held.stage is Stage.INSPECT:
        return held
    if held.stage is not Stage.FAULT:
        return Diagnosis(reason=why, since_ns=t_ns)
    reason, spans = "the flight with the fault has ended", _ended(held.rotors, t_ns)
    return replace(held, stage=Stage.INSPECT, reason=reason, since_ns=t_ns, seen=False, rotors=spans)


def _falls(reading: Reading, held: Diagnosis) -> bool:
    """Whether the fall of a rotor's command that was named explains a trim better than the rise of any rotor."""
    a = reading.rotors
    if reading.direct or -min(a) < max(a):
        return False
    return reading.motor(a.index(min(a))) in [span.rotor for span in held.rotors]


def _suspected_rotor(now: Diagnosis, fresh: Sequence[Reading], height: Height) -> tuple[Diagnosis, bool]:
    """The diagnosis with the rotor that a suspicion names, the latest one; and whether that is news."""
    if now.stage in (Stage.QUIET, Stage.NOT_JUDGED):
        return replace(now, rotor=None, confidence=None), False
    raised = (now.stage, height) == (Stage.SUSPECTED, Height.RAISED)
    place = named(FaultKind.PROPELLER, fresh, False) if raised else None
    if place is None or place.rotor in (None, now.rotor):
        return now, False
    return replace(now, rotor=place.rotor, confidence=place.confidence), True


def _with_rotor(now: Diagnosis, rotor: int, episode: Episode, t_ns: int) -> tuple[RotorSpan, ...]:
    """The spans with a rotor that is named now: since the episode began, if no other one was named before it in it."""
    spans, since_ns = now.rotors, episode.begun_ns
    if now.rotor is not None and t_ns - episode.begun_ns < CORRECTED_NS:
        spans = episode.before
    elif now.rotor is not None:
        spans, since_ns = _ended(spans, t_ns), t_ns
    if spans and spans[-1].rotor == rotor:
        return (*spans[:-1], replace(spans[-1], end_ns=None))
    return (*spans, RotorSpan(rotor, since_ns))


def _ended(spans: tuple[RotorSpan, ...], t_ns: int) -> tuple[RotorSpan, ...]:
    return tuple(replace(one, end_ns=max(one.since_ns, t_ns)) if one.end_ns is None else one for one in spans)


def _since(state: DecisionState, height: Height | int, t_ns: int) -> DecisionState:
    was, holds = state.since_ns, (height == Height.CALM, height >= Height.RAISED, height == Height.OVER)
    calm, raised, over = ((t_ns if ns is None else ns) if now else None for ns, now in zip(was, holds, strict=True))
    return state if (calm, raised, over) == was else replace(state, since_ns=(calm, raised, over))


def _height_now(state: DecisionState, fresh: Sequence[Reading], t_ns: int) -> tuple[DecisionState, Height]:
    """How high the highest ratio is, and since when; see `DOUBT_NS` and `SUSPICION_S` for what waits."""
    heights = [height_of(reading.ratio, reading.slot) for reading in fresh]
    height = max(heights) if any(reading.slot.decides for reading in fresh) else Height.UNKNOWN
    state = _since(state, height, t_ns)
    calm_ns, raised_ns, begun_ns = state.since_ns
    if calm_ns is not None and t_ns - calm_ns >= CLEAR_NS:
        return state, Height.SETTLED
    over_ns = max((one.at_ns for one, own in zip(fresh, heights, strict=True) if own is Height.OVER), default=t_ns)
    if begun_ns is not None and min(t_ns, over_ns) - begun_ns < DOUBT_NS and not state.diagnosis.seen:
        kind = grown(None, fresh, 0)
        checked = any(one.slot.monitor.kind is FaultKind.SENSOR for one in fresh)  # without these nothing is waited for
        doubtful = checked and kind is FaultKind.PROPELLER and named(kind, fresh, False).rotor is None
        height = Height.RAISED if doubtful else height
    if height is Height.RAISED and raised_ns is not None:
        memory_s = max(r.slot.monitor.memory_s for r, own in zip(fresh, heights, strict=True) if own >= Height.RAISED)
        height = Height.HELD if memory_s + (t_ns - raised_ns) / NS_PER_S < SUSPICION_S else height
    return state, height


def _led(it: Diagnosis, fresh: Sequence[Reading]) -> Diagnosis:
    """With the present evidence of the highest ratio; a fault keeps the latest that was above and speaks of it."""
    if it.stage in (Stage.FAULT, Stage.INSPECT):
        over = [one for one in fresh if it.seen and one.ratio > 1.0 and one.slot.decides]
        fresh = [one for one in over if _speaks(one, it)] or (over if it.monitor is None else [])
        if not fresh:
            return it
    best = max(fresh, key=lambda one: (height_of(one.ratio, one.slot), one.slot.decides, one.ratio), default=None)
    return _shown_by(it, best)


def _shown_by(it: Diagnosis, best: Reading | None) -> Diagnosis:
    if best is None:
        return replace(it, monitor=None, axis=None, unit="", statistic=NAN, threshold=NAN)
    (name, axis), unit, threshold = best.slot.key, best.slot.monitor.unit, best.slot.threshold
    evidence = max(best.value, best.ratio * threshold)
    return replace(it, monitor=name, axis=axis, unit=unit, statistic=evidence, threshold=threshold)


def _speaks(reading: Reading, it: Diagnosis) -> bool:
    """Whether evidence is of the fault's kind, and may stand beside the name of a rotor: a trim shows one alone."""
    own = it.rotor is None or reading.direct or not reading.rotors
    return reading.slot.monitor.kind is it.kind and (
        own or reading.motor(reading.rotors.index(max(reading.rotors))) == it.rotor
    )
