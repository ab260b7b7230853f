"""Whatever happens to a DronePropA recording, the reader returns a log or raises InputError, and comes back."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_dronepropa import content, flight

from mavdiag.errors import InputError
from mavdiag.logs.dronepropa import read_dronepropa
from mavdiag.telemetry import Log

ROWS = {name: table[:, 3000:3600] for name, table in flight(5.0, 9).items()}
PACKED, PLAIN = content(ROWS), content({name: table[:, :40] for name, table in ROWS.items()}, compressed=False)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("dronepropa") / "log"


def try_to_read(path: Path, data: bytes) -> Log | None:
    path.write_bytes(data)
    try:
        return read_dronepropa(path)
    except InputError:
        return None


def test_the_sound_files_are_read(path: Path) -> None:
    for data, count in ((PACKED, 600), (PLAIN, 40)):
        log = try_to_read(path, data)
        assert log is not None
        assert len(log["body_rate"]) == count


@given(kept=st.integers(0, len(PACKED) - 1))
def test_a_truncated_file_gives_a_beginning_and_a_note_or_is_refused(path: Path, kept: int) -> None:
    log = try_to_read(path, PACKED[:kept])
    if log is not None:
        count = len(log["body_rate"])
        assert any("cut off" in note for note in log.notes)
        np.testing.assert_array_equal(log["actuator"].values, ROWS["QDrone_data"][19:23, :count].T)


@given(bits=st.lists(st.integers(128 * 8, 8 * len(PACKED) - 1), min_size=1, max_size=4))
def test_a_flipped_bit_in_the_compressed_data_is_noticed_or_harmless(path: Path, bits: list[int]) -> None:
    damaged = bytearray(PACKED)
    for bit in set(bits):
        damaged[bit // 8] ^= 1 << bit % 8
    log = try_to_read(path, bytes(damaged))
    if log is not None and not log.notes[1:]:  # the first note is that the flight is short
        np.testing.assert_array_equal(log["actuator"].values, ROWS["QDrone_data"][19:23].T)


@given(
    bits=st.lists(st.integers(0, 8 * len(PLAIN) - 1), min_size=1, max_size=8),
    heads=st.lists(st.integers(128 * 8, 8 * 200), max_size=3),
    kept=st.integers(1, len(PLAIN)),
)
def test_damage_without_a_checksum_is_no_crash(path: Path, bits: list[int], heads: list[int], kept: int) -> None:
    damaged = bytearray(PLAIN)
    for bit in (*bits, *heads):
        damaged[bit // 8] ^= 1 << bit % 8
    try_to_read(path, bytes(damaged))
    try_to_read(path, bytes(damaged[:kept]))


def test_values_of_any_size_are_masked(path: Path) -> None:
    rows = {name: table.copy() for name, table in ROWS.items()}
    for table in rows.values():
        table[1:, 5], table[1:, 6], table[1:, 7] = 1e308, -np.inf, np.nan
    log = try_to_read(path, content(rows))
    assert log is not None
    assert all(np.isnan(series.values[5:8]).all() for series in log.telemetry if series.signal != "armed")


@given(body=st.binary(max_size=400))
def test_any_bytes_behind_the_header_are_no_crash(path: Path, body: bytes) -> None:
    assert try_to_read(path, PLAIN[:128] + body) is None
