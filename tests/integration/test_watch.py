"""`mavdiag watch`: a link judged in the terminal gives what its log gives, and alerts appear as they come."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from made_baselines import thesis
from plant_process import ALERT, companion, flying

from mavdiag.decision.diagnosis import Change
from mavdiag.judging import judge_in_full
from mavdiag.link.codec import frame_length
from mavdiag.logs import read_log
from mavdiag.terminal.ground_station import LiveJudge
from mavdiag.traces import rate_traces
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.emulator import record_flight
from sitl_plant.options import FlightPlan
from sitl_plant.plant import PlantConfig

STAMP_BYTES = 8  # of the time before each frame of a .tlog


def chunks(data: bytes) -> list[tuple[bytes, int]]:
    """The frames of a telemetry log with their times of arrival."""
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
        changes += live.take(some, some[-1][1])
        brief.take(some, some[-1][1])
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
        command = [sys.executable, "-m", "mavdiag", "watch", address, "--duration", "8"]
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
