"""Files: hostile ones are one line, damaged logs are read as far as they go, and what is written is written whole."""

import json
import os
import struct
import threading
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_logs import (
    ATT,
    IMU,
    PARM,
    RATE,
    RCOU,
    SENSORS,
    SETPOINT,
    STAMP,
    CrazyflieEvent,
    DataFlashMessage,
    ULogTopic,
    crazyflie_content,
    dataflash,
    flight,
    ulog,
    ulog_message,
    with_checksum,
)
from made_logs import content as mat_content
from made_session import baseline_for

from detector.config import load_settings
from mavdiag.airframe.load import load_airframe
from mavdiag.baseline import Baseline, dump, sealed
from mavdiag.errors import InputError, MavdiagError, UsageError
from mavdiag.logs import read_log
from mavdiag.logs.crazyflie import read_crazyflie
from mavdiag.logs.dataflash import read_dataflash
from mavdiag.logs.dronepropa import read_dronepropa
from mavdiag.logs.ulog import read_ulog
from mavdiag.storage import check_writable, read_text, replacing, write_atomically
from mavdiag.telemetry import Log
from sitl_plant.vehicle import load_vehicle

READERS: dict[str, Callable[[Path], object]] = {
    "baseline": Baseline.load,
    "log": read_log,
    "config": lambda path: load_settings(path, {}),
    "airframe": load_airframe,
    "vehicle": load_vehicle,
}


def refused(reader: str, path: Path, most_bytes: float = 64e6) -> str:
    """The one line that a reader has for a file."""
    tracemalloc.start()
    try:
        with pytest.raises(MavdiagError) as caught:
            READERS[reader](path)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < most_bytes
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_regular_file_is_refused_at_once(reader: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "tty").symlink_to("/dev/tty")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    assert "is not a regular file" in refused(reader, tmp_path / "fifo")
    assert "is not a regular file" in refused(reader, tmp_path / "zero")
    assert "tty" in refused(reader, tmp_path / "tty")
    assert "symbolic links" in refused(reader, tmp_path / "loop")
    assert "is a folder" in refused(reader, tmp_path)
    assert "no such file" in refused(reader, tmp_path / "absent")


@pytest.mark.parametrize("reader", READERS)
def test_a_file_without_end_is_refused_by_its_size(reader: str, tmp_path: Path) -> None:
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(1 << 42)
    assert "is too large" in refused(reader, tmp_path / "sparse")


SCHEMA = '{"schema": "mavdiag.baseline/7", '
TEXTS = {
    "deep list": "[" * 2_000_000,
    "deep table": SCHEMA + '"monitors": ' + '{"a":' * 200_000,
    "deep and whole": SCHEMA + '"monitors": ' + "[" * 900 + "]" * 900 + "}",
    "long number": SCHEMA + '"x": ' + "9" * 100_000 + "}",
    "not a number": SCHEMA + '"link": NaN}',
    "infinite": SCHEMA + '"link": {"dt_s": 1e999}}',
    "many keys": SCHEMA + ", ".join(f'"k{k}": 1' for k in range(50_000)) + "}",
    "many monitors": SCHEMA + '"monitors": [' + ", ".join(["{}"] * 50_000) + "]}",
    "zeros": "\0" * 10_000,
    "one string": '"' + "x" * 1_000_000 + '"',
}


@pytest.mark.parametrize("name", TEXTS)
def test_a_hostile_baseline(name: str, tmp_path: Path) -> None:
    (path := tmp_path / "b.json").write_text(TEXTS[name])
    assert len(refused("baseline", path)) < 500


def places(value: object, at: tuple[object, ...] = ()) -> list[tuple[object, ...]]:
    if isinstance(value, dict):
        return [one for key, inner in value.items() for one in places(inner, (*at, key))]
    if isinstance(value, list):
        return [one for key, inner in enumerate(value) for one in places(inner, (*at, key))]
    return [at] if isinstance(value, int | float) and not isinstance(value, bool) else []


@pytest.mark.parametrize("number", [float("nan"), 1e308, -1e308, 5e-324, 10**400, -(10**18)])
def test_every_number_of_a_baseline_replaced(number: float, tmp_path: Path) -> None:
    """A file that was changed has another digest; one whose digest was made anew is refused or can be shown."""
    sound = json.loads(dump(baseline_for()))
    for place in places(sound):
        raw = json.loads(json.dumps(sound))
        inner = raw
        for step in place[:-1]:
            inner = inner[step]
        inner[place[-1]] = number
        (path := tmp_path / "b.json").write_text(json.dumps(raw))
        with pytest.raises(MavdiagError) as caught:
            Baseline.load(path)
        assert "\n" not in str(caught.value), place
        try:
            one = sealed(Baseline.model_validate(raw))
        except (MavdiagError, ValueError):
            continue
        assert str(one)


