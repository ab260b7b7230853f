"""Whatever happens to a Crazyflie log, the reader returns a log or raises InputError, and comes back."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_logs import CrazyflieEvent, crazyflie_content, with_checksum

from mavdiag.errors import InputError
from mavdiag.logs.crazyflie import read_crazyflie

PID = CrazyflieEvent(9, "fixedFrequency", tuple(f"controller.{name}(f)" for name in ("r_roll", "r_pitch", "r_yaw")))
MARK = CrazyflieEvent(7, "mark", ("mode(B)",))
CONTENT = crazyflie_content(
    [PID, MARK],
    [PID.record(1_000 * k, k, -k, 0.5) + (MARK.record(1_000 * k + 1, k) if k % 3 else b"") for k in range(8)],
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("crazyflie") / "log"


def try_to_read(path: Path, content: bytes) -> bool:
    path.write_bytes(content)
    try:
        read_crazyflie(path)
    except InputError:
        return False
    return True


@given(kept=st.integers(0, len(CONTENT) + 3))
def test_a_truncated_file_is_refused(path: Path, kept: int) -> None:
    assert not try_to_read(path, with_checksum(CONTENT)[:kept])


@given(bit=st.integers(0, 8 * len(CONTENT) + 31))
def test_a_flipped_bit_is_noticed(path: Path, bit: int) -> None:
    damaged = bytearray(with_checksum(CONTENT))
    damaged[bit // 8] ^= 1 << bit % 8
    assert not try_to_read(path, bytes(damaged))


@given(bits=st.lists(st.integers(0, 8 * len(CONTENT) - 1), min_size=1, max_size=4), kept=st.integers(1, len(CONTENT)))
def test_damage_behind_a_right_checksum_is_no_crash(path: Path, bits: list[int], kept: int) -> None:
    damaged = bytearray(CONTENT)
    for bit in bits:
        damaged[bit // 8] ^= 1 << bit % 8
    try_to_read(path, with_checksum(bytes(damaged[:kept])))
    try_to_read(path, with_checksum(bytes(damaged)))


@given(body=st.binary(max_size=300))
def test_any_bytes_behind_the_token_are_no_crash(path: Path, body: bytes) -> None:
    try_to_read(path, with_checksum(b"\xbc\x02\x00" + body))
