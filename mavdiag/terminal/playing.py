"""A log in the terminal as if it were flown now (edge), with keys to stop it, to go back and to go on."""

import math
import os
import select
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from enum import Enum
from typing import Self

import numpy as np

from mavdiag.decision.diagnosis import Stage
from mavdiag.decision.words import diagnosis_line
from mavdiag.rows.front import in_pieces
from mavdiag.telemetry import Axis, Log, Signal
from mavdiag.terminal.ground_station import LiveJudge
from mavdiag.terminal.view import Line, View, line_for
from mavdiag.terminal.watching import LOOK_S, PER_S, Screen, judge_view
from mavdiag.units import NS_PER_S

JUMP_S = 10.0  # that a key goes back or on
BEHIND_S = 1.0  # that the judge may be ahead of what is shown before it begins anew


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
    """Show a log as if it were flown now, until its end, `ended` or a key. from_s: of the log; before, nothing waits.

    begin: what judges it, anew for each way back. At its end it waits for a key where there are keys.
    """
    t_ns = log.telemetry.need(Signal.BODY_RATE).t_ns
    begin_s, end_s = float(np.min(t_ns)) / NS_PER_S, float(np.max(t_ns)) / NS_PER_S
    place, judge = Position(from_s, end_s - begin_s, speed), begin()
    each = max(1, round(1 / PER_S / judge.baseline.link.dt_s))

    def judged_s() -> float:
        return (judge.now_s or begin_s) - begin_s

    def view(events: Sequence[Line]) -> View:
        shown = judge_view(judge, judge.now_s or begin_s, judge.span_s, axis, events)
        how = "stopped" if place.stopped else f"{speed:g} times as fast as flown"
        title = f"{log.name}  {judged_s():.1f} of {place.span_s:.1f} s, {how}"
        says, alert = diagnosis_line(judge.diagnosis), judge.diagnosis.stage is Stage.FAULT
        return replace(shown, title=title, headline=says, alert=alert, foot=HELP if keyboard.live else "a replay")

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
                drawn, over = screen.show([line_for(change) for change in judge.judge(step)]), step is None
            elif not drawn:
                drawn = screen.show(())
            for key in keyboard.read(0.0 if due else LOOK_S):
                place.press(key)
                drawn = False
        screen.show((), last=True)
