"""Matrices out of MATLAB files: the same as scipy reads, and what is left of a file that was cut off."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_dronepropa import content
from scipy.io import loadmat

from mavdiag.errors import InputError
from mavdiag.logs.matlab import read_matrices

RNG = np.random.default_rng(11)
WANTED = {"one": 3, "two": 2}
ROWS = {"one": RNG.standard_normal((3, 4000)), "two": RNG.standard_normal((2, 900))}


def by_scipy(data: bytes, folder: Path) -> dict[str, Any]:
    path = folder / "made.mat"
    path.write_bytes(data)
    return dict(loadmat(path))


@pytest.mark.parametrize("compressed", [True, False])
@pytest.mark.parametrize("dtype", ["f8", "f4", "i2", "u1"])
def test_it_reads_what_scipy_reads(tmp_path: Path, compressed: bool, dtype: str) -> None:
    rows = {name: (20 * values).astype(dtype) for name, values in ROWS.items()}
    data = content({"other": np.ones((5, 7)), **rows, "text": np.array(["a", "b"])}, compressed=compressed)
    found, notes = read_matrices(data, WANTED)
    for name, values in by_scipy(data, tmp_path).items():
        if name in WANTED:
            np.testing.assert_array_equal(found[name], values.T)
    assert notes == ()


def last_element(data: bytes) -> int:
    """Where the last compressed element begins."""
    position, begin = 128, 128
    while position < len(data):
        begin, position = position, position + 8 + struct.unpack_from("<I", data, position + 4)[0]
    return begin


@pytest.mark.parametrize("missing", [1, 2, 3, 4])
def test_an_incomplete_checksum_is_a_note(missing: int) -> None:
    """As of F0_SV0_SP1_t3_D1_R1.mat, which strict readers refuse: with the length that belongs to it, or cut off."""
    data = content(ROWS)
    begin = last_element(data)
    body = data[begin + 8 : -missing]
    shortened = data[:begin] + struct.pack("<II", 15, len(body)) + body
    for cut in (shortened, data[:-missing]):
        found, notes = read_matrices(cut, WANTED)
        np.testing.assert_array_equal(found["two"], ROWS["two"].T)
        assert notes == ("two: its checksum is cut off",)


def compressed(inner: bytes) -> bytes:
    packed = zlib.compress(inner)
    return content({})[:128] + struct.pack("<II", 15, len(packed)) + packed


def with_wrong_checksum() -> bytes:
    data = bytearray(content(ROWS))
    data[-1] ^= 1
    return bytes(data)


def in_the_middle() -> bytes:
    data = bytearray(content(ROWS))
    data[200:5000] = bytes(4800)
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"MATLAB 7.3 MAT-file" + bytes(200), "save it again with -v7"),
        (b"\xbc\x02\x00 another kind", "first bytes"),
        (content(ROWS)[:300], "cut off; download it again"),
        (content({"one": ROWS["one"]}), "no two: it is another recording"),
        (content({"one": ROWS["one"].T, "two": ROWS["two"]}), "one is 4000 x 3, but a recording has 3 rows"),
        (content({"one": ROWS["one"] * 1j, "two": ROWS["two"]}), "one is of complex numbers"),
        (with_wrong_checksum(), "incorrect data check"),
        (in_the_middle(), "compressed data are damaged"),
        (compressed(struct.pack("<II", 14, 2**31) + bytes(40)), "no one"),
    ],
)
def test_what_cannot_be_used_is_one_line(data: bytes, reason: str) -> None:
    with pytest.raises(InputError, match=reason) as caught:
        read_matrices(data, WANTED)
    assert "\n" not in str(caught.value)
