"""The kinds of logs as one table: their gates, a made-up kind, and files that were cut off."""

from pathlib import Path

import numpy as np
import pytest

from mavdiag.errors import InputError
from mavdiag.logs import airframe_name_for, gate_for, kinds, read_log
from mavdiag.logs.log import LogKind
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import Log, Series, Signal, Telemetry


def read_made(path: Path, vehicle: int | None, profile: str | None) -> Log:
    values = np.frombuffer(path.read_bytes()[4:], "<f8").reshape(-1, 3)
    t_ns = np.arange(len(values)) * 10_000_000
    return Log(path.name, "", "made-log", Telemetry((Series(Signal.BODY_RATE, t_ns, t_ns, values),)))


MADE = LogKind(
    "made",
    lambda head: head.startswith(b"MADE"),
    read_made,
    ("made-log",),
    GateSpec(min_height_m=1.0),
    airframe_name="made",
)


def test_a_kind_of_log_is_added_by_one_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "flight.made"
    path.write_bytes(b"MADE" + np.arange(6.0).tobytes())
    with pytest.raises(InputError, match="DataFlash, ULog, Crazyflie, DronePropA, tlog"):
        read_log(path)
    among = (MADE, *kinds())
    monkeypatch.setattr("mavdiag.logs.kinds", lambda: among)
    assert read_log(path)["body_rate"].values.tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    assert gate_for("made-log") is MADE.gate
    assert airframe_name_for("made-log") == "made"


def test_l4_take_off_is_trimmed_alike_live_and_in_logs() -> None:
    """5 of 5 healthy take-offs raised a suspicion live, where nothing was trimmed at the start."""
    live, recorded = gate_for("ardupilot"), gate_for("ardupilot-log")
    assert live.trim_start_s == recorded.trim_start_s == gate_for("px4-log").trim_start_s == 5.0
    assert (live.trim_end_s, recorded.trim_end_s) == (0.0, 0.6)
    assert (live.min_thrust, live.need_armed) == (0.1, True)
    assert gate_for("qdrone2") == gate_for("px4") == live
    assert gate_for("crazyflie") == GateSpec(0.38, 0.38, False, 0.5, 0.6)
    assert [airframe_name_for(name) for name in ("crazyflie", "px4-log", "qdrone2")] == ["crazyflie", None, None]
