"""`mavdiag inspect`: what really arrives, whether its units are right, and which monitors can work with it."""

import itertools
import json
import textwrap
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.load import with_layout
from mavdiag.baseline import Baseline
from mavdiag.commands.options import AsJson, Layout, Vehicle, is_endpoint
from mavdiag.errors import UsageError
from mavdiag.link.asking import Asked, Asker
from mavdiag.link.codec import message_name
from mavdiag.link.keys import read_key
from mavdiag.link.link import Link, open_link
from mavdiag.link.messages import Component, MavResult
from mavdiag.link.profiles import PROFILES
from mavdiag.link.sequence import LinkCount
from mavdiag.link.wants import Want, wants_of
from mavdiag.logs import read_log
from mavdiag.logs.tlog import read_content
from mavdiag.look.inspection import (
    Clock,
    MonitorState,
    Summary,
    Units,
    baseline_statement,
    clock_of,
    monitor_states,
    rotors_of,
    summary,
    units_of,
)
from mavdiag.monitors import MONITORS
from mavdiag.printable import printable
from mavdiag.telemetry import Instant, Log, Signal
from mavdiag.units import NS_PER_S

__all__ = ["Inspection", "inspect"]

LISTEN_S = 2.0  # before anything is asked for
ASK_S = 6.0  # for the answers: some thirty parameters at four each 0.2 s, three times (our choice)
LEAST_HZ = 45.0  # slowest gyro and set-points that are not asked for: the detector's least
COMPANION_OF = 1  # as whose companion we speak on a link before a vehicle is known
WIDTH = 80
STREAMS_ADVICE = "ask for what is missing with --ask, or set the parameters named above"


@dataclass(frozen=True, slots=True)
class Inspection:
    """All that is told.

    log: the flight or what came of the link. source: as it was given.
    found: its signals.
    messages: rate of each message [Hz], by its number; empty for a log that has none.
    link: counts of the link; None for a log that has none.
    answers: what the autopilot answered to the requests, by message; empty if nothing was asked.
    airframe: with its rotors.
    baseline: whether it fits; empty without one.
    """

    source: str
    log: Log
    found: tuple[Summary, ...]
    messages: Mapping[int, float]
    link: LinkCount | None
    answers: tuple[str, ...]
    clock: Clock | None
    units: Units
    airframe: Airframe
    monitors: tuple[MonitorState, ...]
    baseline: str


