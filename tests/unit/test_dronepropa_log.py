"""MATLAB files: what scipy reads, damage, and the recordings of DronePropA."""

import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from made_logs import LINE_HZ, Rows, content, flight, written
from scipy.io import loadmat

from mavdiag.airframe.load import airframe_named
from mavdiag.errors import InputError
from mavdiag.learning import airborne, front_for
from mavdiag.logs import airframe_name_for, gate_for, read_log
from mavdiag.logs.matlab import read_matrices
from mavdiag.telemetry import Signal

MADE = flight(12.0, 3)
Change = Callable[[Rows], None]
MOTORS = (20, 21, 22, 23)  # rows of their commands
RNG = np.random.default_rng(11)
WANTED = {"one": 3, "two": 2}
ROWS = {"one": RNG.standard_normal((3, 4000)), "two": RNG.standard_normal((2, 900))}
WHOLE = content(ROWS)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("dronepropa") / "any name", MADE)


def test_it_is_found_by_content_and_has_its_own_gate_and_airframe(path: Path) -> None:
    log = read_log(path)
    assert (log.profile, log.notes, log.started_ns) == ("dronepropa", (), 0)
    assert airframe_name_for("dronepropa") == airframe_name_for("dronepropa-filtered") == "qdrone2-recorded"
    assert gate_for("dronepropa-filtered") is gate_for("dronepropa")
    frame = airframe_named("qdrone2-recorded")
    assert frame.classifier is None
    assert frame.hover_rad_s == pytest.approx(2 * np.pi * LINE_HZ)


def test_vectors_and_angles_turn_about_x(path: Path) -> None:
    """Forward stays, left becomes right and up becomes down: at rest -9.81 along z."""
    log, frd = read_log(path), np.array([1.0, -1.0, -1.0])
    q, c, s = (table.T for table in MADE.values())
    np.testing.assert_allclose(log["body_rate"].values, q[:, 26:29] * frd)
    np.testing.assert_allclose(log["specific_force"].values, q[:, 29:32] * frd)
    np.testing.assert_allclose(log["attitude"].values, np.column_stack((q[:, 1:3], c[:, 24])) * frd)
    np.testing.assert_allclose(log["attitude_setpoint"].values, np.column_stack((s[:, 8:10], c[:, 28])) * frd)
    assert log["specific_force"].values[:400, 2].mean() == pytest.approx(-9.81, abs=0.1)
    assert np.array_equal(log["body_rate"].t_ns, 1_000_000 * np.arange(12_000))


def test_only_state_5_is_flight(path: Path) -> None:
    log = read_log(path)
    assert np.flatnonzero(np.diff(log["armed"].values[:, 0])).tolist() == [2499, 10_998]
    learnt = airborne(front_for([log], 0.1), log)
    begun_ns, ended_ns = learnt.rows[0].block.t_ns[0], learnt.rows[-1].block.t_ns[-1]
    judged = np.concatenate([rows.block.t_ns[rows.block.valid] for rows in learnt.rows])
    assert (begun_ns, judged[0], ended_ns) == (2_500_000_000, 5_500_000_000, pytest.approx(9_998_000_000, abs=2e6))


def row(name: str, *numbers: int, factor: float = 1.0, add: float = 0.0) -> Change:
    def change(rows: Rows) -> None:
        rows[name][[number - 1 for number in numbers]] *= factor
        rows[name][[number - 1 for number in numbers]] += add

    return change


def moved(numbers: tuple[int, ...], to: tuple[int, ...]) -> Change:
    """What stands in these rows comes from those."""

    def change(rows: Rows) -> None:
        rows["QDrone_data"][np.array(numbers) - 1] = rows["QDrone_data"][np.array(to) - 1]

    return change


def stand_still(rows: Rows) -> None:
    rows["QDrone_data"][0, 50] = rows["QDrone_data"][0, 49]


def changed(folder: Path, change: Change) -> Path:
    copy = {name: table.copy() for name, table in MADE.items()}
    change(copy)
    return written(folder / "F0.mat", copy)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (row("QDrone_data", 30, 31, 32, factor=1 / 9.80665), r"specific force is 1.00 m/s\^2, not 9.8"),
        (row("QDrone_data", 32, factor=-1.0), "gravity is not along the vertical axis"),
        (row("QDrone_data", 27, factor=-1.0), r"raw roll gyro is not the roll estimate's slope \(x -"),
        (row("QDrone_data", 28, factor=57.3), "raw pitch gyro is not the pitch"),
        (row("QDrone_data", 29, factor=-1.0), "raw yaw gyro"),
        (row("QDrone_data", 6, factor=-1.0), "filtered pitch gyro"),
        (row("stabilizer_data", 9, factor=-1.0), "roll reference .* runs against"),
        (row("stabilizer_data", 10, factor=-1.0), "pitch reference .* runs against"),
        (row("commander_data", 25, factor=-1.0), "yaw .row 25. runs against"),
        (moved(MOTORS, (20, 22, 21, 23)), "motors are in another order"),  # the published table's
        (moved(MOTORS, (23, 22, 21, 20)), "motors are in another order"),  # one public program's
        (moved(MOTORS, (21, 20, 23, 22)), "motors are in another order"),
        (stand_still, "time does not increase"),
        (row("QDrone_data", 1, factor=1e9), "time does not increase"),
        (row("QDrone_data", 30, 31, 32, factor=np.nan), "specific force is 0.00"),
    ],
)
def test_a_file_against_the_table_is_refused(tmp_path: Path, change: Change, reason: str) -> None:
    file = changed(tmp_path, change)
    with pytest.raises(InputError, match=reason) as caught:
        read_log(file)
    assert [str(file) in line for line in str(caught.value).split("\n")] == [True]


