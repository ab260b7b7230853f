"""Flight logs: kinds, units and directions, damage, several vehicles, and what cannot be read is one line."""

import math
import tracemalloc
from collections.abc import Callable
from contextlib import closing
from hashlib import sha256
from pathlib import Path

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
import pytest
from made_archive import content as telemetry_log
from made_logs import (
    ATT,
    IMU,
    PARM,
    RATE,
    RCOU,
    SENSORS,
    SETPOINT,
    STAMP,
    ULOG_HEAD,
    CrazyflieEvent,
    DataFlashMessage,
    ULogTopic,
    crazyflie_content,
    dataflash,
    ulog,
    ulog_message,
    with_checksum,
)
from made_rows import example_rows
from made_vehicle import MadeVehicle
from pymavlink import mavutil
from shared_data import written

from mavdiag.errors import InputError
from mavdiag.link.clock import REBOOT_GAP_NS
from mavdiag.link.codec import UNKNOWN, Encoder
from mavdiag.link.messages import Autopilot, MavType, MessageId
from mavdiag.link.signing import Signing
from mavdiag.logs import airframe_name_for, gate_for, kinds, read_log, read_part
from mavdiag.logs.crazyflie import read_crazyflie
from mavdiag.logs.csv_columns import ColumnMap, load_column_map
from mavdiag.logs.dataflash import read_dataflash
from mavdiag.logs.log import LogKind
from mavdiag.logs.tlog import decode_tlog, read_tlog, tlog_record, vehicle_stream
from mavdiag.logs.ulog import _by_motor, read_ulog
from mavdiag.look.figures import rotor_line
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import Log, Series, Signal, Telemetry

START_US = 1_763_000_000_000_000
N = 300


def read_made(path: Path, vehicle: int | None, profile: str | None) -> Log:
    values = np.frombuffer(path.read_bytes()[4:], "<f8").reshape(-1, 3)
    t_ns = np.arange(len(values)) * 10_000_000
    return Log(path.name, "", "made-log", Telemetry((Series(Signal.BODY_RATE, t_ns, t_ns, values),)))


HIGH = GateSpec(min_height_m=1.0)
MADE = LogKind("made", lambda head: head.startswith(b"MADE"), read_made, ("made-log",), HIGH, airframe_name="made")


def test_a_kind_of_log_is_added_by_one_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (path := tmp_path / "flight.made").write_bytes(b"MADE" + np.arange(6.0).tobytes())
    with pytest.raises(InputError, match=r"DataFlash \.bin, ULog, Crazyflie, DronePropA, tlog"):
        read_log(path)
    monkeypatch.setattr("mavdiag.logs.kinds", lambda: (MADE, *kinds()))
    assert read_log(path)["body_rate"].values.tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    assert gate_for("made-log") is MADE.gate
    assert airframe_name_for("made-log") == "made"


def test_l4_take_off_is_trimmed_alike_live_and_in_logs() -> None:
    live, recorded = gate_for("ardupilot"), gate_for("ardupilot-log")
    assert live.trim_start_s == recorded.trim_start_s == gate_for("px4-log").trim_start_s == 5.0
    assert (live.trim_end_s, recorded.trim_end_s) == (0.0, 0.6)
    assert (live.min_thrust, live.need_armed) == (0.1, True)
    assert gate_for("qdrone2") == gate_for("px4") == live
    assert gate_for("crazyflie") == GateSpec(0.38, 0.38, False, 0.5, 0.6)
    assert [airframe_name_for(name) for name in ("crazyflie", "px4-log", "qdrone2")] == ["crazyflie", None, None]


CONTROLLER = ("roll", "pitch", "yaw", "r_roll", "r_pitch", "r_yaw", "cmd_yaw", "accelz", "actuatorThrust")
PID = CrazyflieEvent(65535, "fixedFrequency", tuple(f"controller.{name}(f)" for name in CONTROLLER))
ODD = CrazyflieEvent(1, "x", ("pm.vbat(s)",))
MARK = CrazyflieEvent(7, "activeMarkerModeChanged", ("mode(B)",))
TURNED = PID.record(1_000, 10.0, -20.0, 90.0, 0.1, 0.2, 0.3, 32767.0, 1.0, 65535.0)
RECORDS = (TURNED, PID.record(11_000, *np.zeros(9)))


def test_units_and_signs_are_si_and_frd(tmp_path: Path) -> None:
    log = read_crazyflie(written(tmp_path / "log00", with_checksum(crazyflie_content([PID, MARK], RECORDS))))
    first = {series.signal: series.values[0] for series in log.telemetry.series}
    assert first[Signal.ATTITUDE_SETPOINT] == pytest.approx([math.radians(10), math.radians(-20), -math.pi / 2])
    assert first[Signal.BODY_RATE] == pytest.approx([0.1, 0.2, -0.3])
    assert first[Signal.THRUST_SETPOINT] == pytest.approx([1.0])
    assert first[Signal.SPECIFIC_FORCE][2] == pytest.approx(-9.80665)
    assert np.isnan(first[Signal.SPECIFIC_FORCE][:2]).all()
    assert (log.profile, log.started_ns) == ("crazyflie", 0)


