"""The ULog reader on logs written by hand: topics of several PX4 versions, times, and files that pyulog cannot take."""

import math
from pathlib import Path

import numpy as np
import pytest
from made_logs import ULOG_HEAD, ULogTopic, ulog, ulog_message

from mavdiag.errors import InputError
from mavdiag.logs import read_log
from mavdiag.logs.ulog import _by_motor, read_ulog
from mavdiag.telemetry import Log, Signal

STAMP = ("uint64_t", "timestamp")
SENSORS = ULogTopic(
    1,
    "sensor_combined",
    (
        STAMP,
        ("float[3]", "gyro_rad"),
        ("int32_t", "accelerometer_timestamp_relative"),
        ("float[3]", "accelerometer_m_s2"),
    ),
)
SETPOINT = ULogTopic(2, "vehicle_attitude_setpoint", (STAMP, ("float[4]", "q_d"), ("float[3]", "thrust_body")))
OLD_SETPOINT = ULogTopic(
    2,
    "vehicle_attitude_setpoint",
    (STAMP, ("float", "roll_body"), ("float", "pitch_body"), ("float", "yaw_body"), ("float", "thrust")),
)
MOTORS = ULogTopic(4, "actuator_motors", (STAMP, ("float[12]", "control")))
OUTPUTS = ULogTopic(5, "actuator_outputs", (STAMP, ("float[16]", "output")))
STATUS = ULogTopic(7, "vehicle_status", (STAMP, ("uint8_t", "arming_state"), ("uint8_t", "nav_state")))
POSITION = ULogTopic(8, "vehicle_local_position", (STAMP, ("float", "x"), ("float", "y"), ("float", "z")))
HALF, NAN = math.sqrt(0.5), math.nan


def sensors(time_us: int, rate: float = 0.0, delay_us: int = 0) -> bytes:
    return SENSORS.record(time_us, rate, 0, 0, delay_us, 0, 0, -9.81)


def read(folder: Path, content: bytes) -> Log:
    path = folder / "log_4.ulg"
    path.write_bytes(content)
    return read_log(path)


@pytest.mark.parametrize(
    ("topic", "records", "signal", "values"),
    [
        (SETPOINT, [(2_000, HALF, HALF, 0, 0, 0, 0, -0.6)], Signal.ATTITUDE_SETPOINT, [[math.pi / 2, 0, 0]]),
        (SETPOINT, [(2_000, HALF, HALF, 0, 0, 0, 0, -0.6)], Signal.THRUST_SETPOINT, [[0.6]]),
        (OLD_SETPOINT, [(2_000, 0.1, -0.2, 0.3, 0.5)], Signal.ATTITUDE_SETPOINT, [[0.1, -0.2, 0.3]]),
        (OLD_SETPOINT, [(2_000, 0.1, -0.2, 0.3, 0.5)], Signal.THRUST_SETPOINT, [[0.5]]),
        (MOTORS, [(1, 0.1, 0.2, 0.3, 0.4, *[NAN] * 8)], Signal.ACTUATOR, [[0.1, 0.2, 0.3, 0.4]]),
        (OUTPUTS, [(1, 900, 1500, 2000, *[0] * 13)], Signal.ACTUATOR, [[0.0, 0.5, 1.0]]),
        (POSITION, [(0, 0, 0, -1.0), (1, 3, 4, -2.5)], Signal.HEIGHT, [[2.5]]),  # what is stamped 0 was never published
        (POSITION, [(0, 0, 0, -1.0), (1, 3, 4, -2.5)], Signal.POSITION, [[3, 4]]),
        (STATUS, [(1, 1, 15), (2, 2, 3)], Signal.ARMED, [[0], [1]]),
        (STATUS, [(1, 1, 15), (2, 2, 3), (3, 2, 99)], Signal.MODE, [[7 << 16], [4 << 16 | 4 << 24], [NAN]]),
    ],
)
def test_topics_become_signals_in_si_and_frd(
    tmp_path: Path, topic: ULogTopic, records: list[tuple[float, ...]], signal: Signal, values: list[list[float]]
) -> None:
    log = read(tmp_path, ulog([topic], [topic.record(*record) for record in records]))
    np.testing.assert_allclose(log[signal].values, values, atol=1e-6)
    assert (log.profile, log.started_ns) == ("px4-log", 0)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (ulog([SENSORS], [])[:16] + ulog_message("\0", b"x" * 40)[:-8], "beyond use"),  # pyulog would not come back
        (ulog([], [ulog_message("F", b"sensor_combined:sensor_combined[2] inner;")]), "within itself"),
        (ulog([], [ulog_message("F", b"a:uint8_t[60000] x;"), ulog_message("F", b"b:a[60000] x;")]), "too many fields"),
        (ulog([SENSORS], []), "no record"),
        (ULOG_HEAD, "damaged"),
        (ulog([], [ulog_message("B", bytes(8) + b"\xff" * 8 + bytes(24))]), "incompatible"),
        (b"\xa3\x95\x80\x80 another kind of file", "damaged"),
        (b"", "empty"),
    ],
)
def test_an_unusable_file_is_one_line_that_names_it(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "log_4.ulg"
    path.write_bytes(content)
    with pytest.raises(InputError, match=reason) as caught:
        read_ulog(path)
    assert "log_4.ulg" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("lost", "notes"), [(0, 0), (1, 1), (20, 1)])
def test_r7_a_log_that_was_cut_off_says_so(tmp_path: Path, lost: int, notes: int) -> None:
    content = ulog([SENSORS], [sensors(1_000 * k) for k in range(1, 9)])
    log = read(tmp_path, content[: len(content) - lost])
    assert len(log.notes) == notes
    assert all("ends within a message" in note for note in log.notes)


def test_l6_outputs_that_never_move_are_no_motors(tmp_path: Path) -> None:
    still = (1500.0,) * 2
    rows = [OUTPUTS.record(1_000 * k, 1100.0 + k, 1200.0, 1300.0 + k, *still, *(0.0,) * 11) for k in range(1, 9)]
    log = read(tmp_path, ulog([SENSORS, OUTPUTS], [sensors(1_000), *rows]))
    assert log["actuator"].values.shape == (8, 3)


def test_speeds_of_escs_go_to_the_motors_that_they_drive() -> None:
    """PX4 since 1.13 says of each ESC which motor it drives: 101 is the first."""
    speeds, functions = [6000, -3000, 600, *[0] * 5], [102, 101, 104, *[0] * 5]
    found = _by_motor(np.array([[*speeds, *functions]], dtype=np.float64))
    np.testing.assert_allclose(found, [[100 * math.pi, 200 * math.pi, NAN, 20 * math.pi]])
    assert _by_motor(np.zeros((1, 16))).size == 0  # they say nothing: the ESCs' own order counts
