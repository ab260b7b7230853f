"""A live flight and its recording tell the same, also over a link as bad as asked; `mavdiag watch` and `replay`."""

import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_baselines import thesis
from made_session import baseline_for
from made_vehicle import RATE_HZ, MadeVehicle, record, recorded
from memory_port import memory_pair
from processes import ALERT, PATIENCE_S, companion, flying
from virtual_flight import taught
from virtual_link import heard

from mavdiag.as_json import event_json
from mavdiag.commands.shim import Passage
from mavdiag.decision.diagnosis import Change
from mavdiag.demo.subprocesses import Child
from mavdiag.errors import LinkError
from mavdiag.judging import judge, judge_in_full
from mavdiag.link.datagrams import as_columns
from mavdiag.link.link import Link
from mavdiag.link.ports import Endpoint, open_endpoint, wait
from mavdiag.link.shim import Impairment, Shim
from mavdiag.logs import read_log
from mavdiag.logs.tlog import tlog_record
from mavdiag.terminal.ground_station import LiveJudge
from mavdiag.traces import rate_traces
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.emulator import record_flight
from sitl_plant.options import FlightPlan
from sitl_plant.plant import PlantConfig

SECONDS, ONSET_S = 20.0, 10.0
SAME = ("monitor", "axis", "threshold", "rotor", "fault_type", "severity")
FIELDS = ("t_s", "end_s", "statistic", *SAME)
BAD = Impairment(loss=0.05, jitter_s=0.010, reorder=3, duplicate=0.01)
ONSET_S_BAD, FML_S = 15.0, 0.3
MS = 1_000_000
COUNT = 20_000