MAP = """
[time]
column = "time"
unit = "ms"
[body_rate]
columns = ["p", "-q", "r"]
unit = "deg/s"
[actuator]
columns = ["m1", "m2"]
unit = "percent"
"""


def mapped(folder: Path, text: str = MAP) -> ColumnMap:
    return load_column_map(written(folder / "map.toml", text))


def test_units_and_directions_become_si_and_frd(tmp_path: Path) -> None:
    rows = ["40,1000,90,180,-90,10\n", "50,1010,0,0,0,20\n"]
    path = written(tmp_path / "flight.csv", "m2,time,p,q,r,m1\n" + "".join(rows))
    log = read_log(path, columns=mapped(tmp_path))
    other = read_log(written(path, "m2,time,p,q,r,m1\n" + "".join(rows[::-1])), columns=mapped(tmp_path))
    assert (other.telemetry.digest, other.notes[0][:26]) == (log.telemetry.digest, "its rows are newest first ")
    np.testing.assert_allclose(log[Signal.BODY_RATE].values[0], [np.pi / 2, -np.pi, -np.pi / 2])
    assert log[Signal.BODY_RATE].t_ns.tolist() == [1_000_000_000, 1_010_000_000]
    np.testing.assert_allclose(log[Signal.ACTUATOR].values, [[0.1, 0.4], [0.2, 0.5]])
    assert (log.profile, log.notes) == ("csv", ())


def test_a_file_without_header_or_time_is_read_by_number_and_rate(tmp_path: Path) -> None:
    path = written(tmp_path / "flight.csv", "comment\n1;2;3\n4;5;6\n7;8;9\n")
    text = '[time]\nrate_hz = 200\n[body_rate]\ncolumns = ["1", "2", "3"]\nunit = "rad/s"\n'
    log = read_log(path, columns=mapped(tmp_path, text + '[file]\ndelimiter = ";"\nskip_lines = 1\nheader = false\n'))
    np.testing.assert_allclose(log[Signal.BODY_RATE].values, [[1, 2, 3], [4, 5, 6], [7, 8, 9]])
    assert np.diff(log[Signal.BODY_RATE].t_ns).tolist() == [5_000_000, 5_000_000]


def test_a_counter_of_32_bits_that_begins_anew_goes_on(tmp_path: Path) -> None:
    path = written(tmp_path / "flight.csv", "t,p\n4294967290,1\n2,1\n14,1\n")
    text = '[time]\ncolumn = "t"\nunit = "us"\n[body_rate]\ncolumns = ["p", "p", "p"]\nunit = "rad/s"\n'
    assert np.diff(read_log(path, columns=mapped(tmp_path, text))[Signal.BODY_RATE].t_ns).tolist() == [8_000, 12_000]


@pytest.mark.parametrize(("slow_ms", "notes"), [(12, 0), (20, 1)])
def test_a_rate_that_halves_within_a_log_is_told(tmp_path: Path, slow_ms: int, notes: int) -> None:
    times = np.cumsum([10] * 400 + [slow_ms] * 200)
    path = written(tmp_path / "flight.csv", "m2,time,p,q,r,m1\n" + "".join(f"0,{t},1,2,3,0\n" for t in times))
    found = read_part(path, columns=mapped(tmp_path)).notes
    assert ["at 50 Hz in one part of the log and at 100 Hz in another" in note for note in found] == [True] * notes


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[time]\nrate_hz = 1\n", "body_rate is missing"),
        ('[body_rate]\ncolumns = ["p", "q", "r"]\nunit = "rad/s"\n', "give the column of the time, or rate_hz"),
        (MAP.replace('"ms"', '"h"'), "time: unit: input should be 's', 'ms', 'us' or 'ns'"),
        (MAP.replace("deg/s", "deg"), "body_rate.unit: 'deg' is none of"),
        (MAP.replace("actuator", "position"), "position.unit: 'percent' is none of 'm'"),
        (MAP.replace('"-q", ', ""), "body_rate.columns: it has 3 columns, not 2"),
        (MAP + "[speed]\ncolumns = ['v']\n", "speed: no such table"),
        (MAP.replace("[actuator]", "[actuator]\nscale = 2"), "scale: extra inputs are not permitted"),
        (MAP.replace("rate]", "rate"), "not TOML"),
    ],
)
def test_a_wrong_map_names_its_field(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words) as caught:
        mapped(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path}/map.toml: ")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a,b\n1,2\n", "no column 'time'; there are a, b"),
        ("time,p,q,r,m1,m2\n", "it has no rows"),
        ("time,p,q,r,m1,m2\n1e306,y,z,,,\n", "no row has a time"),
        ("time,p,q,r,m1,m2\n1,,,,1,1\n2,,,,1,1\n", "most rows have no gyro"),
        ('time,p,q,r,m1,m2\n"1,5",0,0,0,1,1\n', "its numbers have a decimal comma; write them with a point"),
        ("time,p,q,r,m1,m2\n" + "".join(f"{n}0000,0,0,0,1,1\n" for n in range(20)), "are 10 s apart; check the unit"),
        ("\x00\xff\n" * 10, "is no CSV text in UTF-8; .* leave out --columns"),
    ],
)
def test_a_file_that_the_map_does_not_fit_is_one_line(content: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words) as caught:
        read_log(written(tmp_path / "flight.csv", content), columns=mapped(tmp_path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "time,p,q,r,m1,m2\n" + "1" * 200_000 + ",0,0,0,0,0\n",
        "time,p,q,r,m1,m2\n0,0,0,0,0,0\n" + 'x"' * 70_000,
        'time,p,q,r,m1,m2\n0,0,"' + "1\n" * 140_000,
        "0," * 5_000_000,
    ],
)
def test_what_is_no_sound_csv_file_is_one_line(tmp_path: Path, text: str) -> None:
    path = written(tmp_path / "flight.csv", text)
    tracemalloc.start()
    with pytest.raises(InputError) as caught:
        read_log(path, columns=mapped(tmp_path))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 4 * len(text) + 20_000_000
    assert "\n" not in str(caught.value)


