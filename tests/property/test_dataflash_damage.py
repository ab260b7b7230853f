"""Whatever happens to a DataFlash log, the reader returns what is left or raises InputError, and comes back."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_logs import DataFlashMessage, dataflash

from mavdiag.errors import InputError
from mavdiag.logs.dataflash import read_dataflash
from mavdiag.telemetry import Log, Signal

IMU = DataFlashMessage(163, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
ATT = DataFlashMessage(70, "ATT", "Qccccff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw")
RATE = DataFlashMessage(73, "RATE", "Qfffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut")
RCOU = DataFlashMessage(62, "RCOU", "QHHHH", "TimeUS,C1,C2,C3,C4")
PARM = DataFlashMessage(32, "PARM", "QNf", "TimeUS,Name,Value")
EV = DataFlashMessage(13, "EV", "B", "Id")
GPS = DataFlashMessage(90, "GPS", "QBIH", "TimeUS,Status,GMS,GWk")
COUNT = 12


def cycle(k: int) -> bytes:
    time_us = 10_000 * k + 1
    return b"".join(
        (
            IMU.record(time_us, 0, 0.1 * k, 0, 0, 0, 0, -9.8),
            ATT.record(time_us, 100 * k, 90 * k, 0, 0, 0, 0),
            RATE.record(time_us, k, k, 0, 0, 0, 0, 0, 0, 0),
            RCOU.record(time_us, 1500, 1500, 1500, 1500 + k),
            EV.record(10 + k % 2),
            GPS.record(time_us, 3, 1_000 * k, 2086),
        )
    )


MESSAGES = (IMU, ATT, RATE, RCOU, PARM, EV, GPS)
LOG = dataflash(MESSAGES, [PARM.record(1, b"SERVO1_FUNCTION", 33), *(cycle(k) for k in range(COUNT))])
FIRST_RECORD = LOG.index(PARM.record(1, b"SERVO1_FUNCTION", 33))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("dataflash") / "log.bin"


def try_to_read(path: Path, content: bytes) -> Log | None:
    path.write_bytes(content)
    try:
        return read_dataflash(path)
    except InputError:
        return None


@given(kept=st.integers(0, len(LOG)))
def test_a_truncated_file_keeps_its_whole_records(path: Path, kept: int) -> None:
    log = try_to_read(path, LOG[:kept])
    whole = LOG[:kept].count(b"\xa3\x95\xa3") - int(
        kept < len(LOG) and b"\xa3\x95\xa3" in LOG[max(0, kept - 35) : kept]
    )
    found = log.telemetry.get(Signal.BODY_RATE) if log is not None else None
    assert (0 if found is None else len(found)) == whole


@given(bit=st.integers(8 * FIRST_RECORD, 8 * len(LOG) - 1))
def test_a_flipped_bit_in_the_records_costs_few_of_them(path: Path, bit: int) -> None:
    damaged = bytearray(LOG)
    damaged[bit // 8] ^= 1 << bit % 8
    log = try_to_read(path, bytes(damaged))
    assert log is not None
    assert len(log.telemetry.need(Signal.BODY_RATE)) >= COUNT - 3


@given(bits=st.lists(st.integers(0, 8 * len(LOG) - 1), min_size=1, max_size=8))
def test_flipped_bits_anywhere_are_no_crash(path: Path, bits: list[int]) -> None:
    damaged = bytearray(LOG)
    for bit in bits:
        damaged[bit // 8] ^= 1 << bit % 8
    try_to_read(path, bytes(damaged))


@given(garbage=st.binary(max_size=64), place=st.integers(0, len(LOG)))
def test_inserted_bytes_are_no_crash(path: Path, garbage: bytes, place: int) -> None:
    try_to_read(path, LOG[:place] + garbage + LOG[place:])


@given(
    characters=st.text("abBhHiIqQfdgnNZcCeELM?", min_size=7, max_size=7), values=st.binary(min_size=600, max_size=600)
)
def test_any_declared_format_is_no_crash(path: Path, characters: str, values: bytes) -> None:
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
    try_to_read(path, bytes(content))
