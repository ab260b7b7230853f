"""Whatever happens to a log of any kind, its reader returns what is left or raises InputError, and comes back."""

import io
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_dronepropa import content as mat_content
from made_dronepropa import flight
from made_logs import (
    CrazyflieEvent,
    DataFlashMessage,
    ULogTopic,
    crazyflie_content,
    dataflash,
    ulog,
    ulog_message,
    with_checksum,
)
from pyulog import ULog
from shared_data import shared

from mavdiag.errors import InputError
from mavdiag.logs.crazyflie import read_crazyflie
from mavdiag.logs.dataflash import read_dataflash
from mavdiag.logs.dronepropa import read_dronepropa
from mavdiag.logs.ulog import TOPICS, _content, read_ulog
from mavdiag.telemetry import Log, Signal

PID = CrazyflieEvent(9, "fixedFrequency", tuple(f"controller.{name}(f)" for name in ("r_roll", "r_pitch", "r_yaw")))
MARK = CrazyflieEvent(7, "mark", ("mode(B)",))
CRAZYFLIE = crazyflie_content(
    [PID, MARK],
    [PID.record(1_000 * k, k, -k, 0.5) + (MARK.record(1_000 * k + 1, k) if k % 3 else b"") for k in range(8)],
)

IMU = DataFlashMessage(163, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
ATT = DataFlashMessage(70, "ATT", "Qccccff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw")
RATE = DataFlashMessage(73, "RATE", "Qfffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut")
RCOU = DataFlashMessage(62, "RCOU", "QHHHH", "TimeUS,C1,C2,C3,C4")
PARM = DataFlashMessage(32, "PARM", "QNf", "TimeUS,Name,Value")
EV = DataFlashMessage(13, "EV", "B", "Id")
GPS = DataFlashMessage(90, "GPS", "QBIH", "TimeUS,Status,GMS,GWk")
COUNT = 12
FUNCTION = PARM.record(1, b"SERVO1_FUNCTION", 33)
DATAFLASH = dataflash(
    (IMU, ATT, RATE, RCOU, PARM, EV, GPS),
    [
        FUNCTION,
        *(
            IMU.record(10_000 * k + 1, 0, 0.1 * k, 0, 0, 0, 0, -9.8)
            + ATT.record(10_000 * k + 1, 100 * k, 90 * k, 0, 0, 0, 0)
            + RATE.record(10_000 * k + 1, k, k, 0, 0, 0, 0, 0, 0, 0)
            + RCOU.record(10_000 * k + 1, 1500, 1500, 1500, 1500 + k)
            + EV.record(10 + k % 2)
            + GPS.record(10_000 * k + 1, 3, 1_000 * k, 2086)
            for k in range(COUNT)
        ),
    ],
)

STAMP = ("uint64_t", "timestamp")
SENSORS = ULogTopic(1, "sensor_combined", (STAMP, ("float[3]", "gyro_rad"), ("float[3]", "accelerometer_m_s2")))
SETPOINT = ULogTopic(2, "vehicle_attitude_setpoint", (STAMP, ("float[4]", "q_d"), ("float[3]", "thrust_body")))
STATUS = ULogTopic(3, "vehicle_status", (STAMP, ("uint8_t", "arming_state")))
UTC = ULogTopic(4, "vehicle_gps_position", (STAMP, ("uint64_t", "time_utc_usec")))
CYCLES = [
    SENSORS.record(4_000 * k + 1, 0.1 * k, 0, 0, 0, 0, -9.8)
    + SETPOINT.record(4_000 * k + 1, 1, 0, 0, 0, 0, 0, -0.5)
    + STATUS.record(4_000 * k + 1, 2)
    + UTC.record(4_000 * k + 1, 1_577_880_000_004_000 * k + 1)
    + ulog_message("O", b"\x05\x00")
    for k in range(10)
]
ULOG = ulog(
    [SENSORS, SETPOINT, STATUS, UTC], [*CYCLES[:6], ulog_message("S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"), *CYCLES[6:]]
)
ULOG_RECORDS = ULOG.index(CYCLES[0])

ROWS = {name: table[:, 3000:3600] for name, table in flight(5.0, 9).items()}
PACKED = mat_content(ROWS)
PLAIN = mat_content({name: table[:, :40] for name, table in ROWS.items()}, compressed=False)

LOGS: dict[str, tuple[bytes, Callable[[Path], Log], Callable[[bytes], bytes]]] = {
    "Crazyflie": (CRAZYFLIE, read_crazyflie, with_checksum),
    "DataFlash": (DATAFLASH, read_dataflash, bytes),
    "ULog": (ULOG, read_ulog, bytes),
    "DronePropA": (PLAIN, read_dronepropa, bytes),
    "DronePropA, compressed": (PACKED, read_dronepropa, bytes),
}
HEAD_BYTES = {"Crazyflie": 3, "DataFlash": 2, "ULog": 16, "DronePropA": 128, "DronePropA, compressed": 128}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("damage") / "log"


def read(path: Path, kind: str, content: bytes) -> Log | None:
    """The log, or None for an error of one line that names the file."""
    path.write_bytes(LOGS[kind][2](content))
    try:
        return LOGS[kind][1](path)
    except InputError as error:
        told = str(error)
    assert told.startswith(str(path))
    assert "\n" not in told
    return None


def flipped(content: bytes, bits: list[int]) -> bytes:
    damaged = bytearray(content)
    for bit in bits:
        damaged[bit % (8 * len(content)) // 8] ^= 1 << bit % 8
    return bytes(damaged)


@pytest.mark.parametrize("kind", LOGS)
@given(data=st.data())
def test_no_damage_is_a_crash(path: Path, kind: str, data: st.DataObject) -> None:
    """Flipped bits, also in what declares the rest; inserted bytes; an end anywhere; nothing but the first bytes."""
    content, head = LOGS[kind][0], HEAD_BYTES[kind]
    assert read(path, kind, content) is not None
    bits = data.draw(st.lists(st.integers(0, 8 * len(content) - 1), min_size=1, max_size=8))
    bits += data.draw(st.lists(st.integers(8 * head, 8 * (head + 400)), max_size=3))
    garbage, place = data.draw(st.binary(max_size=64)), data.draw(st.integers(0, len(content)))
    damaged = flipped(content, bits)
    for one in (damaged, damaged[:place], content[:place] + garbage + content[place:], content[:head] + garbage):
        read(path, kind, one)


@given(kept=st.integers(0, len(CRAZYFLIE) + 3), bit=st.integers(0, 8 * len(CRAZYFLIE) + 31))
def test_a_checksum_notices_a_cut_and_a_flipped_bit(path: Path, kept: int, bit: int) -> None:
    whole = with_checksum(CRAZYFLIE)
    for damaged in (whole[:kept], flipped(whole, [bit])):
        path.write_bytes(damaged)
        with pytest.raises(InputError):
            read_crazyflie(path)


@given(kept=st.integers(0, len(DATAFLASH)))
def test_a_truncated_dataflash_log_keeps_its_whole_records(path: Path, kept: int) -> None:
    log, cut = read(path, "DataFlash", DATAFLASH[:kept]), DATAFLASH[max(0, kept - 35) : kept]
    whole = DATAFLASH[:kept].count(b"\xa3\x95\xa3") - int(kept < len(DATAFLASH) and b"\xa3\x95\xa3" in cut)
    found = log.telemetry.get(Signal.BODY_RATE) if log is not None else None
    assert (0 if found is None else len(found)) == whole


@given(bit=st.integers(8 * DATAFLASH.index(FUNCTION), 8 * len(DATAFLASH) - 1))
def test_a_flipped_bit_in_dataflash_records_costs_few_of_them(path: Path, bit: int) -> None:
    log = read(path, "DataFlash", flipped(DATAFLASH, [bit]))
    assert log is not None
    assert len(log[Signal.BODY_RATE]) >= COUNT - 3


@given(
    characters=st.text("abBhHiIqQfdgnNZcCeELM?", min_size=7, max_size=7), values=st.binary(min_size=600, max_size=600)
)
def test_any_declared_dataflash_format_is_no_crash(path: Path, characters: str, values: bytes) -> None:
    attitude = DataFlashMessage(70, "ATT", "Q" * 7, "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw")
    arming = DataFlashMessage(71, "EV", "Q" * 7, "I,TimeMS,Id,A,B,C,D")
    content = bytearray(dataflash([attitude, arming, IMU], []))
    for message in (attitude, arming):
        place = content.index(message.characters.encode(), content.index(message.labels.encode()) - 16)
        content[place : place + 7] = characters.encode()
        sizes = {"a": 64, "n": 4, "N": 16, "Z": 64, "b": 1, "B": 1, "M": 1, "h": 2, "H": 2, "c": 2, "C": 2, "g": 2}
        length = 3 + sum(sizes.get(c, 8 if c in "qQd" else 4) for c in characters)
        content[place - 5] = length & 0xFF
        content += b"\xa3\x95" + bytes([message.kind]) + values[: length - 3]
    read(path, "DataFlash", bytes(content))


def same_as_pyulog(content: bytes) -> None:
    """Every field of every topic of interest, its first instance, is what pyulog alone makes of it."""
    found, parameters, notes = _content(content)
    with redirect_stdout(io.StringIO()):
        plain = ULog(io.BytesIO(content), list(TOPICS))
    expected: dict[str, ULog.Data] = {}
    for item in plain.data_list:
        expected.setdefault(item.name, item)
    assert list(found) == list(expected)
    for name, item in found.items():
        assert item.multi_id == expected[name].multi_id
        assert list(item.data) == list(expected[name].data)
        for field, column in item.data.items():
            assert column.dtype == expected[name].data[field].dtype
            assert column.tobytes() == expected[name].data[field].tobytes()
    assert set(parameters) == set(plain.initial_parameters) | {name for _, name, _ in plain.changed_parameters}
    assert any("damaged" in note for note in notes) == plain.file_corruption


def test_a_recording_is_field_by_field_what_pyulog_reads() -> None:
    same_as_pyulog(shared("data/px4_real/pyulog_sample.ulg").read_bytes())


@given(garbage=st.binary(max_size=64), place=st.integers(ULOG_RECORDS, len(ULOG)), kept=st.integers(0, len(ULOG)))
def test_a_damaged_ulog_is_field_by_field_what_pyulog_reads(garbage: bytes, place: int, kept: int) -> None:
    same_as_pyulog((ULOG[:place] + garbage + ULOG[place:])[: ULOG_RECORDS + kept])


@given(kept=st.integers(ULOG_RECORDS + 1, len(ULOG)))
def test_only_a_ulog_that_ends_within_a_message_says_so(kept: int) -> None:
    ends = {ULOG_RECORDS}
    while max(ends) < len(ULOG):
        ends.add(max(ends) + 3 + int.from_bytes(ULOG[max(ends) : max(ends) + 2], "little"))
    notes = _content(ULOG[:kept])[2]
    assert any("ends within a message" in note for note in notes) == (kept not in ends)


@given(kept=st.integers(0, len(PACKED) - 1), bits=st.lists(st.integers(128 * 8, 8 * len(PACKED) - 1), min_size=1))
def test_what_is_left_of_compressed_matrices_is_a_beginning_and_a_note(path: Path, kept: int, bits: list[int]) -> None:
    log = read(path, "DronePropA, compressed", PACKED[:kept])
    if log is not None:
        assert any("cut off" in note for note in log.notes)
        expected = ROWS["QDrone_data"][19:23, : len(log["body_rate"])]
        np.testing.assert_array_equal(log["actuator"].values, expected.T)
    log = read(path, "DronePropA, compressed", flipped(PACKED, list(set(bits))))
    if log is not None and not log.notes[1:]:  # the first note is that the flight is short
        np.testing.assert_array_equal(log["actuator"].values, ROWS["QDrone_data"][19:23].T)


def test_values_of_any_size_are_masked(path: Path) -> None:
    rows = {name: table.copy() for name, table in ROWS.items()}
    for table in rows.values():
        table[1:, 5], table[1:, 6], table[1:, 7] = 1e308, -np.inf, np.nan
    log = read(path, "DronePropA", mat_content(rows))
    assert log is not None
    assert all(np.isnan(series.values[5:8]).all() for series in log.telemetry if series.signal != "armed")