@pytest.mark.parametrize(
    ("change", "note", "absent"),
    [
        (moved((49, 51), (51, 49)), "speeds of the ESCs were left out", True),
        (row("commander_data", 2, factor=0.0, add=1.0), "less than 2 s in flight", True),
        (row("commander_data", 1, add=0.25), "data has times that differ from QDrone_data's by up to 0.25 s", False),
        (row("QDrone_data", 4, 7, 29, 13, factor=0.0), "too little yaw motion to check the sign of the raw yaw", False),
        (row("stabilizer_data", 19, factor=0.0), "no roll torque command", False),
    ],
)
def test_what_stays_open_is_a_note(tmp_path: Path, change: Change, note: str, absent: bool) -> None:
    log = read_log(changed(tmp_path, change))
    assert any(note in one for one in log.notes), log.notes
    assert (log.telemetry.get(Signal.ROTOR_SPEED) is None) == absent


@pytest.mark.parametrize("compressed", [True, False])
@pytest.mark.parametrize("dtype", ["f8", "f4", "i2", "u1"])
def test_it_reads_what_scipy_reads(compressed: bool, dtype: str) -> None:
    rows = {name: (20 * values).astype(dtype) for name, values in ROWS.items()}
    data = content({"other": np.ones((5, 7)), **rows, "text": np.array(["a", "b"])}, compressed=compressed)
    found, notes = read_matrices(data, WANTED)
    expected = loadmat(BytesIO(data))  # type: ignore[arg-type]  # the stubs know no open files
    np.testing.assert_equal(found, {name: expected[name].T for name in WANTED})
    assert notes == ()


def test_numbers_of_no_type_and_complex_ones_are_refused() -> None:
    data = content(ROWS, compressed=False)
    at = data.index(b"one") + 4  # behind the tag that holds so short a name
    for kind in (0, 8, 0x29, 0x2009):  # at the last two the reader of scipy 1.17 ends the process
        with pytest.raises(InputError, match="one is damaged: its numbers are of no type"):
            read_matrices(data[:at] + struct.pack("<I", kind) + data[at + 4 :], WANTED)
    with pytest.raises(InputError, match="one is of complex numbers"):
        read_matrices(content({"one": ROWS["one"] + 1j}), WANTED)


@pytest.mark.parametrize("missing", [1, 2, 3, 4])
def test_an_incomplete_checksum_is_a_note(missing: int) -> None:
    """As of F0_SV0_SP1_t3_D1_R1.mat, which strict readers refuse: with the length that belongs to it, or cut off."""
    data = content(ROWS)
    position, begin = 128, 128  # of the last element
    while position < len(data):
        begin, position = position, position + 8 + struct.unpack_from("<I", data, position + 4)[0]
    body = data[begin + 8 : -missing]
    shortened = data[:begin] + struct.pack("<II", 15, len(body)) + body
    for cut in (shortened, data[:-missing]):
        found, notes = read_matrices(cut, WANTED)
        np.testing.assert_array_equal(found["two"], ROWS["two"].T)
        assert notes == ("two: its checksum is cut off",)


def compressed(inner: bytes) -> bytes:
    packed = zlib.compress(inner)
    return content({})[:128] + struct.pack("<II", 15, len(packed)) + packed


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"MATLAB 7.3 MAT-file" + bytes(200), "save it again with -v7"),
        (b"\xbc\x02\x00 another kind", "first bytes"),
        (content(ROWS)[:300], "cut off; download it again"),
        (content({"one": ROWS["one"]}), "no two: it is another recording"),
        (content({"one": ROWS["one"].T, "two": ROWS["two"]}), "one is 4000 x 3, but a recording has 3 rows"),
        (content({"one": ROWS["one"] * 1j, "two": ROWS["two"]}), "one is of complex numbers"),
        (WHOLE[:-1] + bytes([WHOLE[-1] ^ 1]), "incorrect data check"),
        (WHOLE[:200] + bytes(4800) + WHOLE[5000:], "compressed data are damaged"),
        (compressed(struct.pack("<II", 14, 2**31) + bytes(40)), "no one"),
    ],
)
def test_what_cannot_be_used_is_one_line(data: bytes, reason: str) -> None:
    with pytest.raises(InputError, match=reason) as caught:
        read_matrices(data, WANTED)
    assert "\n" not in str(caught.value)