def inspect(
    source: Annotated[str, typer.Argument(metavar="ENDPOINT|LOG", help="udpin:127.0.0.1:14550, ... or a log file.")],
    duration: Annotated[float, typer.Option(metavar="S", help="How long to listen to an endpoint.")] = 5.0,
    ask: Annotated[
        bool, typer.Option("--ask", help="Ask the vehicle for the streams that are missing, and for its rotors.")
    ] = False,
    baseline: Annotated[Path | None, typer.Option(metavar="FILE", help="Show the monitors of this baseline.")] = None,
    layout: Layout = None,
    vehicle: Vehicle = None,
    profile: Annotated[str | None, typer.Option(metavar="NAME", help="Link profile, where it is not clear.")] = None,
    signing_key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Hear only what is signed with this key (MAVLink 2 signing).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure a log or a live link: rates, units, clock, rotors, and which monitors work or what they lack.

    With --ask it speaks as the vehicle's on-board computer: heartbeats, SET_MESSAGE_INTERVAL and PARAM_REQUEST_READ.
    It never arms and never sets a parameter; the rates stay until the vehicle restarts or another sets them.
    """
    judged_by = None if baseline is None else Baseline.load(baseline)
    told = Airframe() if layout is None else with_layout(Airframe(), layout)
    live = is_endpoint(source)
    if ask and not live:
        raise UsageError("--ask is for a link; a log holds what it holds")
    key = None if signing_key is None else read_key(signing_key)
    if live:
        with open_link(source, vehicle, profile, key) as link:
            found = _live(link, source, duration, vehicle if ask else None, ask=ask)
    else:
        found = _logged(Path(source), source, vehicle, profile)
    airframe, _, _ = rotors_of(found.log, told)
    states = monitor_states(found.log, found.found, airframe, judged_by)
    fits = "" if judged_by is None else baseline_statement(judged_by, found.log, found.found)
    found = replace(found, airframe=airframe, monitors=states, baseline=fits)
    typer.echo(json.dumps(_as_json(found)) if as_json else _as_text(found))


def _inspected(
    source: str, log: Log, messages: Mapping[int, float], link: LinkCount | None, answers: tuple[str, ...] = ()
) -> Inspection:
    summaries = tuple(summary(series) for series in log.telemetry.series if len(series))
    clock = clock_of(log.telemetry) if log.profile in PROFILES else None
    return Inspection(source, log, summaries, messages, link, answers, clock, units_of(log), Airframe(), (), "")


def _logged(path: Path, source: str, vehicle: int | None, profile: str | None) -> Inspection:
    log = read_log(path, vehicle, profile)
    if log.profile not in PROFILES:
        return _inspected(source, log, {}, None)
    content = read_content(path)
    span_s = max(content.span_ns / NS_PER_S, 1e-3) if content.pieces else 1.0
    autopilots = [key for key in content.senders if key[1] == Component.AUTOPILOT1 and vehicle in (None, key[0])]
    count = max((content.senders[key] for key in autopilots), key=lambda one: one.received, default=None)
    rates = {} if count is None else {msgid: n / span_s for msgid, n in count.by_message.items()}
    return _inspected(source, log, rates, count)


def _live(link: Link, source: str, duration_s: float, vehicle: int | None, *, ask: bool) -> Inspection:
    """Listen; ask before, if that is wished."""
    answers: tuple[str, ...] = ()
    if ask:
        answers = _ask(link, vehicle or COMPANION_OF)
    before, began = _counts(link), time.monotonic()
    log = link.record(duration_s)
    span_s, after = time.monotonic() - began, _counts(link)
    rates = {msgid: (n - before.get(msgid, 0)) / span_s for msgid, n in after.items() if n > before.get(msgid, 0)}
    return _inspected(source, log, rates, link.count, answers)


def _counts(link: Link) -> Mapping[int, int]:
    return {} if link.count is None else dict(link.count.by_message)


def _ask(link: Link, vehicle: int) -> tuple[str, ...]:
    """Ask for streams and parameters; what came of it, a line for each stream."""
    asker, asked = Asker(vehicle, link.signing), Asked()
    wants: tuple[Want, ...] = ()
    rates: dict[int, float] = {}
    since: dict[int, int] = {}
    began = time.monotonic()

    def each() -> None:
        nonlocal asker, asked, wants, rates
        now = Instant(time.monotonic_ns())
        asked, frames = asker.beat(asked, now)
        if link.stream is not None and time.monotonic() - began > LISTEN_S:
            profile = link.stream.profile
            if not wants:
                asker = Asker(link.vehicle or vehicle, link.signing)
                wants = _wants(link)
                rates = {msgid: n / LISTEN_S for msgid, n in _counts(link).items()}
                since.update(_counts(link))
            came = {m: n - since.get(m, 0) for m, n in _counts(link).items()}
            known = {want.msgid: want.ask_hz for want in wants if want.msgid in asked.streams and came.get(want.msgid)}
            asked, more = asker.stream(asked, wants, {**rates, **known}, now)
            asked, names = asker.read(asked, profile.autopilot, link.stream.parameters, now)
            frames += more + names
        link.send(frames)

    link.record(LISTEN_S + ASK_S, each)
    results = [_result(ack.result) for ack in link.acks]
    answers = f"the autopilot answered {', '.join(dict.fromkeys(results))}" if results else "no answer came"
    names = ", ".join(message_name(msgid) for msgid in asked.streams)
    read = f"{len(link.stream.parameters) if link.stream else 0} parameters read"
    return (f"asked for {names}: {answers}" if names else "asked for no stream: all come", read)


def _wants(link: Link) -> tuple[Want, ...]:
    """What all monitors need, at the rates of the link's profile."""
    if link.stream is None:
        return ()
    needs = frozenset[Signal]().union(*(monitor.needs for monitor in MONITORS))
    profile = link.stream.profile
    return wants_of(profile, needs, (profile.rate_hz, LEAST_HZ, float("inf")), LEAST_HZ)


def _result(number: int) -> str:
    return next((result.name for result in MavResult if result == number), f"result {number}")


def _as_json(found: Inspection) -> dict[str, Any]:
    link = found.link
    counts = (
        None
        if link is None
        else {name: getattr(link, name) for name in ("received", "lost", "reordered", "duplicated")}
    )
    return {
        "source": found.source,
        "profile": found.log.profile,
        "notes": found.log.notes,
        "signals": [asdict(one) for one in found.found],
        "messages": [{"id": m, "name": message_name(m), "rate_hz": hz} for m, hz in sorted(found.messages.items())],
        "link": counts,
        "asked": found.answers,
        "clock": None if found.clock is None else asdict(found.clock),
        "units": asdict(found.units),
        "rotors": found.airframe.layout_statement,
        "baseline": found.baseline,
        "monitors": [asdict(one) for one in found.monitors],
    }


def _as_text(found: Inspection) -> str:
    log, link = found.log, found.link
    parts = [_lines(f"{log.name}: profile {log.profile}")]
    parts += [_lines(f"note: {note}") for note in log.notes]
    parts += [_lines(one) for one in found.answers]
    if found.baseline:
        parts.append(_lines(f"baseline: {found.baseline}"))
    if link is not None:
        whole = link.received + link.lost
        share = 100.0 * link.lost / whole if whole else 0.0
        more = f"{link.duplicated} came twice, {link.reordered} out of order"
        parts.append(_lines(f"link: {link.received} messages, {link.lost} lost ({share:.2f} %), {more}"))
    parts += [_clock(found.clock)] if found.clock is not None else []
    parts += [_messages(found.messages)] if found.messages else []
    parts += [_signals(found.found)] if found.found else []
    parts += [_units(found.units), _lines(found.airframe.layout_statement), _monitors(found.monitors)]
    lacking = any(why.startswith("no ") for one in found.monitors for why in one.missing)
    if link is not None and lacking and not found.answers:
        parts.append(_lines(STREAMS_ADVICE))
    return "\n".join(parts)


def _lines(text: str, indent: str = "  ") -> str:
    """A sentence, in lines of at most `WIDTH` characters."""
    return textwrap.fill(
        printable(text), WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _clock(clock: Clock) -> str:
    drift = "" if clock.drift_ppm is None else f", it runs {abs(clock.drift_ppm):.0f} ppm {_pace(clock.drift_ppm)}"
    late = {name: ms for name, ms in clock.signals_ms.items() if abs(ms) >= 1.0}
    others = "".join(f", {name} {ms:+.0f} ms" for name, ms in late.items())
    beside = f"; beside the gyro{others[1:]}" if others else ""
    return _lines(f"clock: transport delay varies by {clock.spread_ms:.1f} ms{drift}{beside}")


def _pace(drift_ppm: float) -> str:
    return "slower than ours" if drift_ppm > 0 else "faster than ours"


def _messages(rates: Mapping[int, float]) -> str:
    cells = [f"{message_name(msgid)} {rate:.1f}" for msgid, rate in sorted(rates.items(), key=lambda one: -one[1])]
    return _lines("messages a second: " + ", ".join(cells))


def _signals(found: Sequence[Summary]) -> str:
    head = f"{'signal':<20}{'samples':>8}{'rate Hz':>9}{'jitter ms':>10}{'gap s':>8}  range of each column"
    lines = [head]
    for one in found:
        each = (_range(low, high) for low, high in zip(one.lowest, one.highest, strict=True))
        counted = [(text, len(list(some))) for text, some in itertools.groupby(each)]
        ranges = [text if count == 1 else f"{text} x{count}" for text, count in counted]
        timing = f"{_number(one.rate_hz, 1):>9}{_number(one.jitter_ms, 2):>10}{_number(one.longest_gap_s, 3):>8}"
        names = [one.signal, f"  {one.unit}"] if one.unit else [one.signal]
        for number, (name, text) in enumerate(itertools.zip_longest(names, ranges, fillvalue="")):
            middle = f"{one.samples:>8}{timing}" if number == 0 else " " * 35
            lines.append(f"{name:<20}{middle}  {text}".rstrip())
    return "\n".join(lines)


def _units(units: Units) -> str:
    lines = []
    gravity = "" if units.gravity_g is None else f"{units.gravity_g:.2f} g, "
    lines.append(_lines(f"gravity: {gravity}{units.gravity}"))
    for one in units.gyro:
        delay_ms = 1e3 * (one.delay_s or 0.0)
        figures = "" if one.scale is None else f"{one.scale:.2f} of the attitude's slope, {delay_ms:+.0f} ms, "
        lines.append(_lines(f"gyro {one.axis}: {figures}{one.verdict}"))
    if not units.gyro:
        lines.append(_lines("gyro: no attitude to compare it with"))
    return "\n".join(lines)


def _monitors(states: Sequence[MonitorState]) -> str:
    lines = ["monitor"]
    for one in states:
        text = "works" if one.works else "; ".join(one.missing)
        lines.append(_lines(f"  {one.monitor:<16} {text}", " " * 19))
    return "\n".join(lines)


def _range(low: float | None, high: float | None) -> str:
    return "no number" if low is None or high is None else f"{low:.3g}..{high:.3g}"


def _number(value: float | None, places: int) -> str:
    return "-" if value is None else f"{value:.{places}f}"