TABLES = {
    "deep": "a = " + "[" * 10_000,
    "deep and whole": "a = " + "[" * 900 + "]" * 900,
    "many parts": "a." * 3000 + "b = 1",
    "long number": "learn = " + "9" * 10_000,
    "infinite": "learn = inf",
    "not a number": "name = nan",
    "steering": '"\\u001b[31mx" = 1',
    "not UTF-8": None,
}


@pytest.mark.parametrize("reader", ["config", "airframe", "vehicle"])
@pytest.mark.parametrize("name", TABLES)
def test_a_hostile_table(reader: str, name: str, tmp_path: Path) -> None:
    path, text = tmp_path / "t.toml", TABLES[name]
    path.write_bytes(b"\xff\xfe\x00" if text is None else text.encode())
    refused(reader, path)


def test_a_decompression_bomb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a megabyte of the file would become is never made whole; the bound itself is lowered to keep this quick."""
    monkeypatch.setattr("mavdiag.logs.matlab.MAX_BYTES", 1 << 22)
    shape = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, 17, 1 << 27)
    name = struct.pack("<II", 1, 11) + b"QDrone_data".ljust(16, b"\0")
    inner = shape + name + struct.pack("<II", 9, 136 * (1 << 27) & 0xFFFFFFFF) + bytes(48 << 20)
    body = zlib.compress(struct.pack("<II", 14, len(inner) & 0xFFFFFFFF) + inner, 9)
    path, head = tmp_path / "bomb.mat", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(head + struct.pack("<II", 15, len(body)) + body)
    assert path.stat().st_size < 100_000
    refused("log", path, most_bytes=16 << 20)


def test_r5_nothing_but_a_regular_file_is_replaced(tmp_path: Path) -> None:
    target, link, pipe = tmp_path / "target", tmp_path / "link", tmp_path / "pipe"
    target.write_text("kept")
    link.symlink_to(target)
    os.mkfifo(pipe)
    for path, kind in ((Path(os.devnull), "not a regular file"), (link, "symbolic link"), (pipe, "not a regular")):
        with pytest.raises(UsageError, match=kind):
            write_atomically(path, "text")
    assert link.is_symlink()
    assert pipe.is_fifo()
    assert target.read_text() == "kept"
    assert Path(os.devnull).is_char_device()


def test_r4_a_folder_is_called_a_folder(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is a folder; name a file"):
        write_atomically(tmp_path, "text")
    with pytest.raises(InputError, match="is a folder; name a file"):
        read_text(tmp_path)
    with pytest.raises(UsageError, match="there is no folder"):
        check_writable(tmp_path / "absent" / "b.json")


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_a_new_file_has_the_users_mode_and_a_replaced_one_keeps_its_own(tmp_path: Path, umask: int, mode: int) -> None:
    before = os.umask(umask)
    try:
        write_atomically(tmp_path / "new.json", "1")
        (tmp_path / "old.json").touch()
        (tmp_path / "old.json").chmod(0o640)
        write_atomically(tmp_path / "old.json", "2")
    finally:
        os.umask(before)
    assert (tmp_path / "new.json").stat().st_mode & 0o777 == mode
    assert (tmp_path / "old.json").stat().st_mode & 0o777 == 0o640


def test_writers_of_one_name_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    texts = [str(k) * 100_000 for k in range(4)]

    def write(text: str) -> None:
        for _ in range(10):
            write_atomically(path, text, durable=False)

    threads = [threading.Thread(target=write, args=(text,)) for text in texts]
    for one in threads:
        one.start()
    while any(one.is_alive() for one in threads):
        assert not path.exists() or path.read_text() in texts
    assert path.read_text() in texts
    assert [one.name for one in tmp_path.iterdir()] == ["kept.json"]


PID = CrazyflieEvent(9, "fixedFrequency", tuple(f"controller.{name}(f)" for name in ("r_roll", "r_pitch", "r_yaw")))
MARK = CrazyflieEvent(7, "mark", ("mode(B)",))
CRAZYFLIE = crazyflie_content(
    [PID, MARK],
    [PID.record(1_000 * k, k, -k, 0.5) + (MARK.record(1_000 * k + 1, k) if k % 3 else b"") for k in range(8)],
)

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
            + RCOU.record(10_000 * k + 1, 1500, 1500, 1500, 1500 + k, 0, 0)
            + EV.record(10 + k % 2)
            + GPS.record(10_000 * k + 1, 3, 1_000 * k, 2086)
            for k in range(COUNT)
        ),
    ],
)

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
    assert [line.startswith(str(path)) for line in told.split("\n")] == [True]
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


def test_what_is_not_written_to_its_end_leaves_the_old_file_and_nothing_beside_it(tmp_path: Path) -> None:
    (old := tmp_path / "old.csv").write_text("whole")
    with pytest.raises(ZeroDivisionError), replacing(old) as file:
        file.writelines(bytes(1 // n) for n in (1, 0))
    assert (old.read_text(), list(tmp_path.iterdir())) == ("whole", [old])