GYRO, FORCE = SENSORS.fields[1:]
DELAYED = ULogTopic(1, "sensor_combined", (STAMP, GYRO, ("int32_t", "accelerometer_timestamp_relative"), FORCE))
OLD_FIELDS = [("float", name) for name in ("roll_body", "pitch_body", "yaw_body", "thrust")]
OLD_SETPOINT = ULogTopic(2, "vehicle_attitude_setpoint", (STAMP, *OLD_FIELDS))
BOTH = ULogTopic(2, "vehicle_attitude_setpoint", (STAMP, *OLD_FIELDS[:3], ("float[4]", "q_d")))
MOTORS = ULogTopic(4, "actuator_motors", (STAMP, ("float[12]", "control")))
OUTPUTS = ULogTopic(5, "actuator_outputs", (STAMP, ("float[16]", "output")))
STATUS = ULogTopic(7, "vehicle_status", (STAMP, ("uint8_t", "arming_state"), ("uint8_t", "nav_state")))
POSITION = ULogTopic(8, "vehicle_local_position", (STAMP, ("float", "x"), ("float", "y"), ("float", "z")))
HALF, NAN = math.sqrt(0.5), math.nan


def read(folder: Path, content: bytes) -> Log:
    return read_log(written(folder / "log_4", content))


def sensors(time_us: int, rate: float = 0.0, delay_us: int = 0) -> bytes:
    return DELAYED.record(time_us, rate, 0, 0, delay_us, 0, 0, -9.81)


