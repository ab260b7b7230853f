"""`mavdiag replay` in a terminal of 80 x 24: its keys stop it, go back and on, and end it."""

import fcntl
import os
import pty
import re
import select
import struct
import sys
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from made_session import baseline_for
from made_vehicle import record
from patience import PATIENCE_S

pytestmark = pytest.mark.realtime


class Terminal:
    """The other end of a terminal."""

    def __init__(self, end: int) -> None:
        self._end, self.shown = end, ""

    def until(self, done: Callable[[str], bool]) -> None:
        """Read until what came since the last call is so."""
        self.shown, give_up = "", time.monotonic() + PATIENCE_S
        while not done(self.shown):
            assert time.monotonic() < give_up, self.shown[-2000:]
            if select.select([self._end], [], [], 0.1)[0]:
                self.shown += os.read(self._end, 65536).decode(errors="replace")

    def press(self, typed: str) -> None:
        os.write(self._end, typed.encode())


@contextmanager
def replaying(*arguments: str) -> Iterator[tuple[Terminal, int]]:
    """The command in a terminal of its own; and its process."""
    child, end = pty.fork()
    if child == 0:
        os.environ |= {"TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"}
        os.execv(sys.executable, [sys.executable, "-m", "mavdiag", "replay", *arguments])
    fcntl.ioctl(end, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    try:
        yield Terminal(end), child
    finally:
        os.close(end)


def times(shown: str) -> list[float]:
    """Where the replay was, in the titles of its pictures."""
    return [float(found) for found in re.findall(r"flight\.tlog  ([0-9.]+) of", shown)]


def test_keys_steer_a_replay(tmp_path: Path) -> None:
    log, baseline = tmp_path / "flight.tlog", tmp_path / "b.json"
    record(log, ((60.0, 0.0), (10.0, 0.5), (50.0, 0.0)))
    baseline_for().save(baseline)
    with replaying(str(log), "--baseline", str(baseline), "--from", "30") as (terminal, child):
        terminal.until(lambda shown: any(time_s > 31 for time_s in times(shown)))
        assert "left/right 10 s, space stops, q ends" in terminal.shown
        terminal.press(" ")
        terminal.until(lambda shown: "stopped" in shown)
        stopped_s = times(terminal.shown)[-1]
        terminal.press("\x1b[D")
        terminal.until(lambda shown: any(abs(time_s - stopped_s + 10) < 1 for time_s in times(shown)))
        terminal.press("\x1b[C" * 5)
        terminal.until(lambda shown: any(abs(time_s - stopped_s - 40) < 1 for time_s in times(shown)))
        assert "propeller fault" in terminal.shown
        terminal.press("q")
        _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0
