"""The DataFlash reader on logs written by hand: formats, eras, instances, motors, arming, and damage."""

import math
from pathlib import Path

import numpy as np
import pytest
from made_logs import DataFlashMessage, dataflash

from mavdiag.errors import InputError
from mavdiag.logs import kinds, read_log
from mavdiag.logs.dataflash import read_dataflash
from mavdiag.look.figures import rotor_line
from mavdiag.telemetry import Log, Signal
from mavdiag.testing import example_rows

IMU = DataFlashMessage(163, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
ATT = DataFlashMessage(70, "ATT", "Qccccff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw")
RATE_FIELDS = "RDes,R,ROut,PDes,P,POut,YDes,Y,YOut"
RATE = DataFlashMessage(73, "RATE", "Qfffffffff", f"TimeUS,{RATE_FIELDS}")
RCOU = DataFlashMessage(62, "RCOU", "QHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6")
ESC = DataFlashMessage(63, "ESC", "QBffffcfcf", "TimeUS,Instance,RPM,RawRPM,Volt,Curr,Temp,CTot,MotTemp,Err")
OLD_ESC = DataFlashMessage(64, "ESC2", "QeCCcH", "TimeUS,RPM,Volt,Curr,Temp,CTot")
RPMS = DataFlashMessage(65, "RPM", "Qff", "TimeUS,rpm1,rpm2")
ISBH = DataFlashMessage(67, "ISBH", "QHBBHHQf", "TimeUS,N,type,instance,mul,smp_cnt,SampleUS,smp_rate")
ISBD = DataFlashMessage(68, "ISBD", "QHHaaa", "TimeUS,N,seqno,x,y,z")
EDT2 = DataFlashMessage(66, "EDT2", "QBBBB", "TimeUS,Instance,Stress,MaxStress,Status")
PARM = DataFlashMessage(32, "PARM", "QNf", "TimeUS,Name,Value")
OLD_RATE = DataFlashMessage(29, "RATE", "Ifffffffff", f"TimeMS,{RATE_FIELDS}")


def imu(time_us: int, rate: float = 0.0, instance: int = 0) -> bytes:
    return IMU.record(time_us, instance, rate, 0, 0, 0, 0, -9.8)


def read(folder: Path, content: bytes) -> Log:
    path = folder / "00000007.BIN"
    path.write_bytes(content)
    return read_dataflash(path)


def first(log: Log, signal: Signal) -> list[float]:
    values: list[float] = log.telemetry.need(signal).values[0].tolist()
    return values


def test_format_characters_carry_their_multiplier_and_angles_become_radians(tmp_path: Path) -> None:
    log = read(tmp_path, dataflash([ATT], [ATT.record(5_000, 1000, 1100, -500, -400, 350.0, 10.0)]))
    assert first(log, Signal.ATTITUDE_SETPOINT) == pytest.approx([math.radians(a) for a in (10, -5, -10)])
    assert first(log, Signal.ATTITUDE) == pytest.approx([math.radians(a) for a in (11, -4, 10)])
    assert log.telemetry.need(Signal.ATTITUDE).t_ns.tolist() == [5_000_000]
    assert log.profile == "ardupilot-log"


def turning(message: DataFlashMessage, *values: float) -> list[bytes]:
    """Two records of RATE among those of an IMU that turns at 10 deg/s."""
    unit = 1 if message is OLD_RATE else 1_000
    turn = math.radians(10)
    return [imu(1_000, turn), message.record(2 * unit, *values), imu(3_000, turn), message.record(4 * unit, *values)]


@pytest.mark.parametrize("message", [OLD_RATE, RATE])
def test_rate_was_in_hundredths_up_to_copter_3_3(tmp_path: Path, message: DataFlashMessage) -> None:
    log = read(tmp_path, dataflash([IMU, message], turning(message, 2000, 1000, 450, 0, 0, 0, 0, 0, 0)))
    assert first(log, Signal.RATE_SETPOINT) == pytest.approx([math.radians(20), 0, 0])
    assert first(log, Signal.TORQUE_COMMAND) == pytest.approx([0.1, 0, 0])


def test_outputs_follow_the_motor_functions(tmp_path: Path) -> None:
    functions = {1: 0, 2: 34, 3: 33, 4: 10, 5: 35}
    parameters = [PARM.record(1, f"SERVO{n}_FUNCTION".encode(), value) for n, value in functions.items()]
    outputs = RCOU.record(2, 1100, 1200, 1300, 1400, 1500, 0)
    log = read(tmp_path, dataflash([PARM, RCOU], [*parameters, outputs]))
    assert first(log, Signal.ACTUATOR) == pytest.approx([0.3, 0.2, 0.5])


def told(time_us: int, instance: int, rpm: float) -> bytes:
    return ESC.record(time_us, instance, rpm + 100, rpm, 16, 4, 3000, 0, 3000, 0)


def test_speeds_of_escs_follow_the_motor_functions_and_grow_old(tmp_path: Path) -> None:
    functions = {1: 0, 2: 34, 3: 33, 5: 35}
    parameters = [PARM.record(1, f"SERVO{n}_FUNCTION".encode(), value) for n, value in functions.items()]
    records = [told(10, 1, 6000), told(20, 2, -3000), told(30, 4, 600), told(1_600_000, 1, 6600)]
    log = read(tmp_path, dataflash([PARM, ESC], [*parameters, *records]))
    expected = np.array([[np.nan, 200, np.nan], [100, 200, np.nan], [100, 200, 20], [np.nan, 220, np.nan]])
    np.testing.assert_allclose(log[Signal.ROTOR_SPEED].values, expected * math.pi, rtol=1e-6)
    assert log.motor_order


def test_older_and_other_messages_tell_speeds_where_it_is_known_of_which_rotor(tmp_path: Path) -> None:
    old = read(tmp_path, dataflash([OLD_ESC], [OLD_ESC.record(10, 600_000, 1600, 400, 3000, 0)]))
    np.testing.assert_allclose(old[Signal.ROTOR_SPEED].values, [[np.nan, 200 * math.pi]])
    masks = [PARM.record(1, b"RPM1_ESC_MASK", 4), PARM.record(1, b"RPM2_ESC_MASK", 3)]
    log = read(tmp_path, dataflash([PARM, RPMS], [*masks, RPMS.record(10, 6000, 600)]))
    np.testing.assert_allclose(log[Signal.ROTOR_SPEED].values, [[np.nan, np.nan, 200 * math.pi]])
    unknown = read(tmp_path, dataflash([IMU, RPMS], [imu(1), RPMS.record(10, 6000, 600)]))
    assert unknown.telemetry.get(Signal.ROTOR_SPEED) is None


def test_what_an_esc_complains_of_is_told(tmp_path: Path) -> None:
    log = read(tmp_path, dataflash([IMU, EDT2], [imu(1), EDT2.record(2, 2, 9, 9, 3), EDT2.record(3, 2, 9, 9, 8 | 16)]))
    assert log.notes == ("ESC 3 told a warning", "ESC 3 told an error")


def test_raw_batches_are_read_up_to_their_first_gap_and_show_the_line_of_the_rotors(tmp_path: Path) -> None:
    waves = np.rint(1000 * np.sin(math.tau * 167 * np.arange(1024) / 1000)).astype(int).reshape(32, 32)
    still, records = [0] * 32, [imu(1)]
    for batch, (kind, lost) in enumerate([(0, None), (1, None), (0, 20)]):  # the gyro has its turn
        records.append(ISBH.record(2_000_000 * batch, batch, kind, 0, 100, 1024, 2_000_000 * batch + 5, 1000.0))
        rows = [k for k in range(32) if k != lost]
        records += [ISBD.record(9, batch, k, *waves[k].tolist(), *still, *still) for k in rows]
    log = read(tmp_path, dataflash([IMU, ISBH, ISBD], records))
    assert [(one.t_ns, one.rate_hz, one.force.shape) for one in log.batches] == [
        (5_000, 1000.0, (1024, 3)),
        (4_000_005_000, 1000.0, (640, 3)),
    ]
    assert np.abs(log.batches[0].force[:, 0]).max() == pytest.approx(10.0, rel=0.01)
    flight = [example_rows(600).block]
    found = rotor_line(flight, 20.0, math.nan, log.batches)
    assert found.hz == pytest.approx(167, abs=2)
    assert "low-passed" in rotor_line(flight, 20.0, math.nan).reason


@pytest.mark.parametrize("content", [dataflash([IMU, ATT], []), b"\xa3\x95\x80\x80", b"\xa3\x95", b"text", b""])
def test_an_unusable_file_is_one_line_that_names_it(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(InputError, match=r"00000007\.BIN") as caught:
        read(tmp_path, content)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("lost", "notes"), [(0, 0), (1, 1), (20, 1)])
def test_r7_a_log_that_was_cut_off_says_so(tmp_path: Path, lost: int, notes: int) -> None:
    content = dataflash([IMU], [imu(1_000 * k) for k in range(1, 9)])
    log = read(tmp_path, content[: len(content) - lost])
    assert len(log.notes) == notes
    assert all("ends within a record" in note for note in log.notes)
    assert read(tmp_path, content + bytes(100)).notes == ()


def wrapped(n: int = 600) -> tuple[bytes, list[bytes]]:
    """A log's head and records."""
    return dataflash([IMU, ATT], []), [imu(1000 * k, 0.01 * k) for k in range(n)]


def test_a_logger_that_wrapped_is_read_from_where_its_types_are_declared(tmp_path: Path) -> None:
    """The newest pages come first: their records are of types that are declared behind them."""
    head, records = wrapped()
    path = tmp_path / "wrapped.bin"
    path.write_bytes(b"".join(records[400:])[11:] + head + b"".join(records[:400]))
    log = read_log(path)
    assert log.profile == "ardupilot-log"
    np.testing.assert_allclose(log["body_rate"].values[:, 0], [0.01 * k for k in range(400)], rtol=1e-6)
    lost = len(b"".join(records[400:])) - 11
    assert log.notes == (f"{lost} bytes of it are no records of a known type and were skipped",)


def test_a_telemetry_log_that_carries_such_records_stays_one() -> None:
    head, records = wrapped(40)
    kind = next(one for one in kinds() if one.name == "DataFlash")
    assert kind.recognise((head + b"".join(records))[:4096])
    assert kind.recognise(b"".join(records)[7:4096])
    assert not kind.recognise(bytes(8) + b"\xfd" + b"".join(records))
    assert not kind.recognise(b"\xa3\x95" + bytes(4000))


def test_modes_and_coordinates_are_those_of_every_era(tmp_path: Path) -> None:
    mode = DataFlashMessage(69, "MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn")
    place = DataFlashMessage(71, "POS", "QLLffff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt,X")
    records = [
        mode.record(1, 5, 5, 0),
        place.record(2, 473_977_418, -85_455_939, 500, 3, 3, 0),
        mode.record(3, 9, 9, 0),
    ]
    log = read(tmp_path, dataflash([mode, place], records))
    assert log[Signal.MODE].values.tolist() == [[5.0], [9.0]]
    np.testing.assert_allclose(np.degrees(log[Signal.COORDINATES].values), [[47.3977418, -8.5455939]])
    old = DataFlashMessage(69, "MODE", "IMh", "TimeMS,Mode,ThrCrs")
    assert read(tmp_path, dataflash([old], [old.record(7, 2, 500)]))[Signal.MODE].values.tolist() == [[2.0]]
