"""`mavdiag watch`: a link judged in the terminal gives what its log gives, and alerts appear as they come."""

import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from made_baselines import thesis
from made_session import baseline_for
from made_vehicle import record
from processes import ALERT, PATIENCE_S, companion, flying

from mavdiag.decision.diagnosis import Change
from mavdiag.judging import judge_in_full
from mavdiag.link.codec import frame_length
from mavdiag.link.datagrams import as_columns
from mavdiag.logs import read_log
from mavdiag.terminal.ground_station import LiveJudge
from mavdiag.traces import rate_traces
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.emulator import record_flight
from sitl_plant.options import FlightPlan
from sitl_plant.plant import PlantConfig

STAMP_BYTES = 8  # of the time before each frame of a .tlog


def chunks(data: bytes) -> list[tuple[bytes, int]]:
    found, at = [], 0
    while at < len(data):
        begin = at + STAMP_BYTES
        length = frame_length(data, begin)
        assert length is not None
        found.append((data[begin : begin + length], int.from_bytes(data[at:begin], "big") * 1000))
        at = begin + length
    return found


def test_a_link_is_judged_as_its_log(tmp_path: Path) -> None:
    path, baseline = tmp_path / "flight.tlog", thesis()
    record_flight(path, FlightPlan(PlantConfig(seed=3), dialect_named("qdrone2"), 1000.0), 12.0, lambda samples: None)
    log = judge_in_full(read_log(path), baseline)
    assert log.chain is not None
    live, brief = LiveJudge(baseline, span_s=60.0), LiveJudge(baseline, span_s=2.0)
    changes: list[Change] = []
    frames = chunks(path.read_bytes())
    for first in range(0, len(frames), 200):
        some = frames[first : first + 200]
        changes += live.take(as_columns(some), some[-1][1])
        brief.take(as_columns(some), some[-1][1])
    (trace, _) = rate_traces(brief.chain, brief.pieces)
    assert 1.9 <= (trace.t_ns[-1] - trace.t_ns[0]) / 1e9 <= 2.6  # only the last seconds are kept
    assert changes == list(log.verdict.changes)[: len(changes)]
    assert len(changes) >= 1
    for one, other in zip(rate_traces(live.chain, live.pieces), rate_traces(log.chain, log.pieces), strict=True):
        count = len(one.t_ns)
        assert count > 10_000
        np.testing.assert_array_equal(one.t_ns, other.t_ns[:count])
        np.testing.assert_allclose(one.residual, other.residual[:count], atol=1e-12)
    assert live.vehicle == 1
    assert live.count is not None
    assert live.count.lost == 0


@pytest.mark.realtime
def test_watch_prints_the_alert_of_a_companion_and_ends_by_itself(tmp_path: Path) -> None:
    with flying("--rate", "100", "--duration", "60", links=2) as (address, companion_address):
        command = [sys.executable, "-m", "mavdiag", "watch", address, "--duration", "6"]
        watching = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        with companion(companion_address) as alerter:
            while watching.poll() is None:
                alerter.alert()
                time.sleep(0.2)
        assert watching.stdout is not None
        shown = watching.stdout.read()
        watching.stdout.close()
    assert watching.returncode == 0, shown
    assert ALERT in shown
    assert "CRITICAL" in shown


class Terminal:
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


@pytest.mark.realtime
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
