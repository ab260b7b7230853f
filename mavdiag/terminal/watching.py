"""The loops behind `mavdiag watch`, `replay` and the demo (edge): a link, a journal or a log, shown until the end."""

import json
import math
import os
import select
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any, Self

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.text import Text

from mavdiag.decision.diagnosis import Change, Stage
from mavdiag.errors import InputError
from mavdiag.link.messages import Severity
from mavdiag.printable import printable
from mavdiag.rows.front import in_pieces
from mavdiag.storage import open_regular
from mavdiag.telemetry import Axis, Log, Signal
from mavdiag.terminal.ground_station import GroundStation, Line, LiveJudge
from mavdiag.terminal.view import SEVERITY, STYLES, View, figure_levels, levels_of, line_for, picture, rate_strips
from mavdiag.units import NS_PER_S

PER_S = 10
LOOK_S = 0.05
JOURNAL_LOOK_S = 0.25
EVENTS = 100  # that are kept, and as many older alerts; more do not fit on a screen
JOURNAL_BYTES = 1 << 40  # there is no limit: it is read in pieces
READ_BYTES = 1 << 20  # at a time
JUMP_S = 10.0  # that a key goes back or on
BEHIND_S = 1.0  # that the judge may be ahead of what is shown before it begins anew
SILENT = "nothing was received; is the vehicle or the detector sending to this address?"


class Screen(ExitStack):
    """A picture of all events so far, drawn again and again on a terminal; on anything else one line an event."""

    def __init__(self, draw: Callable[[Sequence[Line]], View], *, console: Console | None = None) -> None:
        super().__init__()
        self._draw, self._console = draw, console or Console()
        self._live: Live | None = None
        self._size, self._until = self._console.size, 0.0
        self._events: list[Line] = []

    def forget(self) -> None:
        """Leave out what happened so far."""
        self._events.clear()

    def show(self, fresh: Sequence[Line], *, last: bool = False) -> bool:
        """Bring it up to date, at most ten times a second; returns whether it is. fresh: since. last: in any case."""
        events = [*self._events, *fresh]
        older = [line for line in events[:-EVENTS] if line.alert]
        self._events[:] = [*older[-EVENTS:], *events[-EVENTS:]]
        if not self._console.is_terminal:
            for line in fresh:
                shown = Text(line.head + printable(line.text), style=line.style)
                self._console.print(shown, soft_wrap=True, highlight=False)
            return True
        now, size = self._console.get_time(), self._console.size
        if not last and now < self._until:
            return False
        self._until = now + 1 / PER_S
        if size != self._size:  # what was drawn for the old one would stay in part
            self.close()
            self._console.clear()
            self._size, self._live = size, None
        self._live = self._live or self.enter_context(Live(console=self._console, auto_refresh=False))
        self._live.update(picture(self._draw(self._events), size.width, size.height - 1), refresh=True)
        return True


def watch(station: GroundStation, address: str, axis: Axis, span_s: float, ended: Callable[[], bool]) -> None:
    """Show a link until `ended`. Raises as `GroundStation.listen`."""

    def view(events: Sequence[Line]) -> View:
        now_s = station.t_s if station.judge is None else station.judge.now_s or 0.0
        shown = replace(link_view(station, now_s, span_s, axis, events), title=f"{address}  {now_s:.1f} s")
        if station.judge is None:
            alerts = [line.text for line in events if line.alert]
            says = alerts[-1] if alerts else "no alert of a detector so far"
            shown = replace(shown, headline=says, stage=Stage.FAULT if alerts else Stage.NOT_JUDGED)
        return shown if station.heard else replace(shown, headline=SILENT)

    listen(station, view, ("", "") if station.judge is None else ("detector: ", "here: "), ended)


def listen(
    station: GroundStation,
    view: Callable[[Sequence[Line]], View],
    whose: tuple[str, str],
    ended: Callable[[], bool],
    *,
    quiet: bool = False,
) -> list[Change]:
    """Show what a ground station hears until `ended`, with `whose` before texts and changes; return the changes."""
    changes: list[Change] = []
    with Screen(view, console=Console(quiet=quiet)) as screen:
        last = False
        while not last:
            last = ended()
            fresh = station.listen(0.0 if last else LOOK_S)
            changes += [news for news in fresh if isinstance(news, Change)]
            screen.show([line_for(news, *whose) for news in fresh], last=last)
    return changes


def link_view(station: GroundStation, now_s: float, span_s: float, axis: Axis, events: Sequence[Line]) -> View:
    """A moment of a link: strips and every monitor where it is judged here, else the thesis rule by its figures."""
    if station.judge is None:
        return View(levels=figure_levels(station), events=tuple(events))
    return replace(judge_view(station.judge, now_s, span_s, axis, events), foot=station.link_line)