@pytest.mark.parametrize(
    ("topic", "records", "signal", "values"),
    [
        (SETPOINT, [(2_000, HALF, HALF, 0, 0, 0, 0, -0.6)], Signal.ATTITUDE_SETPOINT, [[math.pi / 2, 0, 0]]),
        (SETPOINT, [(2_000, HALF, HALF, 0, 0, 0, 0, -0.6)], Signal.THRUST_SETPOINT, [[0.6]]),
        (OLD_SETPOINT, [(2_000, 0.1, -0.2, 0.3, 0.5)], Signal.ATTITUDE_SETPOINT, [[0.1, -0.2, 0.3]]),
        (OLD_SETPOINT, [(2_000, 0.1, -0.2, 0.3, 0.5)], Signal.THRUST_SETPOINT, [[0.5]]),
        (BOTH, [(2_000, 0.1, -0.2, 0.3, HALF, HALF, 0, 0)], Signal.ATTITUDE_SETPOINT, [[math.pi / 2, 0, 0]]),
        (MOTORS, [(1, 0.1, 0.2, 0.3, 0.4, *[NAN] * 8)], Signal.ACTUATOR, [[0.1, 0.2, 0.3, 0.4]]),
        (OUTPUTS, [(1, 900, 1500, 2000, *[0] * 13)], Signal.ACTUATOR, [[0.0, 0.5, 1.0]]),
        (OUTPUTS, [(1, 199.9, 0, *[0] * 14), (2, 1999, 999.5, *[0] * 14)], Signal.ACTUATOR, [[0.1, 0], [1, 0.5]]),
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


def test_a_sample_that_its_driver_does_not_date_has_the_time_of_its_message(tmp_path: Path) -> None:
    topic = ULogTopic(3, "vehicle_angular_velocity", (STAMP, ("uint64_t", "timestamp_sample"), ("float[3]", "xyz")))
    log = read(tmp_path, ulog([topic], [topic.record(2_000, 1_500, 0, 0, 0), topic.record(3_000, 0, 0, 0, 0)]))
    assert log["body_rate"].t_ns.tolist() == [1_500_000, 3_000_000]


def test_l6_outputs_that_never_move_are_no_motors(tmp_path: Path) -> None:
    still = (1500.0,) * 2
    rows = [OUTPUTS.record(1_000 * k, 1100.0 + k, 1200.0, 1300.0 + k, *still, *(0.0,) * 11) for k in range(1, 9)]
    assert read(tmp_path, ulog([DELAYED, OUTPUTS], [sensors(1_000), *rows]))["actuator"].values.shape == (8, 3)


def test_speeds_of_escs_go_to_the_motors_that_they_drive() -> None:
    """PX4 since 1.13 says of each ESC which motor it drives: 101 is the first."""
    speeds, functions = [6000, -3000, 600, *[0] * 5], [102, 101, 104, *[0] * 5]
    found = _by_motor(np.array([[*speeds, *functions]], dtype=np.float64))
    np.testing.assert_allclose(found, [[100 * math.pi, 200 * math.pi, NAN, 20 * math.pi]])
    assert _by_motor(np.zeros((1, 16))).size == 0  # they say nothing: the ESCs' own order counts


ESC = DataFlashMessage(63, "ESC", "QBffffcfcf", "TimeUS,Instance,RPM,RawRPM,Volt,Curr,Temp,CTot,MotTemp,Err")
OLD_ESC = DataFlashMessage(64, "ESC2", "QeCCcH", "TimeUS,RPM,Volt,Curr,Temp,CTot")
RPMS = DataFlashMessage(65, "RPM", "Qff", "TimeUS,rpm1,rpm2")
ISBH = DataFlashMessage(67, "ISBH", "QHBBHHQf", "TimeUS,N,type,instance,mul,smp_cnt,SampleUS,smp_rate")
ISBD = DataFlashMessage(68, "ISBD", "QHHaaa", "TimeUS,N,seqno,x,y,z")
EDT2 = DataFlashMessage(66, "EDT2", "QBBBB", "TimeUS,Instance,Stress,MaxStress,Status")
OLD_RATE = DataFlashMessage(29, "RATE", "Ifffffffff", RATE.labels.replace("TimeUS", "TimeMS"))


def imu(time_us: int, rate: float = 0.0, instance: int = 0) -> bytes:
    return IMU.record(time_us, instance, rate, 0, 0, 0, 0, -9.8)


def read_bin(folder: Path, content: bytes) -> Log:
    return read_dataflash(written(folder / "00000007.BIN", content))


def first(log: Log, signal: Signal) -> list[float]:
    values: list[float] = log.telemetry.need(signal).values[0].tolist()
    return values


def test_format_characters_carry_their_multiplier_and_angles_become_radians(tmp_path: Path) -> None:
    log = read_bin(tmp_path, dataflash([ATT], [ATT.record(5_000, 1000, 1100, -500, -400, 350.0, 10.0)]))
    assert first(log, Signal.ATTITUDE_SETPOINT) == pytest.approx([math.radians(a) for a in (10, -5, -10)])
    assert first(log, Signal.ATTITUDE) == pytest.approx([math.radians(a) for a in (11, -4, 10)])
    assert (log.telemetry.need(Signal.ATTITUDE).t_ns.tolist(), log.profile) == ([5_000_000], "ardupilot-log")


@pytest.mark.parametrize(("boot_us", "week"), [(3_000, 2300), (1 << 63, 2300), (3_000, 65535)])
def test_a_fix_tells_when_the_first_sample_came_unless_it_is_damaged(tmp_path: Path, boot_us: int, week: int) -> None:
    gps = DataFlashMessage(12, "GPS", "QBIH", "TimeUS,Status,GMS,GWk")
    (path := tmp_path / "a.bin").write_bytes(
        dataflash([IMU, gps], [gps.record(boot_us, 3, 0, week), *map(imu, (1, 2001))])
    )
    fix_ns = (315_964_800 + 2300 * 604_800 - 18) * 10**9 if (boot_us, week) == (3_000, 2300) else 0
    found = [read_part(path, from_s=at_s).started_ns for at_s in (None, 0.002)]
    assert found == ([fix_ns - 2_999_000, fix_ns - 999_000] if fix_ns else [0, 0])


def test_what_arms_was_disarmed_before(tmp_path: Path) -> None:
    arm = DataFlashMessage(11, "ARM", "QB", "TimeUS,ArmState")
    log = read_bin(tmp_path, dataflash([IMU, arm], [imu(1_000), arm.record(2_000, 1), arm.record(3_000, 0)]))
    assert log[Signal.ARMED].values[:, 0].tolist() == [0, 1, 0]


def test_where_there_is_ang_it_tells_the_attitude_and_its_set_point(tmp_path: Path) -> None:
    ang = DataFlashMessage(71, "ANG", "Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw")
    records = [ang.record(1_000 * k, 1.0, 2.0, 3.0, 4.0, 350.0, 6.0) for k in (1, 2)]
    log = read_bin(tmp_path, dataflash([ATT, ang], [ATT.record(1_000, 0, 0, 0, 0, 0.0, 0.0), *records]))
    for signal, degrees in ((Signal.ATTITUDE_SETPOINT, (1, 3, -10)), (Signal.ATTITUDE, (2, 4, 6))):
        assert log[signal].values.tolist() == [pytest.approx([math.radians(one) for one in degrees])] * 2


@pytest.mark.parametrize("damaged", [[1], [2], [10], [1, 2], [10, 11], [10, 12]])
def test_damaged_stamps_cost_their_samples_alone(tmp_path: Path, damaged: list[int]) -> None:
    stamps = [1000 * n + (n in damaged) * (1 << 28) for n in range(1, 21)]
    log = read_bin(tmp_path, dataflash([IMU], [imu(time_us) for time_us in stamps]))
    assert log[Signal.BODY_RATE].t_ns.tolist() == [1_000_000 * n for n in range(1, 21) if n not in damaged]


@pytest.mark.parametrize("message", [OLD_RATE, RATE])
def test_rate_was_in_hundredths_up_to_copter_3_3(tmp_path: Path, message: DataFlashMessage) -> None:
    unit, values, turn = 1 if message is OLD_RATE else 1_000, (2000, 1000, 450, *[0] * 6), math.radians(10)
    told = [(imu(k * 1_000, turn), message.record((k + 1) * unit, *values)) for k in (1, 3)]
    log = read_bin(tmp_path, dataflash([IMU, message], [record for pair in told for record in pair]))
    assert first(log, Signal.RATE_SETPOINT) == pytest.approx([math.radians(20), 0, 0])
    assert first(log, Signal.TORQUE_COMMAND) == pytest.approx([0.1, 0, 0])


def told(time_us: int, instance: int, rpm: float) -> bytes:
    return ESC.record(time_us, instance, rpm + 100, rpm, 16, 4, 3000, 0, 3000, 0)


def test_outputs_and_speeds_of_escs_follow_the_motor_functions_and_speeds_grow_old(tmp_path: Path) -> None:
    functions = {1: 0, 2: 34, 3: 33, 4: 10, 5: 35}
    parameters = [PARM.record(1, f"SERVO{n}_FUNCTION".encode(), value) for n, value in functions.items()]
    records = [told(10, 1, 6000), told(20, 2, -3000), told(30, 4, 600), told(1_600_000, 1, 6600)]
    outputs = RCOU.record(2, 1100, 1200, 1300, 1400, 1500, 0)
    log = read_bin(tmp_path, dataflash([PARM, RCOU, ESC], [*parameters, outputs, *records]))
    assert first(log, Signal.ACTUATOR) == pytest.approx([0.3, 0.2, 0.5])
    expected = np.array([[np.nan, 200, np.nan], [100, 200, np.nan], [100, 200, 20], [np.nan, 220, np.nan]])
    np.testing.assert_allclose(log[Signal.ROTOR_SPEED].values, expected * math.pi, rtol=1e-6)
    assert log.motor_order


def test_older_and_other_messages_tell_speeds_of_known_rotors_and_what_an_esc_complains_of(tmp_path: Path) -> None:
    old = read_bin(tmp_path, dataflash([OLD_ESC], [OLD_ESC.record(10, 600_000, 1600, 400, 3000, 0)]))
    np.testing.assert_allclose(old[Signal.ROTOR_SPEED].values, [[np.nan, 200 * math.pi]])
    masks = [PARM.record(1, b"RPM1_ESC_MASK", 4), PARM.record(1, b"RPM2_ESC_MASK", 3)]
    log = read_bin(tmp_path, dataflash([PARM, RPMS], [*masks, RPMS.record(10, 6000, 600)]))
    np.testing.assert_allclose(log[Signal.ROTOR_SPEED].values, [[np.nan, np.nan, 200 * math.pi]])
    unknown = read_bin(tmp_path, dataflash([IMU, RPMS], [imu(1), RPMS.record(10, 6000, 600)]))
    assert unknown.telemetry.get(Signal.ROTOR_SPEED) is None
    told = [imu(1), EDT2.record(2, 2, 9, 9, 3), EDT2.record(3, 2, 9, 9, 8 | 16)]
    assert read_bin(tmp_path, dataflash([IMU, EDT2], told)).notes == ("ESC 3 told a warning", "ESC 3 told an error")


def test_raw_batches_are_read_up_to_their_first_gap_and_show_the_line_of_the_rotors(tmp_path: Path) -> None:
    waves = np.rint(1000 * np.sin(math.tau * 167 * np.arange(1024) / 1000)).astype(int).reshape(32, 32)
    still, records = [0] * 32, [imu(1)]
    for batch, (kind, lost) in enumerate([(0, None), (1, None), (0, 20)]):  # the gyro has its turn
        records.append(ISBH.record(2_000_000 * batch, batch, kind, 0, 100, 1024, 2_000_000 * batch + 5, 1000.0))
        rows = [k for k in range(32) if k != lost]
        records += [ISBD.record(9, batch, k, *waves[k].tolist(), *still, *still) for k in rows]
    log = read_bin(tmp_path, dataflash([IMU, ISBH, ISBD], records))
    batches = [(one.t_ns, one.rate_hz, one.force.shape) for one in log.batches]
    assert batches == [(5_000, 1000.0, (1024, 3)), (4_000_005_000, 1000.0, (640, 3))]
    assert np.abs(log.batches[0].force[:, 0]).max() == pytest.approx(10.0, rel=0.01)
    flight = [example_rows(600).block]
    assert rotor_line(flight, 20.0, math.nan, log.batches).hz == pytest.approx(167, abs=2)
    assert "low-passed" in rotor_line(flight, 20.0, math.nan).reason


def wrapped(n: int = 600) -> tuple[bytes, list[bytes]]:
    return dataflash([IMU, ATT], []), [imu(1000 * k, 0.01 * k) for k in range(n)]


def test_a_logger_that_wrapped_is_read_from_where_its_types_are_declared(tmp_path: Path) -> None:
    """The newest pages come first: their records are of types that are declared behind them."""
    head, records = wrapped()
    (path := tmp_path / "wrapped.bin").write_bytes(b"".join(records[400:])[11:] + head + b"".join(records[:400]))
    log = read_log(path)
    assert log.profile == "ardupilot-log"
    np.testing.assert_allclose(log["body_rate"].values[:, 0], [0.01 * k for k in range(400)], rtol=1e-6)
    lost = len(b"".join(records[400:])) - 11
    assert log.notes == (f"{lost} bytes of it are no records of a known type and were skipped",)


def test_a_telemetry_log_that_carries_such_records_stays_one() -> None:
    head, records = wrapped(40)
    kind = next(one for one in kinds() if one.name == "DataFlash .bin")
    assert kind.recognise((head + b"".join(records))[:4096])
    assert kind.recognise(b"".join(records)[7:4096])
    assert not kind.recognise(bytes(8) + b"\xfd" + b"".join(records))
    assert not kind.recognise(b"\xa3\x95" + bytes(4000))


def test_modes_and_coordinates_are_those_of_every_era(tmp_path: Path) -> None:
    mode = DataFlashMessage(69, "MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn")
    place = DataFlashMessage(71, "POS", "QLLffff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt,X")
    told = [mode.record(1, 5, 5, 0), place.record(2, 473_977_418, -85_455_939, 500, 3, 3, 0), mode.record(3, 9, 9, 0)]
    log = read_bin(tmp_path, dataflash([mode, place], told))
    assert log[Signal.MODE].values.tolist() == [[5.0], [9.0]]
    np.testing.assert_allclose(np.degrees(log[Signal.COORDINATES].values), [[47.3977418, -8.5455939]])
    old = DataFlashMessage(69, "MODE", "IMh", "TimeMS,Mode,ThrCrs")
    assert read_bin(tmp_path, dataflash([old], [old.record(7, 2, 500)]))[Signal.MODE].values.tolist() == [[2.0]]


@pytest.mark.parametrize(
    ("reader", "content", "words"),
    [(read_crazyflie, with_checksum(crazyflie_content([PID], RECORDS))[:-1], "checksum"),
        (read_crazyflie, with_checksum(crazyflie_content([PID], RECORDS)[:-5]), "cut short"),
        (read_crazyflie, with_checksum(crazyflie_content([PID], RECORDS, version=3)), "version 3"),
        (read_crazyflie, with_checksum(crazyflie_content([PID], [])), "no records"),
        (read_crazyflie, with_checksum(crazyflie_content([PID], [])[:40]), "header ends early"),
        (read_crazyflie, with_checksum(crazyflie_content([MARK], [MARK.record(1, 2)])), "no signal"),
        (read_crazyflie, with_checksum(crazyflie_content([PID], [MARK.record(1, 2)])), "no declared type"),
        (read_crazyflie, with_checksum(crazyflie_content([ODD], [b"\1\0"])), "known type"),
        (read_crazyflie, with_checksum(crazyflie_content([PID], [PID.record(2**60, *range(9))])), "time stamp"),
        (read_crazyflie, b"\xbc", "first bytes"),
        (read_ulog, ulog([DELAYED], [])[:16] + ulog_message("\0", b"x" * 40)[:-8], "beyond use"),  # pyulog would hang
        (read_ulog, ulog([], [ulog_message("F", b"sensor_combined:sensor_combined[2] inner;")]), "within itself"),
        (read_ulog, ulog([], [ulog_message("F", x) for x in (b"a:uint8_t[60000] x;", b"b:a[60000] x;")]), "too many"),
        (read_ulog, ulog([DELAYED], []), "no record"),
        (read_ulog, ULOG_HEAD, "damaged"),
        (read_ulog, ulog([], [ulog_message("B", bytes(8) + b"\xff" * 8 + bytes(24))]), "incompatible"),
        (read_dataflash, dataflash([IMU, ATT], []), "logging was on"),
        (read_dataflash, b"".join(wrapped(40)[1]), "its start, .* is missing")],
)  # fmt: skip
def test_unusable_files_are_one_line(tmp_path: Path, reader: Callable[[Path], Log], content: bytes, words: str) -> None:
    (path := tmp_path / "a log").write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        reader(path)
    assert "a log" in str(caught.value)
    assert "\n" not in str(caught.value)


NINE = (
    ulog([DELAYED], [sensors(1_000 * k) for k in range(1, 9)]),
    dataflash([IMU], [imu(1_000 * k) for k in range(1, 9)]),
)


@pytest.mark.parametrize(("lost", "notes"), [(0, 0), (1, 1), (20, 1)])
@pytest.mark.parametrize("content", [*NINE, telemetry_log(1, 300)], ids=["ulog", "dataflash", "tlog"])
def test_r7_a_log_that_was_cut_off_says_so(tmp_path: Path, content: bytes, lost: int, notes: int) -> None:
    log = read(tmp_path, content[: len(content) - lost])
    assert len(log.notes) == notes
    assert all("ends within a " in note for note in log.notes)


def heartbeat(encoder: Encoder, kind: MavType = MavType.QUADROTOR, autopilot: int = 3) -> bytes:
    return encoder.encode(MessageId.HEARTBEAT, kind, autopilot, 128, 0, 4, 3)


def records(sysid: int = 1, n: int = N, scale: int = 1000, late_us: int = 0) -> list[bytes]:
    """n setpoints and IMU samples at 100 Hz, a heartbeat a second, and messages that nobody asks for."""
    encoder, found = Encoder(sysid, 1), []
    for k in range(n):
        time_us = START_US + 10_000 * k + late_us
        q, t_ms = (1.0, 0.001 * k, 0.0, 0.0), 5_000 + 10 * k
        frames = [encoder.encode(MessageId.ATTITUDE_TARGET, t_ms, 0, q, 0, 0, 0, 0.5)]
        frames.append(encoder.encode(MessageId.RAW_IMU, 1_000 * t_ms, k, 0, -scale, -k, 2, 3))
        frames.append(encoder.encode(MessageId.SYSTEM_TIME, time_us, t_ms))
        frames += [heartbeat(encoder)] if k % 100 == 0 else []
        found += [tlog_record(time_us, frame) for frame in frames]
    return found


def test_a_whole_log_is_read(tmp_path: Path) -> None:
    before = tlog_record(START_US - 9_000_000, heartbeat(Encoder(1, 191), MavType.ONBOARD_CONTROLLER, 8))
    data = before + b"".join(records())
    log = read_log(written(tmp_path / "flight.tlog", data))
    assert (log.name, log.sha256, log.profile) == ("flight.tlog", sha256(data).hexdigest(), "ardupilot")
    assert (log.started_ns, log.epoch_ns) == (START_US * 1000, START_US * 1000 - 5_000_000_000)
    unset = b"".join(k.to_bytes(8, "big") + record[8:] for k, record in enumerate(records()))
    assert read_log(written(tmp_path / "unset.tlog", unset)).started_ns == 0
    set_late = unset[: len(unset) // 3] + data[len(before) + len(unset) // 3 :]
    assert read_log(written(tmp_path / "set.tlog", set_late)).epoch_ns == log.epoch_ns
    t_ns = read_log(written(tmp_path / "2.tlog", data + b"".join(records(n=900, late_us=-(10**11)))))["body_rate"].t_ns
    assert N + 890 < len(t_ns) <= N + 900
    assert (np.diff(t_ns) > REBOOT_GAP_NS - 1).sum() == 1
    rate = log.telemetry.need(Signal.BODY_RATE)
    assert rate.t_ns.tolist() == [5_000_000_000 + 10_000_000 * k for k in range(N)]
    assert rate.host_ns.tolist() == [1000 * START_US + 10_000_000 * k for k in range(N)]
    np.testing.assert_allclose(rate.values[-1], [-0.001 * (N - 1), 0.002, 0.003])
    assert len(log.telemetry.need(Signal.ATTITUDE_SETPOINT)) == N
    content = decode_tlog([data])
    assert (content.records, content.damaged_bytes, content.senders[1, 1].lost) == (3 * N + 4, 0, 0)


@pytest.mark.parametrize("seed", range(5))
def test_damage_costs_only_the_records_it_hits(tmp_path: Path, seed: int) -> None:
    rng, pieces = np.random.default_rng(seed), records()
    for k in rng.choice(len(pieces), 20, replace=False):
        harm = bytearray(pieces[k])
        harm[8 + int(rng.integers(len(harm) - 8))] ^= 1 << int(rng.integers(8))
        pieces[k] = bytes(harm)
    data = b"".join(pieces[:100]) + rng.bytes(500) + b"".join(pieces[100:]) + pieces[0][:20]
    content = decode_tlog([data])
    known = {msgid: n for msgid, n in content.senders[1, 1].by_message.items() if msgid != UNKNOWN}
    assert sum(known.values()) == len(pieces) - 20  # a frame whose id was hit counts as one of another dialect
    assert content.records - len(pieces) + 20 <= 6
    assert 520 <= content.damaged_bytes <= 520 + 20 * max(map(len, pieces))
    assert len(read_tlog(written(tmp_path / "flight.tlog", data)).telemetry.need(Signal.BODY_RATE)) >= N - 20


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "empty"),
        (b"time,roll,pitch\n1,2,3\n" * 40, "not a flight log"),
        (bytes(8) + b"\xfd" * 500, "no MAVLink frame"),
        (b"".join(records(n=3)) + bytes(9000), "% of the file is damaged"),
        (b"".join(record[8:] for record in records(n=99)), "no time stamps .*take its .tlog"),
        (tlog_record(START_US, Encoder(1, 1).encode(MessageId.ATTITUDE, 1)), "no autopilot's heartbeat"),
        (tlog_record(START_US, heartbeat(Encoder(255, 1), MavType.GCS, 8)), "no autopilot's heartbeat"),
        (b"".join(records(1, 9) + records(7, 9)), "vehicles 1, 7; choose one.*vehicle_stream"),
        (b"".join(records(scale=16_384)), r"vehicle 1: its link profile is not clear.*look --profile"),  # B18
    ],
)
def test_what_cannot_be_read_says_why(tmp_path: Path, data: bytes, words: str) -> None:
    path = written(tmp_path / "flight.tlog", data)
    with pytest.raises(InputError, match=words) as caught:
        read_log(path)
    assert "\n" not in str(caught.value)
    if "--profile" in words:
        assert read_log(path, profile="ardupilot").profile == "ardupilot"


