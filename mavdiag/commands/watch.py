"""`mavdiag watch`: a flight in the terminal while it goes on, from a link or from a detector's journal."""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.panel import Panel

from mavdiag.baseline import Baseline
from mavdiag.commandline import stop_signals
from mavdiag.commands.options import Vehicle
from mavdiag.decision.diagnosis import Stage
from mavdiag.errors import InputError, UsageError
from mavdiag.link.keys import read_key
from mavdiag.link.messages import Severity
from mavdiag.link.ports import open_endpoint
from mavdiag.link.signing import Signing, stamp_at
from mavdiag.telemetry import Axis
from mavdiag.terminal.ground_station import GroundStation
from mavdiag.terminal.journal import Journal, VehicleStory
from mavdiag.terminal.live_judge import LiveJudge
from mavdiag.terminal.screen import Screen
from mavdiag.terminal.view import Line, View, picture
from mavdiag.terminal.views import figure_levels, headline, levels, line_for, link_line, rate_strips

__all__ = ["watch"]

LISTENING = ("udpin:", "tcpin:")
ADDRESSES = (*LISTENING, "udpout:", "tcp:", "/dev/")
SPAN_S = 20.0
LOOK_S = 0.05
JOURNAL_LOOK_S = 0.25
EVENTS = 100  # that are kept; more do not fit on a screen
SILENT = "nothing was received yet; is the vehicle or the detector sending to this address?"


def watch(
    source: Annotated[
        str, typer.Argument(metavar="ENDPOINT|JOURNAL", help="udpin:127.0.0.1:14551, ... or a detector's journal.")
    ],
    baseline: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Judge the vehicle here, too: strips and every monitor.")
    ] = None,
    vehicle: Vehicle = None,
    axis: Annotated[Axis, typer.Option(help="Whose rates the strips show.")] = Axis.ROLL,
    span: Annotated[float, typer.Option(min=1.0, metavar="S", help="How much of the flight the strips show.")] = SPAN_S,
    duration: Annotated[
        float | None, typer.Option(min=0.0, metavar="S", help="Stop after so long.  [default: at Ctrl-C]")
    ] = None,
    signing_key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Hear only what is signed with this key (MAVLink 2 signing).")
    ] = None,
) -> None:
    """Watch a flight: a link with its detector's alerts, or the journal that a detector writes.

    Give the detector `--forward udpout:HOST:PORT` and watch `udpin:HOST:PORT`. Without --baseline the detector's own
    figures and texts are shown. On a link that it listens on it sends nothing, on others a ground station's heartbeat.
    On a pipe it prints one line an event.
    """
    until = None if duration is None else time.monotonic() + duration
    with stop_signals() as stopped:

        def ended() -> bool:
            return stopped() or (until is not None and time.monotonic() >= until)

        if not source.startswith(ADDRESSES):
            if baseline is not None or signing_key is not None:
                raise UsageError("--baseline and --signing-key are for a link; a journal has its verdicts")
            with closing(Journal(Path(source))) as journal:
                _follow(journal, vehicle, ended)
            return
        judged_by = None if baseline is None else Baseline.load(baseline)
        key = None if signing_key is None else read_key(signing_key)
        with open_endpoint(source) as endpoint:
            judge = None
            if judged_by is not None:
                datagrams = endpoint.datagrams
                judge = LiveJudge(judged_by, span, vehicle, datagrams, time.time_ns(), _signing(key))
            station = GroundStation(
                endpoint, judge, not source.startswith(LISTENING), vehicle=vehicle, signing=_signing(key)
            )
            _listen(station, endpoint.address, axis, span, ended)


def _signing(key: bytes | None) -> Signing | None:
    return None if key is None else Signing(key, stamp=stamp_at(time.time_ns()))


def _listen(station: GroundStation, address: str, axis: Axis, span_s: float, ended: Callable[[], bool]) -> None:
    whose = ("", "") if station.judge is None else ("detector: ", "here: ")
    events: list[Line] = []

    def draw(width: int) -> Panel:
        return picture(_view(station, address, axis, span_s, events), width)

    with Screen() as screen:
        last = False
        while not last:
            last = ended()
            fresh = [line_for(one, *whose) for one in station.listen(0.0 if last else LOOK_S)]
            events[:] = [*events, *fresh][-EVENTS:]
            screen.show(draw, fresh, last=last)
    if not station.heard:
        raise InputError(f"{address}: nothing was received; is the vehicle or the detector sending to this address?")


def _view(station: GroundStation, address: str, axis: Axis, span_s: float, events: Sequence[Line]) -> View:
    judge = station.judge
    if judge is None:
        alerts = [one for one in events if one.severity <= Severity.CRITICAL]
        says = alerts[-1].text if alerts else "no alert of a detector so far" if station.heard else SILENT
        bars = figure_levels(station)
        return View(f"{address}  {station.t_s:.1f} s", says, bool(alerts), 0.0, 1.0, (), bars, tuple(events))
    now_s = judge.now_s or 0.0
    return View(
        title=f"{address}  {now_s:.1f} s",
        headline=headline(judge.diagnosis) if station.heard else SILENT,
        alert=judge.diagnosis.stage is Stage.FAULT,
        from_s=now_s - span_s,
        to_s=now_s,
        strips=rate_strips(judge, (axis,)),
        levels=levels(judge),
        events=tuple(events),
        foot=link_line(judge),
    )


def _follow(journal: Journal, vehicle: int | None, ended: Callable[[], bool]) -> None:
    events: list[Line] = []

    def draw(width: int) -> Panel:
        return picture(_journal_view(journal, vehicle, events), width)

    with Screen() as screen:
        last = False
        while not last:
            last = ended()
            found = [(number, one) for number, one in journal.read() if vehicle in (None, number)]
            several = vehicle is None and len(journal.vehicles) > 1
            fresh = [_named(number, one) if several else one for number, one in found]
            events[:] = [*events, *fresh][-EVENTS:]
            screen.show(draw, fresh, last=last)
            if not last:
                time.sleep(JOURNAL_LOOK_S)


def _named(number: int, line: Line) -> Line:
    return replace(line, text=f"vehicle {number}: {line.text}")


def _journal_view(journal: Journal, vehicle: int | None, events: Sequence[Line]) -> View:
    chosen = {number: one for number, one in sorted(journal.vehicles.items()) if vehicle in (None, number)}
    words = "; ".join(_words(number, one) for number, one in chosen.items()) or "no vehicle in the journal yet"
    damaged = f"{journal.damaged} lines could not be read" if journal.damaged else ""
    alert = any(one.fault for one in chosen.values())
    return View("journal", words, alert, 0.0, 1.0, events=tuple(events), foot=damaged)


def _words(number: int, story: VehicleStory) -> str:
    parts = [part for part in (story.state, story.stage, story.reason) if part]
    return f"vehicle {number}: {', '.join(parts)}"
