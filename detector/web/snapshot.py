"""One vehicle as the live page shows it: what it is judged by, and where it stands at a moment. Values in and out.

`about` is sent when a chain begins; `snapshot` a few times a second while somebody looks, with what came since the last
one. Both are plain values that `as_line` writes as JSON.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from detector.alerts import label_of
from detector.fleet import VehicleFigures
from detector.judging import Judge
from detector.session import SessionState
from detector.states import State
from detector.streams import METERED, Streams, on_ground
from detector.web.strips import Strip, strips_of
from mavdiag.chain import Chain
from mavdiag.decision.diagnosis import Stage
from mavdiag.decision.words import finding_words, motors_words
from mavdiag.drawing import airframe_svg
from mavdiag.kernel import WAITING, Account, Piece, Slot
from mavdiag.link.wants import LABELS
from mavdiag.monitors.base import Feature
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Instant, Signal

__all__ = [
    "About",
    "Level",
    "LinkNow",
    "Memory",
    "Now",
    "Seen",
    "SlotAbout",
    "SlotNow",
    "about",
    "as_line",
    "level_of",
    "snapshot",
]

STALE_S = 1.5  # without rows for so long, nothing is judged now (our choice)
HELD = 3.0  # periods that the value of a slow monitor stays on the page (our choice)


class Level(StrEnum):
    """What the page says of a vehicle at first sight."""

    FAULT = "fault"
    INSPECT = "inspect"  # it was declared in an earlier flight, and nobody has acknowledged it
    SUSPECTED = "suspected"
    QUIET = "quiet"  # flight is judged, and nothing was found
    NOT_JUDGED = "not judged"
    OFF = "off"  # the session cannot do its work, or its link is lost


@dataclass(frozen=True, slots=True)
class SlotAbout:
    """A monitor: name and label, axis ("" for the whole vehicle), its unit and threshold; whether it decides alone.

    margin: what its signal is compared with, for the thesis rule [rad/s]; None for others.
    """

    name: str
    label: str
    axis: str
    unit: str
    threshold: float
    decides: bool
    margin: float | None


@dataclass(frozen=True, slots=True)
class About:
    """What a vehicle is judged by. drawing: of its airframe, SVG; "" where the rotor layout is not known."""

    vehicle: int
    airframe: str
    profile: str
    layout: str
    drawing: str
    slots: tuple[SlotAbout, ...]


@dataclass(frozen=True, slots=True)
class SlotNow:
    """A monitor now. value: its highest since the last snapshot; None while it does not judge, for the reason."""

    value: float | None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class LinkNow:
    """A vehicle's link. silent_s: since the last frame. rates: measured rate of each stream by its label [Hz]."""

    received: int
    lost: int
    silent_s: float
    rates: tuple[tuple[str, float], ...]
    round_trip_s: float | None
    drift_ppm: float | None