@pytest.mark.parametrize(("ahead", "notes"), [(0, ["clash"]), (30, ["leap"]), (700, ["clash", "leap"])])
def test_two_vehicles_of_one_id_are_told(ahead: int, notes: list[str], tmp_path: Path) -> None:
    ours, theirs = (MadeVehicle(1, Autopilot.ARDUPILOTMEGA) for _ in range(2))
    theirs.samples(ahead or 1)
    theirs.sent = ahead
    both = [frame for _ in range(400) for frame in (*ours.samples(1), *theirs.samples(1))]
    data = b"".join(tlog_record(START_US + 2000 * k, frame) for k, frame in enumerate(both))
    found = read_tlog(written(tmp_path / "two.tlog", data))
    assert found.profile == "ardupilot"
    assert [word for note in found.notes for word in ("clash", "leap") if word in note] == notes


def test_each_vehicle_of_several_is_read_in_one_pass(tmp_path: Path) -> None:
    ours, theirs = records(1, 250), records(7, 160)
    companion = tlog_record(START_US, heartbeat(Encoder(9, 191), MavType.ONBOARD_CONTROLLER, 8))
    mixed = [one for pair in zip(ours, theirs, strict=False) for one in pair]
    path = written(tmp_path / "flight.tlog", b"".join((companion, *mixed, *ours[len(theirs) :])))
    found = list(vehicle_stream(path))
    assert [one.vehicle for one in found] == [1, 7]
    assert [one.name for one in found] == ["flight.tlog vehicle 1", "flight.tlog vehicle 7"]
    for log in found:
        alone = read_tlog(path, vehicle=log.vehicle)
        assert (log.sha256, log.profile, log.started_ns) == (alone.sha256, alone.profile, alone.started_ns)
        for series in alone.telemetry:
            assert np.array_equal(log[series.signal].values, series.values)
            assert np.array_equal(log[series.signal].t_ns, series.t_ns)
    assert len(found[1][Signal.BODY_RATE]) == 160
    (alone_in_file,) = vehicle_stream(str(written(tmp_path / "flight.tlog", b"".join(ours))))
    assert alone_in_file.name == "flight.tlog"
    with pytest.raises(InputError, match="no autopilot's heartbeat"):
        list(vehicle_stream(written(tmp_path / "flight.tlog", companion)))


