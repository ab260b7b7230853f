"""Whatever happens to a log of any kind, its reader returns what is left or raises InputError, and comes back."""

from collections.abc import Callable
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

from mavdiag.errors import InputError
from mavdiag.logs.crazyflie import read_crazyflie
from mavdiag.logs.dataflash import read_dataflash
from mavdiag.logs.dronepropa import read_dronepropa
from mavdiag.logs.ulog import read_ulog
from mavdiag.telemetry import Log

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
