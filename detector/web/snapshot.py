"""What the live page shows, as values for JSON. No clock, no socket.

    about   what a vehicle is judged by; sent when a chain begins
    now     where it stands, a few times a second while somebody looks, with what came since the last one
    fleet   all vehicles and links, once a second

A *strip* is the residual of the thesis rule, one point for each `BIN_NS` of vehicle time: bin is its number, low and
high are the least and the greatest residual in it [rad/s], fsd_s the longest run above the margin.
"""

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from detector.judging import Judge, unjudged_s
from detector.session import Session
from detector.states import State
from detector.values import DaemonFigures, VehicleFigures
from mavdiag.chain import Chain
from mavdiag.decision.diagnosis import Stage
from mavdiag.decision.words import held_advice, held_sentence
from mavdiag.kernel import NO_ROTORS, WAITING, Account, Piece
from mavdiag.link.wants import LABELS
from mavdiag.monitors.base import Feature
from mavdiag.report.drawing import airframe_svg
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray, Instant, IntArray, Series, Signal, Telemetry
from mavdiag.traces import SlotTrace, slot_traces
from mavdiag.units import NS_PER_S

STALE_S = 1.5  # without rows for so long, nothing is judged now (our choice)
HELD = 3.0  # periods that the value of a slow monitor stays on the page (our choice)
BIN_NS = NS_PER_S // 20  # of vehicle time that one point of a strip stands for (our choice)
DIGITS = 5
OFF = "off"  # what the page says of a vehicle beside the stages: its session cannot do its work, or its link is lost
BACK_S = 20.0  # that the strips show
TRACK_POINTS = 120  # of a track, one a second: the last two minutes (our choice)
PLACES = (Signal.POSITION, Signal.COORDINATES)
EARTH_M = 6_371_009.0  # mean radius (IUGG)
MOST = 1e6  # that a point may show: what is not finite, or beyond it, is no figure for a strip
_FIRST: IntArray = np.zeros(1, dtype=np.int64)

Json = dict[str, Any]


#: What is said of a vehicle that is not judged, by the state of its session and the reason for it.
_IDLE = {
    State.WAITING: "Waiting until it can be judged: {}.",
    State.LEARNING: "Learning what health looks like: {}.",
    State.FITTING: "Making a baseline of what was flown.",
    State.MONITORING: "Nothing is judged at this moment: {}.",
    State.LOST: "The link is lost: {}.",
    State.FAULTED: "It cannot be judged: {}.",
}


def about(vehicle: int, profile: str, judge: Judge | None) -> Json:
    """What a vehicle is judged by; without a chain, no monitors. margin: of the thesis rule's signal [rad/s].

    drawing: of its airframe, SVG; "" where the rotor layout is not known.
    """
    named: Json = {"vehicle": vehicle, "airframe": "", "profile": profile, "layout": "", "drawing": "", "slots": []}
    if judge is None:
        return named
    airframe = judge.baseline.airframe
    named |= {"airframe": airframe.name, "layout": judge.baseline.layout_statement}
    if airframe.layout is not None:
        named["drawing"] = airframe_svg(airframe.layout, title=f"airframe of {airframe.name}")
    for slot in judge.chain.slots:
        monitor = slot.monitor
        margin = monitor.reference if monitor.name == "fsd" else None
        told = {"axis": monitor.axis or "", "margin": margin}
        named["slots"].append(_picked(monitor, "name", "label", "unit") | _picked(slot, "threshold", "decides") | told)
    return named


def _picked(value: object, *names: str) -> Json:
    return {name: getattr(value, name) for name in names}


@dataclass(frozen=True, slots=True)
class _Seen:
    """The latest figures of a slot. at: when they came (host); value None where they were not valid."""

    at: Instant
    value: float | None
    period_s: float
    rises: tuple[float, ...] = ()


class Track:
    """Where a vehicle was, from above: points [north, east] in metres, of the signal that tells it first."""

    def __init__(self) -> None:
        self._signal: Signal | None = None
        self._origin, self._second = (0.0, 0.0), -1
        self.points: deque[tuple[float, float]] = deque(maxlen=TRACK_POINTS)

    def take(self, telemetry: Telemetry) -> None:
        """Take the latest place in what came; within a second it replaces the one before."""
        told = PLACES if self._signal is None else (self._signal,)
        series = next((series for series in telemetry if series.signal in told and len(series)), None)
        if series is None or not np.isfinite(series.values[-1]).all():
            return
        if self._signal is None and series.signal is Signal.COORDINATES:
            self._origin = (float(series.values[-1, 0]), float(series.values[-1, 1]))
        self._signal, second = series.signal, int(series.t_ns[-1]) // NS_PER_S
        if self.points and second == self._second:
            self.points.pop()
        self._second = second
        self.points.append(self._place(series))

    def _place(self, series: Series) -> tuple[float, float]:
        first, second = series.values[-1].tolist()
        if series.signal is Signal.COORDINATES:  # on the plane that touches the sphere at the first place
            first, second = first - self._origin[0], math.remainder(second - self._origin[1], math.tau)
            first, second = EARTH_M * first, EARTH_M * second * math.cos(self._origin[0])
        return round(max(-MOST, min(MOST, first)), 2), round(max(-MOST, min(MOST, second)), 2)