def flight(rng: np.random.Generator) -> list[bytes]:
    """Two vehicles: MAVLink 1 and 2, signed stretches, records lost, swapped, broken, and of another dialect."""
    plain, other, sealing = Encoder(1, 1), Encoder(7, 1), Encoder(1, 1, Signing(bytes(32), stamp=START_US // 10))
    old, found = dialect.MAVLink(None, srcSystem=1, srcComponent=1), list[bytes]()
    for k in range(400):
        time_us, boot_us = START_US + 10_000 * k + int(rng.integers(4000)), 5_000_000 + 10_000 * k
        encoder, counts = sealing if 50 < k < 120 else plain, rng.integers(-900, 900, 9).tolist()
        frames = [
            encoder.encode(MessageId.ATTITUDE_TARGET, boot_us // 1000, 0, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, k / 400),
            encoder.encode(MessageId.RAW_IMU, boot_us, *counts[:6]),
            other.encode(MessageId.RAW_IMU, boot_us, *counts),
            dialect.mavlink_map[MessageId.RAW_IMU](boot_us + 5000, *counts).pack(old, force_mavlink1=True),
        ]
        if k % 50 == 0:
            stranger = bytearray(encoder.encode(MessageId.STATUSTEXT, 6, b"text"))
            stranger[7:10] = b"\xff\xff\x7f"
            frames += [heartbeat(encoder), heartbeat(other), bytes(stranger)]
        found += [tlog_record(time_us, bytes(frame)) for frame in frames if rng.random() > 0.02]
    for k in rng.integers(0, len(found) - 1, 20).tolist():
        found[k], found[k + 1] = found[k + 1], found[k]
    for k in rng.integers(0, len(found), 20).tolist():
        found[k] = found[k][:-1] + bytes([found[k][-1] ^ 1])
    return found


@pytest.mark.parametrize(("seed", "window"), [(0, 997), (1, 4096), (2, 20_011), (3, 1 << 21)])
def test_windows_read_as_pymavlink(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int, window: int) -> None:
    path = written(tmp_path / "flight.tlog", b"".join(flight(np.random.default_rng(seed))))
    times, imu, thrust = list[int](), list[list[float]](), list[float]()
    with closing(mavutil.mavlink_connection(str(path), dialect="ardupilotmega")) as theirs:
        while message := theirs.recv_match(type=["RAW_IMU", "ATTITUDE_TARGET"]):
            told = {name: float(value) for name, value in message.to_dict().items() if isinstance(value, int | float)}
            if message.get_srcSystem() == 1 and message.get_type() == "RAW_IMU":
                times.append(round(1e6 * message._timestamp) * 1000)
                imu.append([1000 * told["time_usec"], *(1e-3 * told[f"{axis}gyro"] for axis in "xyz")])
            elif message.get_srcSystem() == 1:
                thrust.append(told["thrust"])
    monkeypatch.setattr("mavdiag.logs.tlog.PIECE_BYTES", window)
    log = read_tlog(path, vehicle=1)
    rate = log.telemetry.need(Signal.BODY_RATE)
    assert len(times) > 700
    assert rate.host_ns.tolist() == times
    np.testing.assert_allclose(np.column_stack([rate.t_ns, rate.values]), imu)
    assert log.telemetry.need(Signal.THRUST_SETPOINT).values[:, 0].tolist() == thrust
