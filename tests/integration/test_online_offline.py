"""A live loopback flight and the scan of its recording tell the same events."""

import json
from pathlib import Path
from typing import Any

import pytest
from patience import PATIENCE_S

from mavdiag.airframe.load import airframe_named
from mavdiag.as_json import event_json
from mavdiag.demo.subprocesses import Child, child
from mavdiag.judging import judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.link.ports import Endpoint, open_endpoint, wait
from mavdiag.logs import read_log
from mavdiag.logs.tlog import tlog_record
from mavdiag.telemetry import Log
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
