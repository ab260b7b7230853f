"""Progress goes to stderr, never longer than a line, and is silent where nobody looks."""

import io
import sys

import pytest

from mavdiag.commands.progress import shown

ERASED = "\x1b[1A\x1b[2K"  # up to the line of the bar, and away with it


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


def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Of the test that runs: pytest takes stderr for itself before it."""
    made = Terminal()
    monkeypatch.setattr(sys, "stderr", made)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    return made


@pytest.mark.parametrize("quiet", [False, True])
def test_a_line_now_and_then_where_no_terminal_is(
    clock: list[float], capsys: pytest.CaptureFixture[str], quiet: bool
) -> None:
    with shown("judged", [1.0] * 100, quiet=quiet) as progress:
        for second in range(1, 101):
            clock[0] = float(second)
            progress.add(1.0)
    left = {10: "0:01:30", 40: "0:01:00", 70: "0:00:30"}
    lines = [] if quiet else [f"judged: {n} of 100, 1 a second, {words} left" for n, words in left.items()]
    assert capsys.readouterr() == ("", "".join(f"{line}\n" for line in lines))


def test_a_bar_on_a_terminal_is_one_line_makes_room_and_goes_away(
    clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = on_terminal(monkeypatch)
    monkeypatch.setattr(sys, "stdout", terminal)
    with shown("judged", [1.0, 1.0, 4.0]) as progress:
        clock[0] = 5.0
        progress.add(1.0)
        progress.say("an answer")
    before, after = terminal.getvalue().split("an answer\n")
    assert before.endswith(ERASED)
    assert "━" in before
    assert "1 of 3, 0.2 a second, 0:00:25 left" in after
    assert after.count("\n") == 1  # before it is erased
    assert after.endswith(ERASED)
