"""A live loopback flight and the scan of its recording tell the same events."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from made_session import baseline_for
from made_vehicle import RATE_HZ, MadeVehicle
from patience import PATIENCE_S
from virtual_link import heard

from mavdiag.airframe.load import airframe_named
from mavdiag.as_json import event_json
from mavdiag.demo.subprocesses import Child, child
from mavdiag.judging import judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.link.ports import Endpoint, open_endpoint, wait
from mavdiag.link.shim import Impairment, Shim
from mavdiag.logs import read_log
from mavdiag.logs.tlog import tlog_record
from mavdiag.telemetry import Log
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.plant import PlantConfig

SECONDS, ONSET_S = 24.0, 12.0
SAME = ("monitor", "axis", "threshold", "rotor", "fault_type", "severity")
FIELDS = ("t_s", "end_s", "statistic", *SAME)


def record(endpoint: Endpoint, plant: Child) -> bytes:
    """What arrives until the flight is over, as a telemetry log: every datagram is one frame.

    On a machine with much to do the flight lasts longer than its time.
    """
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
    flights = [
        Log(f"f{i}", f"{i:064x}", "qdrone2", flight_telemetry(PlantConfig(seed=50 + i), 20.0)[0]) for i in range(4)
    ]
    baseline = learn(flights, LearnOptions(airframe=airframe_named("qdrone2")), created="2026-01-01T00:00:00+00:00")
    file, journal, log = tmp_path / "b.json", tmp_path / "events.jsonl", tmp_path / "flight.tlog"
    baseline.save(file)
    with (
        open_endpoint("udpin:127.0.0.1:0") as endpoint,
        child(
            "detector", "--connect", "udpin:127.0.0.1:0", "--baseline", str(file), "--journal", str(journal)
        ) as detector,
    ):
        bound = detector.wait_for("ready", PATIENCE_S).split(",")[0].split()[-1].replace("udpin", "udpout")
        own = endpoint.address.replace("udpin", "udpout")
        fault = ("--fault", "F2/SV2", "--rotor", "3", "--onset", f"{ONSET_S:g}", "--duration", f"{SECONDS:g}")
        with child("sitl_plant", "run", "--out", bound, "--out", own, "--seed", "9", *fault) as plant:
            plant.wait_for("flies", PATIENCE_S)
            log.write_bytes(record(endpoint, plant))
            plant.finish(PATIENCE_S)
        detector.end()
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    live = in_order([line for line in lines if line.get("kind") == "event"])
    verdict = judge(read_log(log), baseline)
    scanned = in_order([event_json(one.t_s, one.end_s, one.event) for one in verdict.events])
    assert scanned, verdict.reason
    assert [line["monitor"] for line in live] == [line["monitor"] for line in scanned]
    for ours, theirs in zip(live, scanned, strict=True):
        if theirs["end_s"] is None:  # live it may have ended with the link, if the daemon was stopped late
            ours["end_s"] = None
        assert ours == {**theirs, "statistic": pytest.approx(theirs["statistic"], rel=1e-6)}
    assert {event["rotor"] for event in scanned} == {3}


BAD = Impairment(loss=0.05, jitter_s=0.010, reorder=3, duplicate=0.01)
ONSET_S_BAD, FML_S = 15.0, 0.3


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
    assert got == [b"one", b"one"]
    assert back == [b"back"]
    assert child.returncode == 0
    assert "from IN to OUT: 1 offered, 2 passed, 0 lost, 0 overflowed, 1 duplicated" in said
    assert "from OUT to IN: 1 offered, 1 passed" in said