@dataclass(frozen=True, slots=True)
class Now:
    """A vehicle now.

    level, sentence: at first sight. rotor: the suspected one, from 1. rises: of each rotor's command against the others
    [share of hover]; empty where unknown. state, reason: of the session. slots: as in `About`. strips: the next points.
    """

    vehicle: int
    level: Level
    sentence: str
    rotor: int | None
    rises: tuple[float, ...]
    state: State
    reason: str
    judged_s: float
    flight_s: float
    events: int
    slots: tuple[SlotNow, ...]
    strips: tuple[Strip, ...]
    link: LinkNow


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The latest figures of a slot. at: when they came (host); value None where they were not valid."""

    at: Instant
    value: float | None
    period_s: float
    rises: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """What one snapshot leaves for the next. seen: by number of the slot. rows: when rows came last (host)."""

    chain: Chain | None = None
    seen: Mapping[int, Seen] = field(default_factory=dict)
    accounts: tuple[Account, ...] = ()
    rows: Instant | None = None


def about(vehicle: int, profile: str, judge: Judge | None, prefix: str = "airframe") -> About:
    """What a vehicle is judged by; without a chain, no monitors."""
    if judge is None:
        return About(vehicle, "", profile, "", "", ())
    airframe = judge.baseline.airframe
    drawing = ""
    if airframe.layout is not None:
        drawing = airframe_svg(airframe.layout, title=f"airframe of {airframe.name}", prefix=prefix)
    slots = tuple(_slot_about(slot) for slot in judge.chain.slots)
    return About(vehicle, airframe.name, profile, judge.baseline.layout_statement, drawing, slots)


def _slot_about(slot: Slot) -> SlotAbout:
    monitor = slot.monitor
    margin = monitor.reference if monitor.name == "fsd" else None
    return SlotAbout(
        monitor.name,
        label_of(monitor.name),
        monitor.axis or "",
        monitor.unit,
        slot.threshold,
        slot.decides,
        margin,
    )


def snapshot(
    memory: Memory, figures: VehicleFigures, state: SessionState, pieces: Sequence[Piece], now: Instant
) -> tuple[Memory, Now]:
    """A vehicle now. pieces: what its chain gave since the last snapshot."""
    judge = state.judge
    slots, strips, rises = tuple[SlotNow, ...](), tuple[Strip, ...](), tuple[float, ...]()
    if judge is None:
        memory = Memory()
    else:
        memory = _taken(memory if memory.chain is judge.chain else Memory(judge.chain), judge, pieces, now)
        slots, strips = _slots(memory, judge, state, now), strips_of(judge.chain, pieces)
        rises = next((one.rises for one in memory.seen.values() if one.rises and one.value is not None), ())
        memory = Memory(judge.chain, memory.seen, judge.memory.accounts, memory.rows)
    level, sentence, rotor = _verdict(state, any(one.value is not None for one in slots))
    link = LinkNow(
        figures.received,
        figures.lost,
        round(now - state.latest, 2),
        tuple((LABELS[Signal(name)], round(hertz, 1)) for name, hertz in figures.rates),
        figures.timesync.round_trip_s,
        figures.drift_ppm,
    )
    counts = round(figures.judged_s, 1), round(figures.flight_s, 1), figures.events
    first = (figures.vehicle, level, sentence, rotor, rises, state.state, state.reason)
    return memory, Now(*first, *counts, slots, strips, link)


def _taken(memory: Memory, judge: Judge, pieces: Sequence[Piece], now: Instant) -> Memory:
    """With the latest figures of each slot."""
    if not pieces:
        return memory
    seen = dict(memory.seen)
    for number, slot in enumerate(judge.chain.slots):
        found = [one.found[number] for one in pieces if len(one.found[number])]
        if found:
            seen[number] = _seen(found, now, rises=slot.monitor.feature == Feature.RISE)
    return Memory(memory.chain, seen, memory.accounts, now)


def _seen(found: Sequence[Statistic], now: Instant, *, rises: bool) -> Seen:
    highest = (float(np.maximum.reduce(one.value, where=one.valid, initial=-np.inf)) for one in found)
    values = [one for one in highest if math.isfinite(one)]
    last = found[-1]
    known = tuple(round(one, 4) for one in last.rotors[-1].tolist()) if rises and len(last.rotors) else ()
    known = known if all(math.isfinite(one) for one in known) else ()
    return Seen(now, round(max(values), 5) if values else None, last.period_s, known)


def _slots(memory: Memory, judge: Judge, state: SessionState, now: Instant) -> tuple[SlotNow, ...]:
    stale = memory.rows is None or now - memory.rows > STALE_S
    ground = on_ground(state.streams, judge.chain.front.gate)
    idle = ground.text if ground else state.reason if state.state is not State.MONITORING else ""
    out = []
    for number, (slot, account) in enumerate(zip(judge.chain.slots, judge.memory.accounts, strict=True)):
        one = memory.seen.get(number)
        held_s = STALE_S + HELD * (one.period_s if one else 0.0)
        if one is not None and one.value is not None and now - one.at <= held_s and not stale:
            out.append(SlotNow(one.value))
        else:
            before = memory.accounts[number] if memory.accounts else Account()
            out.append(SlotNow(None, _why(slot, account, before, state.streams, idle if stale else "")))
    return tuple(out)


def _why(slot: Slot, account: Account, before: Account, streams: Streams, idle: str) -> str:
    """Why a monitor does not judge: a stream that does not come, no flight, or what took most of the last moments."""
    missing = [one for one in METERED if one in slot.monitor.signals and streams.meter(one).latest is None]
    if missing:
        return f"no {LABELS[missing[0]]}"
    if idle:
        return idle
    spans, old = _spans(account), _spans(before)
    grown = {reason: span_s - old.get(reason, 0.0) for reason, span_s in spans.items()}
    reason = max(grown, key=lambda one: grown[one], default=WAITING)
    return reason if grown.get(reason, 0.0) > 0 else WAITING


def _spans(account: Account) -> dict[str, float]:
    """Time without a judgement by its reason [s]."""
    outside = {f"{condition} not learnt": one.span_s for condition, one in account.outside.items()}
    return {**account.not_judged, **outside}


def _verdict(state: SessionState, judging: bool) -> tuple[Level, str, int | None]:
    """Level, sentence and suspected rotor."""
    it = state.diagnosis
    if it.stage is Stage.FAULT:
        return Level.FAULT, finding_words(it) + ("" if it.seen else ", no longer seen"), it.rotor
    if it.stage is Stage.INSPECT:
        return Level.INSPECT, f"{motors_words(it)}: inspect before flight", it.rotor
    if state.state in (State.LOST, State.FAULTED):
        return Level.OFF, state.reason, None
    if judging and state.state is State.MONITORING and it.stage is Stage.QUIET:
        return Level.QUIET, "No fault found", None
    if judging and state.state is State.MONITORING and it.stage is Stage.SUSPECTED:
        return Level.SUSPECTED, finding_words(it), it.rotor
    return Level.NOT_JUDGED, state.reason, None


def level_of(state: SessionState, now: Instant) -> tuple[Level, str]:
    """Level and sentence of a vehicle that nobody may look at."""
    judge = state.judge
    level, sentence, _ = _verdict(state, judge is not None and now - judge.judged <= STALE_S)
    return level, sentence


def as_line(value: object) -> str:
    """The JSON of a dataclass of figures, in one line of ASCII; a number that is not finite becomes null."""
    return _encoded(value)


def _plain(value: object) -> object:
    names: tuple[str, ...] | None = getattr(type(value), "__slots__", None)  # of a dataclass here: its fields
    if names is not None:
        found = [(name, getattr(value, name)) for name in names]
        return {name: None if type(one) is float and not math.isfinite(one) else one for name, one in found}
    raise TypeError(f"{type(value).__name__} has no JSON")


_encoded = json.JSONEncoder(default=_plain, allow_nan=False).encode  # made once, for it is used five times a second