def logged(endpoint: Endpoint, plant: Child) -> bytes:
    """What arrives until the flight is over, which may take longer than its time, as a telemetry log."""
    records, flies = [], True
    while flies:
        flies = plant.running
        wait([endpoint], 0.1)
        records += [tlog_record(host_ns // 1000, data) for data, host_ns in endpoint.receive(0.0)]
    return b"".join(records)


def in_order(events: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """What is compared of each event, by monitor and time."""
    return sorted(({key: one[key] for key in FIELDS} for one in events), key=lambda one: (one["monitor"], one["t_s"]))


@pytest.mark.realtime
def test_the_journal_and_the_scan_of_the_recording_agree(tmp_path: Path) -> None:
    baseline = taught(range(100, 106), 25.0, "qdrone2")
    file, journal, log = tmp_path / "b.json", tmp_path / "events.jsonl", tmp_path / "flight.tlog"
    baseline.save(file)
    with (
        open_endpoint("udpin:127.0.0.1:0") as endpoint,
        Child(
            "detector", "--connect", "udpin:127.0.0.1:0", "--baseline", str(file), "--journal", str(journal)
        ) as detector,
    ):
        bound = detector.wait_for("ready", PATIENCE_S).split(",")[0].split()[-1].replace("udpin", "udpout")
        own = endpoint.address.replace("udpin", "udpout")
        fault = ("--fault", "F2/SV2", "--rotor", "3", "--onset", f"{ONSET_S:g}", "--duration", f"{SECONDS:g}")
        with Child("sitl_plant", "run", "--out", bound, "--out", own, "--seed", "9", *fault) as plant:
            plant.wait_for("flies", PATIENCE_S)
            log.write_bytes(logged(endpoint, plant))
        detector.end()
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    live = in_order([line for line in lines if line.get("kind") == "event"])
    verdict = judge(read_log(log), baseline)
    scanned = in_order([event_json(one) for one in verdict.events])
    assert scanned, verdict.reason
    assert [line["monitor"] for line in live] == [line["monitor"] for line in scanned]
    for ours, theirs in zip(live, scanned, strict=True):
        if theirs["end_s"] is None:  # live it may have ended with the link, if the daemon was stopped late
            ours["end_s"] = None
        assert ours == {**theirs, "statistic": pytest.approx(theirs["statistic"], rel=1e-6)}
    assert {event["rotor"] for event in scanned} == {3}


def flight(onset_s: float, seconds: float = 20.0) -> list[tuple[int, bytes]]:
    """Every frame of a flight and when it is sent [ns]."""
    vehicle, frames = MadeVehicle(1), list[tuple[int, bytes]]()
    for k in range(round(seconds * RATE_HZ)):
        vehicle.turning = 0.5 if k >= onset_s * RATE_HZ else 0.0
        frames += [(k * NS_PER_S // RATE_HZ, frame) for frame in vehicle.samples(1)]
    return frames


@pytest.mark.parametrize("seed", [1, 2])
def test_a_fault_is_declared_within_one_fml_of_a_perfect_link(seed: int) -> None:
    frames, shim = flight(ONSET_S_BAD), Shim(BAD, seed)
    good, bad = heard(frames, baseline_for()), heard(frames, baseline_for(), shim)
    assert good.declared[0][0] > 5.0 + ONSET_S_BAD  # the made vehicle's clock begins at 5 s
    assert bad.declared[0][0] == pytest.approx(good.declared[0][0], abs=FML_S)
    assert bad.judged_s > 0.9 * good.judged_s
    assert bad.count is not None
    assert abs(bad.count.lost - shim.count.lost) <= 0.001 * len(frames)
    assert bad.count.duplicated == pytest.approx(shim.count.duplicated, abs=2)


def test_a_healthy_flight_stays_silent_over_a_bad_link() -> None:
    found = heard(flight(99.0, 40.0), baseline_for(), Shim(BAD, 3))
    assert (found.declared, found.events) == ([], 0)
    assert found.judged_s > 30.0


@pytest.mark.realtime
def test_the_command_passes_messages_both_ways_and_says_what_became_of_them() -> None:
    with open_endpoint("udpin:127.0.0.1:0") as station:
        out = station.address.replace("udpin", "udpout")
        options = ["udpin:127.0.0.1:0", out, "--duplicate", "1", "--delay", "5"]
        child = subprocess.Popen(
            [sys.executable, "-m", "mavdiag", "shim", *options],
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert child.stderr is not None
        address = re.search(r"ready: (\S+) to", child.stderr.readline())
        assert address is not None
        with open_endpoint(address[1].replace("udpin", "udpout")) as vehicle:
            vehicle.send(b"one")
            got: list[bytes] = []
            give_up = time.monotonic() + PATIENCE_S
            while len(got) < 2 and time.monotonic() < give_up:
                got += [data for data, _ in station.receive(0.1)]
            station.send(b"back")
            back = [data for data, _ in vehicle.receive(PATIENCE_S)]
        child.send_signal(signal.SIGINT)
        said, _ = child.communicate(timeout=PATIENCE_S)
    assert (got, back, child.returncode) == ([b"one", b"one"], [b"back"], 0)
    assert "from IN to OUT: 1 offered, 2 passed, 0 lost, 0 overflowed, 1 duplicated" in said
    assert "from OUT to IN: 1 offered, 1 passed" in said


def passed(
    impairment: Impairment, seed: int = 1, every_ms: int = 1, looks_ms: int = 1
) -> tuple[Shim, list[tuple[int, int]]]:
    """(when, number) of what comes out of numbered messages, one every so often."""
    shim, found = Shim(impairment, seed), []
    for ms in range(COUNT * every_ms + 3000):
        if ms % every_ms == 0 and ms < COUNT * every_ms:
            shim.offer((ms // every_ms).to_bytes(4, "little"), ms * MS)
        if ms % looks_ms == 0:
            found += [(ms, int.from_bytes(data, "little")) for data in shim.due(ms * MS)]
    return shim, found


def test_loss_duplicates_and_corruption_are_as_often_as_asked() -> None:
    shim, found = passed(Impairment(loss=0.05, duplicate=0.01, corrupt=0.02))
    count = shim.count
    assert count.lost / COUNT == pytest.approx(0.05, abs=0.006)
    assert count.duplicated / COUNT == pytest.approx(0.01, abs=0.003)
    assert count.corrupted / COUNT == pytest.approx(0.02, abs=0.004)
    assert count.passed == len(found) == COUNT - count.lost + count.duplicated
    wrong = sum(number != ms for ms, number in found)
    assert count.corrupted <= wrong <= count.corrupted + 20  # second copies as well
    assert count.reordered == 0


@pytest.mark.parametrize("depth", [1, 8])
def test_a_message_is_overtaken_by_no_more_than_asked(depth: int) -> None:
    shim, found = passed(Impairment(reorder=depth))
    numbers = [number for _, number in found]
    assert sorted(numbers) == list(range(COUNT))
    overtaken = [sum(later > number for later in numbers[:at][-20:]) for at, number in enumerate(numbers)]
    assert (max(overtaken), shim.count.reordered) == (depth, sum(one > 0 for one in overtaken))


def test_a_slow_line_carries_what_it_can_and_throws_the_rest_away() -> None:
    shim, found = passed(Impairment(rate=2000.0))  # 4 bytes a message: half of what comes
    assert len(found) == pytest.approx(COUNT / 2, rel=0.06)
    assert shim.count.overflowed == COUNT - len(found)
    assert max(ms - number for ms, number in found) <= 1003


def test_a_passage_that_was_held_up_goes_by_when_messages_arrived() -> None:
    arrived = [0]
    vehicle, near = memory_pair(clock=lambda: arrived.pop(0) if len(arrived) > 1 else arrived[0])
    far, daemon = memory_pair()
    way = Passage(near, far, Shim(Impairment(jitter_s=0.010), 1))
    for k in range(500):
        vehicle.send(k.to_bytes(4, "little"))
    arrived[:] = [k * 100 * MS for k in range(500)]  # so none overtakes another
    way.step(60_000 * MS)
    assert [int.from_bytes(data, "little") for data, _ in daemon.receive(0.0)] == list(range(500))


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "made_program.py").write_text(
        "import sys, time\n"
        "print('first line', flush=True)\n"
        "for _ in range(int(sys.argv[1])):\n"
        "    time.sleep(0.1); print('tick', flush=True)\n"
        "print('last line', flush=True)\n"
    )
    (here := tmp_path / "here").mkdir()
    (here / "made_program.py").write_text("raise SystemExit('of the present folder')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(here)
    return "made_program"


@pytest.mark.realtime
def test_the_demo_ends_with_one_json_line_and_writes_the_report_that_was_asked_for(tmp_path: Path) -> None:
    file, page = tmp_path / "b.json", tmp_path / "report.html"
    taught(range(100, 106), 25.0, "qdrone2").save(file)
    command = [sys.executable, "-m", "mavdiag", "demo", "--json", "--duration", "10", "--baseline", str(file)]
    run = subprocess.run([*command, "--report", str(page)], stdout=subprocess.PIPE, check=False)
    assert (json.loads(run.stdout)["onset_s"], page.exists()) == (3.0, True)


@pytest.mark.realtime
def test_b15_a_process_that_died_is_not_waited_for_and_a_timeout_is_of_the_whole_wait(module: str) -> None:
    with Child(module, "0") as one:
        assert one.wait_for("last", PATIENCE_S) == "last line"
        begun = time.monotonic()
        with pytest.raises(LinkError, match="made_program stopped: last line"):
            one.wait_for("ready", 10 * PATIENCE_S)
        assert time.monotonic() - begun < PATIENCE_S
    with Child(module, "1000") as one:
        one.wait_for("first", PATIENCE_S)
        with pytest.raises(LinkError, match="did not get ready: tick"):
            one.wait_for("ready", 1.0)


def test_a_link_is_judged_as_its_log(tmp_path: Path) -> None:
    path, baseline = tmp_path / "flight.tlog", thesis()
    record_flight(path, FlightPlan(PlantConfig(seed=3), dialect_named("qdrone2"), 1000.0), 12.0, lambda samples: None)
    log = judge_in_full(read_log(path), baseline)
    assert log.chain is not None
    live, brief = LiveJudge(baseline, span_s=60.0), LiveJudge(baseline, span_s=2.0)
    link, changes, frames = Link(memory_pair()[0]), list[Change](), list(recorded(path))
    for first in range(0, len(frames), 200):
        some = frames[first : first + 200]
        telemetry = link.take(as_columns(some), some[-1][1])
        changes += live.judge(telemetry)
        brief.judge(telemetry)
    (trace, _) = rate_traces(brief.chain, brief.pieces)
    assert 1.9 <= (trace.t_ns[-1] - trace.t_ns[0]) / 1e9 <= 2.6  # only the last seconds are kept
    assert changes == list(log.verdict.changes)[: len(changes)]
    assert len(changes) >= 1
    for one, other in zip(rate_traces(live.chain, live.pieces), rate_traces(log.chain, log.pieces), strict=True):
        count = len(one.t_ns)
        assert count > 10_000
        np.testing.assert_array_equal(one.t_ns, other.t_ns[:count])
        np.testing.assert_allclose(one.residual, other.residual[:count], atol=1e-12)
    assert (link.vehicle, link.count and link.count.lost) == (1, 0)


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