class Snapshots:
    """Makes the snapshots of one vehicle, each with what came since the last one."""

    def __init__(self) -> None:
        self._told: tuple[Chain | None, ...] = ()  # the chain that `about` was told of
        self._seen: dict[int, _Seen] = {}  # by number of the slot
        self._accounts: tuple[Account, ...] = ()
        self._rows: Instant | None = None  # when rows came last

    def next(
        self, figures: VehicleFigures, session: Session, pieces: Sequence[Piece], track: Track, now: Instant
    ) -> tuple[Json | None, Json]:
        """`about` a vehicle, None where that is as before, and the vehicle now.

        pieces: what its chain gave since the last snapshot.
        """
        judge, told = session.judge, None
        chain = None if judge is None else judge.chain
        if self._told != (chain,):
            self._told, self._seen, self._accounts, self._rows = (chain,), {}, (), None
            told = about(figures.vehicle, session.spec.profile.name, judge)
        slots, strips, nearest, now_ns = list[Json](), list[Json](), "", None
        since_ns = session.diagnosis.declared_ns
        if judge is not None:
            traces = slot_traces(judge.chain, pieces)
            self._rows = now if pieces else self._rows
            self._seen |= {number: _seen(trace, now) for number, trace in enumerate(traces) if len(trace.found)}
            slots, strips = self._slots(judge, session, now), strips_of(traces)
            self._accounts, nearest, now_ns = judge.memory.accounts, _nearest(judge, slots), judge.memory.now_ns
        known = (seen.rises for seen in self._seen.values() if seen.rises and seen.value is not None)
        rates = [(LABELS[Signal(name)], round(hertz, 1)) for name, hertz in figures.rates]
        link = {"silent_s": round(now - session.latest, 2), "rates": rates}
        return told, {
            **_picked(figures, "vehicle", "events"),
            **_picked(session, "state", "reason"),
            **_verdict(session, any(slot["value"] is not None for slot in slots), nearest),
            "since_s": None if since_ns is None or now_ns is None else round((now_ns - since_ns) / NS_PER_S, 1),
            "rises": next(known, ()),
            "judged_s": round(figures.judged_s, 1),
            "flight_s": round(figures.flight_s, 1),
            "slots": slots,
            "strips": strips,
            "track": [place for point in track.points for place in point],
            "link": link | _picked(figures, "round_trip_s", "received", "lost", "drift_ppm"),
        }

    def _slots(self, judge: Judge, session: Session, now: Instant) -> list[Json]:
        stale = self._rows is None or now - self._rows > STALE_S
        ground = session.streams.on_ground(judge.chain.front.gate)
        idle = ground.text if ground else session.reason if session.state is not State.MONITORING else ""
        slots = []
        for number, (slot, account) in enumerate(zip(judge.chain.slots, judge.memory.accounts, strict=True)):
            seen = self._seen.get(number)
            held_s = STALE_S + HELD * (seen.period_s if seen else 0.0)
            if seen is not None and seen.value is not None and now - seen.at <= held_s and not stale:
                slots.append({"value": seen.value, "reason": ""})
            else:
                before = self._accounts[number] if self._accounts else Account()
                missing = session.streams.missing(slot.monitor.signals)
                why = f"no {LABELS[missing]}" if missing else idle if idle and stale else _why(account, before)
                slots.append({"value": None, "reason": why})
        return slots


def _seen(trace: SlotTrace, now: Instant) -> _Seen:
    found = trace.found
    value = float(np.max(found.value, where=found.valid & np.isfinite(found.value), initial=-np.inf))
    rises = found.rotors[-1].tolist() if trace.slot.monitor.feature == Feature.RISE and len(found.rotors) else []
    known = tuple(round(rise, 4) for rise in rises) if all(map(math.isfinite, rises)) else ()
    return _Seen(now, round(value, 5) if math.isfinite(value) else None, found.period_s, known)


