"""Whatever happens to a ULog, the reader returns what is left or raises InputError, and comes back."""

import io
from contextlib import redirect_stdout
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_logs import ULOG_HEAD, ULogTopic, ulog, ulog_message
from pyulog import ULog
from shared_data import shared

from mavdiag.errors import InputError
from mavdiag.logs.ulog import TOPICS, _content, read_ulog

STAMP = ("uint64_t", "timestamp")
SENSORS = ULogTopic(1, "sensor_combined", (STAMP, ("float[3]", "gyro_rad"), ("float[3]", "accelerometer_m_s2")))
SETPOINT = ULogTopic(2, "vehicle_attitude_setpoint", (STAMP, ("float[4]", "q_d"), ("float[3]", "thrust_body")))
STATUS = ULogTopic(3, "vehicle_status", (STAMP, ("uint8_t", "arming_state")))
GPS = ULogTopic(4, "vehicle_gps_position", (STAMP, ("uint64_t", "time_utc_usec")))
SYNC = ulog_message("S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12")


def cycle(k: int) -> bytes:
    time_us = 4_000 * k + 1
    records = (
        SENSORS.record(time_us, 0.1 * k, 0, 0, 0, 0, -9.8),
        SETPOINT.record(time_us, 1, 0, 0, 0, 0, 0, -0.5),
        STATUS.record(time_us, 2),
        GPS.record(time_us, 1_577_880_000_000_000 + time_us),
        ulog_message("O", b"\x05\x00"),
    )
    return b"".join(records)


FLAGS = ulog_message("B", bytes(40))
INFO = ulog_message("I", b"\x10char[3] sys_namePX4")
LOG = ulog([SENSORS, SETPOINT, STATUS, GPS], [*(cycle(k) for k in range(6)), SYNC, *(cycle(k) for k in range(6, 10))])
LOG = LOG[:16] + FLAGS + INFO + LOG[16:]
FIRST_RECORD = LOG.index(cycle(0))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ulog") / "log.ulg"


def try_to_read(path: Path, content: bytes) -> bool:
    path.write_bytes(content)
    try:
        read_ulog(path)
    except InputError:
        return False
    return True


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


@given(garbage=st.binary(max_size=64), place=st.integers(FIRST_RECORD, len(LOG)), kept=st.integers(0, len(LOG)))
def test_a_damaged_file_is_field_by_field_what_pyulog_reads(garbage: bytes, place: int, kept: int) -> None:
    same_as_pyulog((LOG[:place] + garbage + LOG[place:])[: FIRST_RECORD + kept])


@given(kept=st.integers(FIRST_RECORD + 1, len(LOG)))
def test_only_a_file_that_ends_within_a_message_says_so(kept: int) -> None:
    ends = {FIRST_RECORD}
    while max(ends) < len(LOG):
        ends.add(max(ends) + 3 + int.from_bytes(LOG[max(ends) : max(ends) + 2], "little"))
    notes = _content(LOG[:kept])[2]
    assert any("ends within a message" in note for note in notes) == (kept not in ends)


def test_the_whole_log_reads(path: Path) -> None:
    assert try_to_read(path, LOG)


@given(kept=st.integers(0, len(LOG)))
def test_a_truncated_file_is_no_crash(path: Path, kept: int) -> None:
    try_to_read(path, LOG[:kept])


@given(bits=st.lists(st.integers(0, 8 * len(LOG) - 1), min_size=1, max_size=6))
def test_flipped_bits_are_no_crash(path: Path, bits: list[int]) -> None:
    damaged = bytearray(LOG)
    for bit in bits:
        damaged[bit // 8] ^= 1 << bit % 8
    try_to_read(path, bytes(damaged))


@given(bit=st.integers(16 * 8, 8 * 500), kept=st.integers(17, len(LOG)))
def test_a_flipped_bit_in_the_definitions_of_a_cut_file_is_no_crash(path: Path, bit: int, kept: int) -> None:
    damaged = bytearray(LOG)
    damaged[bit // 8] ^= 1 << bit % 8
    try_to_read(path, bytes(damaged[:kept]))


@given(garbage=st.binary(max_size=64), place=st.integers(16, len(LOG)))
def test_inserted_bytes_are_no_crash(path: Path, garbage: bytes, place: int) -> None:
    try_to_read(path, LOG[:place] + garbage + LOG[place:])


@given(body=st.binary(max_size=400))
def test_any_bytes_behind_the_magic_are_no_crash(path: Path, body: bytes) -> None:
    try_to_read(path, ULOG_HEAD + b"\x01" + bytes(8) + body)
