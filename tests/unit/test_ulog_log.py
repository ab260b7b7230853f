"""The ULog reader on logs written by hand: topics of several PX4 versions, times, and files that pyulog cannot take."""

import math
import struct
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FrameType

import pytest
from made_logs import ULOG_HEAD, ULogTopic, ulog, ulog_message

from mavdiag.errors import InputError
from mavdiag.logs.ulog import read_ulog
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
ATTITUDE = ULogTopic(3, "vehicle_attitude", (STAMP, ("uint64_t", "timestamp_sample"), ("float[4]", "q")))
MOTORS = ULogTopic(4, "actuator_motors", (STAMP, ("float[12]", "control")))
OUTPUTS = ULogTopic(5, "actuator_outputs", (STAMP, ("float[16]", "output")))
ESC = ULogTopic(6, "esc_report", (("int32_t", "esc_rpm"), ("float", "esc_current")))
STATUS = ULogTopic(7, "vehicle_status", (STAMP, ("uint8_t", "arming_state")))
POSITION = ULogTopic(8, "vehicle_local_position", (STAMP, ("float", "z")))
GPS = ULogTopic(9, "vehicle_gps_position", (STAMP, ("uint64_t", "time_utc_usec")))

HALF = math.sqrt(0.5)


def sensors(time_us: int, rate: float = 0.0, delay_us: int = 0) -> bytes:
    return SENSORS.record(time_us, rate, 0, 0, delay_us, 0, 0, -9.81)


def read(folder: Path, content: bytes) -> Log:
    path = folder / "log_4.ulg"
    path.write_bytes(content)
    return read_ulog(path)


def values(log: Log, signal: Signal) -> list[list[float]]:
    found: list[list[float]] = log.telemetry.need(signal).values.tolist()
    return found


def test_quaternions_become_angles_and_thrust_a_size(tmp_path: Path) -> None:
    log = read(tmp_path, ulog([SETPOINT], [SETPOINT.record(2_000, HALF, HALF, 0, 0, 0, 0, -0.6)]))
    assert values(log, Signal.ATTITUDE_SETPOINT)[0] == pytest.approx([math.pi / 2, 0, 0], abs=1e-6)
    assert values(log, Signal.THRUST_SETPOINT)[0] == pytest.approx([0.6])
    assert log.profile == "px4-log"
    assert log.started_ns == 0


def test_older_setpoints_are_taken_as_angles(tmp_path: Path) -> None:
    log = read(tmp_path, ulog([OLD_SETPOINT], [OLD_SETPOINT.record(2_000, 0.1, -0.2, 0.3, 0.5)]))
    assert values(log, Signal.ATTITUDE_SETPOINT)[0] == pytest.approx([0.1, -0.2, 0.3])
    assert values(log, Signal.THRUST_SETPOINT)[0] == pytest.approx([0.5])


def test_the_accelerometer_has_its_own_time_and_may_be_missing(tmp_path: Path) -> None:
    log = read(tmp_path, ulog([SENSORS], [sensors(2_000, 0.5, -300), sensors(6_000, 0.5, 2**31 - 1)]))
    assert log.telemetry.need(Signal.BODY_RATE).t_ns.tolist() == [2_000_000, 6_000_000]
    assert log.telemetry.need(Signal.SPECIFIC_FORCE).t_ns.tolist() == [1_700_000]


def test_the_time_of_the_sample_goes_before_that_of_its_publication(tmp_path: Path) -> None:
    log = read(tmp_path, ulog([ATTITUDE], [ATTITUDE.record(2_000, 1_900, 1, 0, 0, 0)]))
    assert log.telemetry.need(Signal.ATTITUDE).t_ns.tolist() == [1_900_000]


def test_outputs_in_use_are_kept(tmp_path: Path) -> None:
    motors = MOTORS.record(1, 0.1, 0.2, 0.3, 0.4, *[math.nan] * 8)
    assert values(read(tmp_path, ulog([MOTORS], [motors])), Signal.ACTUATOR)[0] == pytest.approx([0.1, 0.2, 0.3, 0.4])
    pulses = OUTPUTS.record(1, 900, 1500, 2000, *[0] * 13)
    assert values(read(tmp_path, ulog([OUTPUTS], [pulses])), Signal.ACTUATOR)[0] == pytest.approx([0, 0.5, 1])


