"""The key file and the stamp beside it: who may read it, what is in it, and that a restart uses no stamp again."""

import hashlib
import os
from pathlib import Path

import pytest

from mavdiag.errors import UsageError
from mavdiag.link.codec import Encoder
from mavdiag.link.keys import AHEAD, RETRY_S, open_signing, read_key
from mavdiag.link.messages import MessageId
from mavdiag.link.signing import Signing, stamp_at

NOW_NS = 1_800_000_000 * 1_000_000_000
S = 1_000_000_000


def key_file(folder: Path, content: bytes = b"correct horse\n", mode: int = 0o600) -> Path:
    path = folder / "key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize("end", [b"", b"\n", b"\r\n"])
def test_a_passphrase_is_hashed_as_ground_stations_do(tmp_path: Path, end: bytes) -> None:
    assert read_key(key_file(tmp_path, b"correct horse" + end)) == hashlib.sha256(b"correct horse").digest()


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o644, 0o610])
def test_a_key_that_others_may_read_is_refused(tmp_path: Path, mode: int) -> None:
    path = key_file(tmp_path, mode=mode)
    with pytest.raises(UsageError, match=f"run `chmod 600 {path}`") as caught:
        read_key(path)
    assert "\n" not in str(caught.value)


def test_another_users_key_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = os.stat_result((0o100600, 0, 0, 1, 12_345, 0, 0, 0, 0, 0))
    monkeypatch.setattr("mavdiag.link.keys.os.fstat", lambda _: found)
    with pytest.raises(UsageError, match="another user's"):
        read_key(key_file(tmp_path))


def test_what_is_no_regular_file_of_one_line_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "zero").symlink_to("/dev/zero")
    for name, why in (("fifo", "regular"), ("zero", "regular"), (".", "folder"), ("none", "no such file")):
        with pytest.raises(UsageError, match=why):
            read_key(tmp_path / name)
    for content, why in ((b"x" * 5000, "too large"), (b"", "one line"), (b"\r\n", "one line"), (b"a\nb\n", "one line")):
        with pytest.raises(UsageError, match=why):
            read_key(key_file(tmp_path, content))


@pytest.mark.parametrize("text", ["", "soon", "-5", "9" * 16, str(1 << 48), "1e9"])
def test_a_damaged_stamp_is_told(tmp_path: Path, text: str) -> None:
    (tmp_path / "key.detector.stamp").write_text(text)
    with pytest.raises(UsageError, match="no time stamp"):
        open_signing(key_file(tmp_path), "detector", NOW_NS)


def test_a_restart_uses_no_stamp_again_even_if_the_clock_went_back(tmp_path: Path) -> None:
    first = open_signing(key_file(tmp_path), "detector", NOW_NS)
    for k in range(200):
        assert first.step(NOW_NS + k * S) is None
        first.signing.seal(b"\xfd")
    killed = first.signing.stamp  # no close
    second = open_signing(tmp_path / "key", "detector", NOW_NS - 3600 * S)
    assert killed < second.signing.stamp <= killed + AHEAD
    second.close()
    assert open_signing(tmp_path / "key", "detector", 0).signing.stamp == second.signing.stamp


def test_a_full_disk_is_told_now_and_then_and_signing_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = open_signing(key_file(tmp_path), "detector", NOW_NS)

    def full(path: Path, text: str) -> None:
        raise UsageError(f"{path}: no space left")

    monkeypatch.setattr("mavdiag.link.keys.write_atomically", full)
    told = [kept.step(NOW_NS + k * S) for k in range(200)]
    assert set(told) == {None, f"{tmp_path}/key.detector.stamp: no space left"}
    assert 13 <= sum(one is not None for one in told) <= 1 + 140 / RETRY_S
    assert kept.signing.stamp == stamp_at(NOW_NS + 199 * S)


def test_a_clock_that_was_two_hours_ahead_is_told_and_can_be_remedied(tmp_path: Path) -> None:
    wrong = open_signing(key_file(tmp_path), "detector", NOW_NS + 7200 * S)
    assert wrong.doubt == ""
    wrong.close()
    genuine = Signing(read_key(tmp_path / "key"), stamp=stamp_at(NOW_NS))
    frame = Encoder(1, 1, genuine).encode(MessageId.HEARTBEAT, 2, 3, 81, 0, 4, 3)
    again = open_signing(tmp_path / "key", "detector", NOW_NS)
    assert again.signing.genuine(frame)
    assert not again.signing.fresh(frame)
    assert "7199 s ahead" in again.doubt or "7200 s ahead" in again.doubt
    assert "--reset-stamp" in again.doubt
    again.close()
    reset = open_signing(tmp_path / "key", "detector", NOW_NS, reset=True)
    assert reset.doubt == ""
    assert reset.signing.fresh(frame)
    reset.close()
    assert open_signing(tmp_path / "key", "detector", NOW_NS).doubt == ""
