"""Progress goes to stderr, never longer than a line, and is silent where nobody looks."""

import io
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from mavdiag.commands.progress import SLOW_S, each, shown, told, working


class Terminal(io.StringIO):
    """A terminal that remembers what was written."""

    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [0.0]
    monkeypatch.setattr("mavdiag.commands.progress.time.monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0, 10, 0.0, 0.0), "0 of 10"),
        ((5, 10, 0.5, 10.0), "5 of 10, 0.5 a second, 10 s left"),
        ((5, 10, 0.1, 10.0), "5 of 10, 0.5 a second, 1 min 30 s left"),
        ((1, 10000, 0.0001, 4.0), "1 of 10000, 0.25 a second, 11 h 6 min left"),
        ((10, 10, 1.0, 10.0), "10 of 10, 1 a second, 0 s left"),
    ],
)
def test_the_words(arguments: Any, words: str) -> None:
    assert told(*arguments) == words


@pytest.mark.parametrize("quiet", [False, True])
def test_a_line_now_and_then_where_no_terminal_is(
    clock: list[float], capsys: pytest.CaptureFixture[str], quiet: bool
) -> None:
    with shown("judged", [1.0] * 100, quiet=quiet) as progress:
        for second in range(1, 101):
            clock[0] = float(second)
            progress.add(1.0)
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == (
        []
        if quiet
        else [
            "judged: 10 of 100, 1 a second, 1 min 30 s left",
            "judged: 40 of 100, 1 a second, 1 min 0 s left",
            "judged: 70 of 100, 1 a second, 30 s left",
        ]
    )


ERASED = "\x1b[1A\x1b[2K"  # up to the line of the bar, and away with it


def test_a_bar_on_a_terminal_is_one_line_and_goes_away(clock: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setenv("TERM", "xterm")
    with shown("judged", [1.0, 3.0, 4.0]) as progress:
        for size in (1.0, 3.0, 4.0):
            clock[0] += 1.0
            progress.add(size)
    written = terminal.getvalue()
    assert "judged" in written
    assert "━" in written
    assert written.count("\n") == 1  # before it is erased
    assert written.endswith(ERASED)
    assert sys.stdout is not terminal


def test_the_bar_makes_room_for_lines_on_the_same_terminal(clock: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    with shown("judged", [1.0] * 3) as progress:
        clock[0] = 5.0
        progress.add(1.0)
        progress.say("an answer")
    before, after = terminal.getvalue().split("an answer\n")
    assert before.endswith(ERASED)
    assert "1 of 3, 0.2 a second, 10 s left" in after


def test_one_item_needs_no_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    assert list(each([1], "read")) == [1]
    with shown("judged", [1.0]) as progress:
        progress.add(1.0)
    assert terminal.getvalue() == ""
    assert list(each([1, 2], "read", [5.0, 6.0])) == [1, 2]
    assert terminal.getvalue() != ""


@pytest.mark.parametrize("slow", [True, False])
def test_what_takes_long_is_told_where_no_terminal_is(
    slow: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Timer:
        """One that is over at once, or never."""

        def __init__(self, after_s: float, act: Callable[..., None], args: Any, kwargs: Any) -> None:
            assert after_s == SLOW_S
            self.act: Callable[[], None] = partial(act, *args, **kwargs)

        def start(self) -> None:
            if slow:
                self.act()

        def cancel(self) -> None: ...

        def join(self) -> None: ...

    monkeypatch.setattr("mavdiag.commands.progress.Timer", Timer)
    with working("compiling ..."):
        pass
    assert capsys.readouterr() == ("", "compiling ...\n" if slow else "")