def judge_view(judge: LiveJudge, now_s: float, span_s: float, axis: Axis, events: Sequence[Line]) -> View:
    """A moment of what is judged here: strips and every monitor."""
    strips, levels = rate_strips(judge, axis), levels_of(judge)
    says, stage = str(judge.diagnosis), judge.diagnosis.stage
    return View("", says, stage, now_s - span_s, now_s, strips, levels, tuple(events))


@dataclass(slots=True)
class VehicleStory:
    """What a journal says of one vehicle: the latest state of its session, stage of the decision and reason."""

    state: str = ""
    stage: str = ""
    reason: str = ""

    def take(self, content: dict[str, Any]) -> Line | None:
        """A line of the journal as one to show; None if it is of no interest here."""
        t_s = float(content.get("vehicle_s") or 0.0)
        match content["kind"]:
            case "state":
                self.state = str(content["to"])
                return Line(t_s, Severity.INFO, f"{content['from']} -> {content['to']}: {content['reason']}")
            case "stage":
                self.stage, self.reason = str(content["stage"]), str(content["reason"])
                rotor = "" if content.get("rotor") is None else f", rotor {content['rotor']}"
                words = f"{content.get('fault_kind') or self.stage}: {self.reason}{rotor}"
                return Line(t_s, SEVERITY.get(self.stage, Severity.INFO), words)
            case "text":
                return Line(t_s, Severity(int(content["severity"])), str(content["text"]))
            case "note":
                return Line(t_s, Severity.INFO, str(content["text"]))
            case _:
                return None


class Journal:
    """The journal of a detector, followed while it is written, over rotations too. vehicles: by system id."""

    def __init__(self, path: Path) -> None:
        self.path, self._stack = path, ExitStack()
        self._open()
        self.vehicles: dict[int, VehicleStory] = {}
        self.damaged = self.sound = 0  # lines

    def read(self) -> list[tuple[int, Line]]:
        """What was written since the last call, by vehicle, in its order."""
        found = self._rest()
        if self._rotated():
            found += self._rest()  # what came between the two looks
            self.close()
            self._open()
            found += self._rest()
        return found

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _open(self) -> None:
        self._file, self._begun = self._stack.enter_context(open_regular(self.path, JOURNAL_BYTES)), b""

    def _rotated(self) -> bool:
        """Whether another file has the journal's name now; between the two there is none."""
        try:
            return not os.path.samestat(self.path.stat(), os.fstat(self._file.fileno()))
        except FileNotFoundError:
            return False

    def _rest(self) -> list[tuple[int, Line]]:
        found: list[tuple[int, Line]] = []
        while data := self._file.read(READ_BYTES):
            *lines, self._begun = (self._begun + data).split(b"\n")
            for line in lines:
                try:
                    content = json.loads(line)
                    self.sound += "kind" in content
                    if content.get("vehicle") is None:
                        continue
                    number = int(content["vehicle"])
                    told = self.vehicles.setdefault(number, VehicleStory()).take(content)
                    found += [] if told is None else [(number, told)]
                except (ValueError, TypeError, AttributeError, KeyError, ArithmeticError, RecursionError):
                    self.damaged += bool(line.strip())
        return found


def follow(journal: Journal, vehicle: int | None, ended: Callable[[], bool]) -> None:
    """Show what a journal tells until `ended`. vehicle: the only one of interest; None for all."""
    with Screen(lambda events: _journal_view(journal, vehicle, events)) as screen:
        last = False
        while not last:
            last = ended()
            found = [(number, line) for number, line in journal.read() if vehicle in (None, number)]
            if journal.damaged and not journal.sound:
                raise InputError(f"{journal.path}: no journal of a detector; name the file of its --journal, or a link")
            several = vehicle is None and len(journal.vehicles) > 1
            fresh = [replace(line, text=f"vehicle {n}: {line.text}") if several else line for n, line in found]
            screen.show(fresh, last=last)
            if not last:
                time.sleep(JOURNAL_LOOK_S)


def _journal_view(journal: Journal, vehicle: int | None, events: Sequence[Line]) -> View:
    chosen = {number: story for number, story in sorted(journal.vehicles.items()) if vehicle in (None, number)}
    says = ((number, ", ".join(filter(None, (one.state, one.stage, one.reason)))) for number, one in chosen.items())
    told = "; ".join(f"vehicle {number}: {words}" for number, words in says)
    damaged = f"{journal.damaged} lines could not be read" if journal.damaged else ""
    stages = [stage for stage in STYLES if any(story.stage == stage for story in chosen.values())]
    worst = stages[-1] if stages else Stage.NOT_JUDGED
    return View("journal", told or "no vehicle in the journal yet", worst, events=tuple(events), foot=damaged)


#: What a key asks for; STOP also lets it go on.
Key = Enum("Key", ["BACK", "ON", "STOP", "END"])