def test_rotor_speeds_come_from_nested_reports(tmp_path: Path) -> None:
    fields = b"esc_status:uint64_t timestamp;esc_report[8] esc;"
    body = struct.pack("<HQ", 1, 5) + b"".join(struct.pack("<if", rpm, 1.0) for rpm in (6000, -3000, 0, 0, 0, 0, 0, 0))
    subscription = ulog_message("A", struct.pack("<BH", 0, 1) + b"esc_status")
    content = ulog([], [ESC.definition(), ulog_message("F", fields), subscription, ulog_message("D", body)])
    speeds = values(read(tmp_path, content), Signal.ROTOR_SPEED)[0]
    assert speeds == pytest.approx([200 * math.pi, 100 * math.pi])


def test_height_is_up_and_armed_is_state_two(tmp_path: Path) -> None:
    records = [POSITION.record(1, -2.5), STATUS.record(1, 1), STATUS.record(2, 2)]
    log = read(tmp_path, ulog([POSITION, STATUS], records))
    assert values(log, Signal.HEIGHT) == [[2.5]]
    assert values(log, Signal.ARMED) == [[0], [1]]


def test_gps_dates_the_first_sample(tmp_path: Path) -> None:
    records = [sensors(4_000_000), GPS.record(4_500_000, 0), GPS.record(5_000_000, 1_577_880_000_000_000)]
    assert read(tmp_path, ulog([SENSORS, GPS], records)).started_ns == 1_577_879_999_000_000_000


def test_nothing_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    unknown = ulog_message("D", struct.pack("<HQ", 99, 1))
    read(tmp_path, ulog([SENSORS], [sensors(1), unknown, b"\0\0\0\0\0", sensors(2)]))
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""


ENDLESS = ulog([SENSORS], [])[:16] + ulog_message("\0", b"x" * 40)[:-8]
ITSELF = ulog([], [ulog_message("F", b"sensor_combined:sensor_combined[2] inner;")])
HUGE = ulog([], [ulog_message("F", b"a:uint8_t[60000] x;"), ulog_message("F", b"b:a[60000] x;")])


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (ENDLESS, "beyond use"),
        (ITSELF, "within itself"),
        (HUGE, "too many fields"),
        (ulog([SENSORS], []), "no record"),
        (ULOG_HEAD, "damaged"),
        (ulog([], [ulog_message("B", bytes(8) + b"\xff" * 8 + bytes(24))]), "incompatible"),
        (b"\xa3\x95\x80\x80 another kind of file", "damaged"),
        (b"", "empty"),
    ],
)
def test_an_unusable_file_is_one_line_that_names_it(tmp_path: Path, content: bytes, reason: str) -> None:
    with pytest.raises(InputError, match=reason) as caught:
        read(tmp_path, content)
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


SYNC = ulog_message("S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12")  # PX4 writes one now and then


def calls_of(work: Callable[[], object]) -> int:
    """How many functions are called in it: a measure of work that does not depend on the machine."""
    count = 0

    def counted(frame: FrameType, event: str, arg: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(counted)
    try:
        work()
    finally:
        sys.setprofile(None)
    return count


@pytest.mark.parametrize("where", ["behind", "between"])
def test_space_that_the_logger_reserved_costs_as_much_however_long_it_is(where: str, tmp_path: Path) -> None:
    plain = read(tmp_path, ulog([SENSORS], [sensors(k) for k in range(1, 200)]))
    steps = []
    for megabytes in (1, 8):
        hole, records = bytes(megabytes << 20) + SYNC, [sensors(k) for k in range(1, 200)]
        records.insert(100 if where == "between" else len(records), hole)
        content = ulog([SENSORS], records)
        assert values(read(tmp_path, content), Signal.BODY_RATE) == values(plain, Signal.BODY_RATE)
        steps.append(calls_of(partial(read, tmp_path, content)))
    assert steps[1] <= 1.2 * steps[0]


def test_parameters_that_are_not_set_are_left_out(tmp_path: Path) -> None:
    def parameter(name: str, value: float) -> bytes:
        key = f"float {name}".encode()
        return ulog_message("P", bytes([len(key)]) + key + struct.pack("<f", value))

    records = [parameter("A", math.nan), parameter("B", math.inf), parameter("C", 2.0), sensors(1)]
    assert read(tmp_path, ulog([SENSORS], records)).parameters == {"C": 2.0}
