"""`mavdiag inspect` and `mavdiag look`, two names of one command: what a log or a link shows without a judgement."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.load import airframe_from, with_layout
from mavdiag.as_json import json_line
from mavdiag.baseline import Baseline
from mavdiag.commandline import ERROR, say
from mavdiag.commands import options as opt
from mavdiag.commands.progress import each
from mavdiag.errors import InputError, UsageError
from mavdiag.link.codec import message_name
from mavdiag.link.keys import read_key
from mavdiag.link.link import Link, open_link
from mavdiag.link.messages import Component, MavCmd, MavResult
from mavdiag.link.profiles import PROFILES
from mavdiag.link.sequence import LinkCount
from mavdiag.link.wants import LEAST_HZ, Companion, Reading, telling, wants_of
from mavdiag.logs import read_part
from mavdiag.logs.log import TLOG_BYTES, windows_of
from mavdiag.logs.tlog import decode_tlog
from mavdiag.look.inspection import Inspection, inspection_of
from mavdiag.look.words import CLOSING, in_full, in_one_line
from mavdiag.monitors import MONITORS
from mavdiag.telemetry import Instant, Log, Signal
from mavdiag.units import NS_PER_S

LISTENED_S, LISTEN_S = 5.0, 2.0  # to a link unless told otherwise, and before anything is asked for (our choices)
ASK_S = 6.0  # for the answers: some thirty parameters at four each 0.2 s, three times (our choice)
AGAIN_S, TRIES = 1.5, 2  # a stream that has not come by then is asked for once more (our choice)
COMPANION_OF = 1  # as whose companion we speak on a link before a vehicle is known


def inspect(
    sources: Annotated[
        list[str], typer.Argument(metavar="LOG|DIR|ENDPOINT", help="Logs, folders, patterns; or one link.")
    ],
    duration: Annotated[
        float | None,
        Option(min=0.1, max=3600.0, metavar="S", help=f"Listen so long to a link.  [default: {LISTENED_S:g}]"),
    ] = None,
    ask: Annotated[bool, Option("--ask", help="Ask the vehicle for missing streams, and for its rotors.")] = False,
    baseline: Annotated[Path | None, Option(metavar="FILE", help="Show the monitors of this baseline.")] = None,
    columns: opt.Columns = None,
    airframe: Annotated[
        str | None, Option(metavar="NAME|FILE.toml", help="The vehicle.  [default: what the log itself shows]")
    ] = None,
    layout: opt.Layout = None,
    vehicle: opt.Vehicle = None,
    profile: Annotated[str | None, Option(metavar="NAME", help="Link profile, where it is not clear.")] = None,
    signing_key: opt.SigningKey = None,
    from_s: opt.FromS = None,
    to_s: opt.ToS = None,
    as_json: opt.AsJson = False,
) -> None:
    """Say what logs or a live link show without a judgement: rates, units, clock, rotors, trim, saturation, vibration,
    rotor line, and which monitors could work or what they lack. One source is told in full, several in a line each.

    It is no verdict. With --ask it speaks as the vehicle's on-board computer: heartbeats, SET_MESSAGE_INTERVAL and
    PARAM_REQUEST_READ. It never arms and never sets a parameter; the rates stay until the vehicle restarts or another
    sets them. Exit code: 0, or 2 if a source cannot be read; the others are told all the same.
    """
    judged_by = None if baseline is None else Baseline.load(baseline)
    told = Airframe() if airframe is None else airframe_from(airframe)
    told = told if layout is None else with_layout(told, layout)
    live = [source for source in sources if opt.is_endpoint(source)]
    if not live and (ask or signing_key is not None or duration is not None):
        raise UsageError("--ask, --duration and --signing-key are for a link; leave them out for a log")
    if live:
        if (from_s, to_s, columns) != (None,) * 3:
            raise UsageError("--from, --to and --columns are for logs; leave them out for a link")
        if len(sources) > 1:
            raise UsageError("name one link, or logs")
        key = None if signing_key is None else read_key(signing_key)
        with open_link(live[0], vehicle, profile, key) as link:
            asked = ask_for_all(link, vehicle or COMPANION_OF) if ask else ()
            log, rates_hz = hear(link, LISTENED_S if duration is None else duration)
            found = inspection_of(log, told, live[0], judged_by, link.count, rates_hz, asked)
        return say(*([json_line(found)] if as_json else in_full(found)))
    named, mapped = opt.find_logs(sources, columns)
    alone, failed = len(named.logs) == 1, False
    as_table, table = not alone and not as_json and opt.table_fits(), list[Inspection | dict[str, str]]()
    for source in each(named.logs, "looking"):
        shown: Inspection | dict[str, str]
        try:
            if source.trouble:
                raise InputError(source.trouble)
            log = read_part(source.path, vehicle, from_s, to_s, mapped, profile)
            counted = _counted(source.path, vehicle) if alone and log.profile in PROFILES else (None, {})
            shown = found = inspection_of(log, told, log.name, judged_by, *counted)
            lines = in_full(found) if alone else [in_one_line(found)]
        except InputError as error:
            failed, said = True, str(error).removeprefix(f"{source.path}: ")
            if alone and not as_json:
                raise InputError(f"{source.path}: {said}") from error
            shown, lines = {"log": str(source.path), "error": said}, [f"{source.path}: error, {said}"]
        if as_table:
            table.append(shown)
        else:
            say(*([json_line(shown)] if as_json else lines))
    if as_table:
        from mavdiag.terminal.tables import look_table  # rich takes time to load

        look_table(table)
    if not alone and not as_json:
        say(CLOSING)
    raise typer.Exit(ERROR if failed else 0)


def _counted(path: Path, vehicle: int | None) -> tuple[LinkCount | None, Mapping[int, float]]:
    content = decode_tlog(windows_of(path, most=TLOG_BYTES))
    span_s = max(content.span_ns / NS_PER_S, 1e-3) if content.pieces else 1.0
    autopilots = [key for key in content.senders if key[1] == Component.AUTOPILOT1 and vehicle in (None, key[0])]
    count = max((content.senders[key] for key in autopilots), key=lambda sender: sender.received, default=None)
    return count, {} if count is None else {msgid: n / span_s for msgid, n in count.by_message.items()}


def hear(link: Link, duration_s: float) -> tuple[Log, Mapping[int, float]]:
    """What comes in so much time, and the rate of each message."""
    before, began = _counts(link), time.monotonic()
    log = link.record(duration_s)
    span_s, after = time.monotonic() - began, _counts(link)
    return log, {msgid: (n - before.get(msgid, 0)) / span_s for msgid, n in after.items() if n > before.get(msgid, 0)}


def _counts(link: Link) -> dict[int, int]:
    return {} if link.count is None else dict(link.count.by_message)


def ask_for_all(link: Link, vehicle: int) -> tuple[str, ...]:
    """Ask for streams and parameters; what came of it, a line for each stream."""
    companion, reading = Companion(vehicle, link.signing), Reading()
    asked = dict[int, tuple[int, Instant]]()  # tries, and the time of the last one, by message
    since: dict[int, int] | None = None
    began = time.monotonic()
    needs = frozenset[Signal]().union(*(monitor.needs for monitor in MONITORS))

    def request() -> None:
        nonlocal companion, since
        now = Instant(time.monotonic_ns())
        frames = companion.beat(now)
        if link.stream is not None and time.monotonic() - began > LISTEN_S:
            if since is None:
                companion, since = Companion(link.vehicle or vehicle, link.signing), _counts(link)
            profile = link.stream.profile
            wants = wants_of(profile, needs, (profile.rate_hz, LEAST_HZ, float("inf")), LEAST_HZ)
            counts, known = _counts(link), link.stream.parameters
            for want in wants:
                before = since.get(want.msgid, 0)
                tries, at = asked.get(want.msgid, (0, now))
                comes = counts.get(want.msgid, 0) > before if tries else before / LISTEN_S >= want.least_hz
                if not comes and (tries == 0 or (tries < TRIES and now - at >= AGAIN_S)):
                    asked[want.msgid] = (tries + 1, now)
                    interval_us = round(1e6 / want.ask_hz)
                    frames.append(companion.command(MavCmd.SET_MESSAGE_INTERVAL, want.msgid, interval_us))
            frames += map(companion.read, reading.step(telling(profile.autopilot, known), known, now))
        link.send(frames)

    link.record(LISTEN_S + ASK_S, request)
    known = {result.value: result.name for result in MavResult}
    results = dict.fromkeys(known.get(ack.result, f"result {ack.result}") for ack in link.acks)
    answers = f"the autopilot answered {', '.join(results)}" if results else "no answer came"
    names = ", ".join(message_name(msgid) for msgid in asked)
    read = f"{len(link.stream.parameters) if link.stream else 0} parameters read"
    return (f"asked for {names}: {answers}" if names else "asked for no stream: all come", read)
