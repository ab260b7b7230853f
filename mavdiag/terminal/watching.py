"""The loops behind `mavdiag watch`: what a link or a journal brings, shown until the end (edge)."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from rich.panel import Panel

from mavdiag.decision.diagnosis import Stage
from mavdiag.errors import InputError
from mavdiag.link.messages import Severity
from mavdiag.telemetry import Axis
from mavdiag.terminal.ground_station import GroundStation
from mavdiag.terminal.journal import Journal, VehicleStory
from mavdiag.terminal.screen import Screen
from mavdiag.terminal.view import Line, View, picture
from mavdiag.terminal.views import figure_levels, headline, levels, line_for, link_line, rate_strips

__all__ = ["follow", "listen"]

LOOK_S = 0.05
JOURNAL_LOOK_S = 0.25
EVENTS = 100  # that are kept; more do not fit on a screen
SILENT = "nothing was received yet; is the vehicle or the detector sending to this address?"


def listen(station: GroundStation, address: str, axis: Axis, span_s: float, ended: Callable[[], bool]) -> None:
    """Show what a link brings until `ended`. Raises InputError if nothing came, and as `GroundStation.listen`."""
    whose = ("", "") if station.judge is None else ("detector: ", "here: ")
    events: list[Line] = []

    def draw(width: int, height: int) -> Panel:
        return picture(_view(station, address, axis, span_s, events), width, height)

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


def follow(journal: Journal, vehicle: int | None, ended: Callable[[], bool]) -> None:
    """Show what a journal tells until `ended`. vehicle: the only one of interest; None for all."""
    events: list[Line] = []

    def draw(width: int, height: int) -> Panel:
        return picture(_journal_view(journal, vehicle, events), width, height)

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
