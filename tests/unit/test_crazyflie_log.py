"""The Crazyflie reader on logs written by hand: units, signs, event types, and what it says of unusable files."""

import math
from pathlib import Path

import numpy as np
import pytest
from made_logs import CrazyflieEvent, crazyflie_content, with_checksum

from mavdiag.errors import InputError
from mavdiag.logs.crazyflie import read_crazyflie
from mavdiag.telemetry import Signal

PID = CrazyflieEvent(
    65535,
    "fixedFrequency",
    tuple(
        f"controller.{name}(f)"
        for name in ("roll", "pitch", "yaw", "r_roll", "r_pitch", "r_yaw", "cmd_yaw", "accelz", "actuatorThrust")
    ),
)
MARK = CrazyflieEvent(7, "activeMarkerModeChanged", ("mode(B)",))
RECORDS = (
    PID.record(1_000, 10.0, -20.0, 90.0, 0.1, 0.2, 0.3, 32767.0, 1.0, 65535.0),
    PID.record(11_000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
)


def written(folder: Path, content: bytes) -> Path:
    path = folder / "log00"
    path.write_bytes(content)
    return path


def test_units_and_signs_are_si_and_frd(tmp_path: Path) -> None:
    log = read_crazyflie(written(tmp_path, with_checksum(crazyflie_content([PID, MARK], RECORDS))))
    first = {series.signal: series.values[0] for series in log.telemetry.series}
    assert first[Signal.ATTITUDE_SETPOINT] == pytest.approx([math.radians(10), math.radians(-20), -math.pi / 2])
    assert first[Signal.BODY_RATE] == pytest.approx([0.1, 0.2, -0.3])
    assert first[Signal.THRUST_SETPOINT] == pytest.approx([1.0])
    assert first[Signal.SPECIFIC_FORCE][2] == pytest.approx(-9.80665)
    assert np.isnan(first[Signal.SPECIFIC_FORCE][:2]).all()
    assert log.profile == "crazyflie"
    assert log.started_ns == 0


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (with_checksum(crazyflie_content([PID], RECORDS))[:-1], "checksum"),
        (with_checksum(crazyflie_content([PID], RECORDS)[:-5]), "cut short"),
        (with_checksum(crazyflie_content([PID], RECORDS, version=3)), "version 3"),
        (with_checksum(crazyflie_content([PID], [])), "no records"),
        (with_checksum(crazyflie_content([PID], [])[:40]), "header ends early"),
        (with_checksum(crazyflie_content([MARK], [MARK.record(1, 2)])), "no signal"),
        (with_checksum(crazyflie_content([PID], [MARK.record(1, 2)])), "no declared type"),
        (with_checksum(crazyflie_content([CrazyflieEvent(1, "x", ("pm.vbat(s)",))], [b"\1\0"])), "known type"),
        (with_checksum(crazyflie_content([PID], [PID.record(2**60, *range(9))])), "time stamp"),
        (b"\xbc", "first bytes"),
        (b"\xa3\x95\x80\x80 another kind of file", "first bytes"),
        (b"", "empty"),
    ],
)
def test_an_unusable_file_is_one_line_that_names_it(tmp_path: Path, content: bytes, reason: str) -> None:
    with pytest.raises(InputError, match=reason) as caught:
        read_crazyflie(written(tmp_path, content))
    assert "log00" in str(caught.value)
    assert "\n" not in str(caught.value)