#: What terminals send for a key; arrows in both modes of the cursor keys (xterm, "ctlseqs").
KEYS = {"\x1b[D": Key.BACK, "\x1bOD": Key.BACK, "\x1b[C": Key.ON, "\x1bOC": Key.ON, " ": Key.STOP, "q": Key.END}
HELP = "left/right 10 s, space stops, q ends"


def keys_in(typed: str) -> tuple[list[Key], str]:
    r"""The keys in what was typed, and the beginning of one that has not come whole.

    >>> keys_in(" x\x1b[D\x1b[")
    ([<Key.STOP: 3>, <Key.BACK: 1>], '\x1b[')
    """
    found = []
    while typed:
        code = next((code for code in KEYS if typed.startswith(code)), "")
        if not code and any(code.startswith(typed) for code in KEYS):
            break
        found += [KEYS[code]] if code else []
        typed = typed[len(code) or 1 :]
    return found, typed


class Keyboard(ExitStack):
    """The terminal's keys, each as it is typed; none where stdin is no terminal. live: whether there are any."""

    live = False
    _begun = ""

    def __enter__(self) -> Self:
        if sys.stdin.isatty() and sys.stdout.isatty():
            import termios  # POSIX alone has it
            import tty

            before = termios.tcgetattr(sys.stdin)
            self.callback(termios.tcsetattr, sys.stdin, termios.TCSADRAIN, before)
            tty.setcbreak(sys.stdin)
            self.live = True
        return self

    def read(self, timeout_s: float) -> list[Key]:
        """The keys that were typed, waited for so long."""
        if not self.live:
            time.sleep(timeout_s)
        elif select.select([sys.stdin], [], [], timeout_s)[0]:
            typed = os.read(sys.stdin.fileno(), 64).decode(errors="replace")
            found, self._begun = keys_in(self._begun + typed)
            return found if typed else [Key.END]  # the terminal is gone
        return []


@dataclass(slots=True)
class Position:
    """Where a replay is: at_s of the log. speed: times as fast as flown. stopped: it waits for a key."""

    at_s: float
    span_s: float
    speed: float
    stopped: bool = False
    ended: bool = False

    def move(self, passed_s: float) -> None:
        """Let time pass."""
        if not self.stopped:
            self.at_s += self.span_s if math.isinf(self.speed) else self.speed * passed_s
        self.at_s = min(self.at_s, self.span_s)

    def press(self, key: Key) -> None:
        """Do what a key asks for."""
        if key in (Key.BACK, Key.ON):
            self.at_s = min(max(0.0, self.at_s + (JUMP_S if key is Key.ON else -JUMP_S)), self.span_s)
        self.stopped ^= key is Key.STOP
        self.ended |= key is Key.END


def play(
    log: Log, begin: Callable[[], LiveJudge], speed: float, from_s: float, axis: Axis, ended: Callable[[], bool]
) -> None:
    """Show a log as if it were flown now, until its end, `ended` or a key.

    from_s: of the log; before, nothing waits, and where there are no keys nothing is told.
    begin: what judges it, anew for each way back. At its end it waits for a key where there are keys.
    """
    t_ns = log.telemetry.need(Signal.BODY_RATE).t_ns
    begin_s, end_s = float(np.min(t_ns)) / NS_PER_S, float(np.max(t_ns)) / NS_PER_S
    from_ns = round((begin_s + from_s) * NS_PER_S)
    place, judge = Position(from_s, end_s - begin_s, speed), begin()
    each = max(1, round(1 / PER_S / judge.baseline.link.dt_s))

    def judged_s() -> float:
        return (judge.now_s or begin_s) - begin_s

    def view(events: Sequence[Line]) -> View:
        shown = judge_view(judge, judge.now_s or begin_s, judge.span_s, axis, events)
        how = "stopped" if place.stopped else f"{speed:g} times as fast as flown"
        title = f"{log.name}  {judged_s():.1f} of {place.span_s:.1f} s, {how}"
        return replace(shown, title=title, foot=HELP if keyboard.live else "a replay")

    with Keyboard() as keyboard, Screen(view) as screen:
        steps, over, drawn, before_s = in_pieces(log.telemetry, each), False, False, time.monotonic()
        while not (ended() or place.ended or (over and not (keyboard.live and math.isfinite(speed)))):
            now_s = time.monotonic()
            place.move(now_s - before_s)
            before_s = now_s
            if place.at_s < judged_s() - BEHIND_S:
                judge, steps, over = begin(), in_pieces(log.telemetry, each), False
                screen.forget()
            due = not over and judged_s() <= place.at_s
            if due:
                step = next(steps, None)
                fresh = [line_for(one) for one in judge.judge(step) if keyboard.live or one.t_ns >= from_ns]
                drawn, over = screen.show(fresh), step is None
            elif not drawn:
                drawn = screen.show(())
            for key in keyboard.read(0.0 if due else LOOK_S):
                place.press(key)
                drawn = False
        screen.show((), last=True)