def _why(account: Account, before: Account) -> str:
    spans, old = unjudged_s(account), unjudged_s(before)
    grown = {reason: span_s - old.get(reason, 0.0) for reason, span_s in spans.items()}
    reason = max(grown, key=lambda reason: grown[reason], default=WAITING)
    return reason if grown.get(reason, 0.0) > 0 else WAITING


def thesis_traces(piece: Piece) -> list[SlotTrace]:
    """What the thesis rule gave in a piece, and nothing else of it: little memory for a display that may come."""
    return [
        SlotTrace(slot, slot.monitor.statistic(piece.rows, out[:, :count].copy(), NO_ROTORS, at[:count]))
        for slot, out, at, count in zip(piece.slots, piece.out, piece.at, piece.counts, strict=True)
        if slot.monitor.name == "fsd"
    ]


def strips_of(traces: Iterable[SlotTrace]) -> list[Json]:
    """One for each trace of the thesis rule, which has an axis; without rows, without points."""
    thesis = (trace for trace in traces if trace.slot.monitor.name == "fsd")
    return [{"axis": trace.slot.monitor.axis, **_points(trace.found)} for trace in thesis]


def _points(found: Statistic) -> Json:
    if not len(found):
        return {"bins": [], "low": [], "high": [], "fsd_s": [], "judged": []}
    bins: IntArray = found.t_ns // BIN_NS
    starts = np.concatenate((_FIRST, (bins[1:] != bins[:-1]).nonzero()[0] + 1))
    return {
        "bins": bins[starts].tolist(),
        "low": _shown(np.minimum.reduceat(found.signal, starts)),
        "high": _shown(np.maximum.reduceat(found.signal, starts)),
        "fsd_s": _shown(np.maximum.reduceat(found.value, starts)),
        "judged": np.logical_or.reduceat(found.valid, starts).tolist(),
    }


def _shown(values: FloatArray) -> list[float]:
    return [round(value, DIGITS) for value in np.clip(np.nan_to_num(values, nan=0.0), -MOST, MOST).tolist()]


def _verdict(session: Session, judging: bool, nearest: str = "") -> Json:
    """Level, sentence, what to do and suspected rotor. judging: whether any monitor judges now. nearest: of them."""
    held, state, level = session.diagnosis, session.state, str(Stage.NOT_JUDGED)
    if held.stage in (Stage.FAULT, Stage.INSPECT) or (judging and state is State.MONITORING):
        level = held.stage
    elif state in (State.LOST, State.FAULTED):
        level = OFF
    sentence = held_sentence(held)
    if level == Stage.QUIET:
        sentence = nearest or "No fault found."
    elif level in (Stage.NOT_JUDGED, OFF):
        reason = session.reason.removeprefix("monitoring: ").removeprefix("not judged: ")
        sentence = _IDLE[state].format(held.reason if reason == "monitoring" else reason)
    alarm = level in (Stage.FAULT, Stage.INSPECT, Stage.SUSPECTED)
    told = {"advice": held_advice(held) if alarm else "", "rotor": held.rotor if alarm else None}
    return {"level": level, "sentence": sentence} | told


def _nearest(judge: Judge, slots: Sequence[Json]) -> str:
    pairs = [(one, slot) for one, slot in zip(judge.chain.slots, slots, strict=True) if slot["value"] is not None]
    ratios = [(slot["value"] / one.threshold, one.monitor) for one, slot in pairs if one.decides and one.threshold > 0]
    if not ratios:
        return ""
    ratio, monitor = max(ratios, key=lambda pair: pair[0])
    name = f"{monitor.label} {monitor.axis or ''}".rstrip()
    return f"{len(pairs)} of {len(slots)} monitors judge; nearest to its threshold is {name}, with {100 * ratio:.0f} %."


def fleet_now(figures: DaemonFigures, sessions: Mapping[int, Session], now: Instant, began: Instant) -> Json:
    """All vehicles and links. sessions: by system id. began: when the daemon did."""
    vehicles = []
    for vehicle in figures.vehicles:
        session = sessions[vehicle.vehicle]
        judge = session.judge
        verdict = _verdict(session, judge is not None and now - judge.judged <= STALE_S)
        vehicles.append(verdict | _picked(vehicle, "vehicle", "state", "received", "lost"))
    counts = ("sent", "dropped", "overflowed")
    links = [_picked(link, "address", "connected") | _picked(link.traffic, *counts) for link in figures.links]
    rounded = {"cpu_s": round(figures.cpu_s, 2), "uptime_s": round(now - began, 1)}
    return {"vehicles": vehicles, "links": links} | _picked(figures, "late", "refused") | rounded
