"""MAVLink 2 signing against pymavlink and by hand, what an attacker does, and the files of key and stamp."""

import hashlib
import os
from pathlib import Path
from unittest.mock import patch

import pymavlink.dialects.v20.ardupilotmega as dialect
import pytest

from mavdiag.errors import UsageError
from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.keys import AHEAD, open_signing, read_key
from mavdiag.link.messages import MessageId
from mavdiag.link.signing import STALE, Refusal, Signing, stamp_at

KEY = hashlib.sha256(b"correct horse").digest()
NOW_NS = 1_800_000_000 * 1_000_000_000
NOW = stamp_at(NOW_NS)
HEARTBEAT = (2, 3, 0, 0, 4, 3)
S = 1_000_000_000


def peer(key: bytes = KEY, stamp: int = NOW, link_id: int = 0) -> dialect.MAVLink:
    """pymavlink, signing with a key and checking by it."""
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.robust_parsing = True
    mav.signing.secret_key, mav.signing.sign_outgoing = key, True
    mav.signing.timestamp, mav.signing.link_id = stamp, link_id
    return mav


def beats(count: int, signing: Signing, compid: int = 1) -> list[bytes]:
    encoder = Encoder(1, compid, signing)
    return [encoder.encode(MessageId.HEARTBEAT, *HEARTBEAT) for _ in range(count)]


def verifier(stamp: int = NOW) -> tuple[Signing, Decoder]:
    signing = Signing(KEY, stamp=stamp)
    return signing, Decoder(signing=signing)


def heard(decoder: Decoder, *datagrams: bytes) -> list[Frame]:
    return [frame for data in datagrams for frame in decoder.feed_datagram(data, 0)]


def test_a_heartbeat_is_sealed_as_the_specification_has_it() -> None:
    """By hand, with printf, xxd and sha256sum: link id 7, stamp 0x010203040507, the first 6 bytes of the hash."""
    frame = Encoder(1, 1, Signing(bytes(range(32)), link_id=7, stamp=0x010203040506)).encode(0, *HEARTBEAT)
    body, link, stamp, signature = "fd090100000101000000000000000203000403ad2f", "07", "070504030201", "4a418387aab5"
    assert frame.hex() == body + link + stamp + signature


def test_what_we_sign_pymavlink_accepts_and_the_other_way_round() -> None:
    mav, theirs = peer(), list[bytes]()
    for frame in beats(300, Signing(KEY, stamp=NOW)):
        assert [message.get_type() for message in mav.parse_buffer(frame) or ()] == ["HEARTBEAT"]
    (signing, decoder), mav = verifier(), peer(link_id=9)
    for mav.seq in (k % 256 for k in range(300)):
        theirs.append(bytes(dialect.mavlink_map[0](*HEARTBEAT).pack(mav)))
    assert [frame.seq for frame in heard(decoder, *theirs)] == [k % 256 for k in range(300)]
    assert (signing.accepted, signing.refused) == (300, {})


def test_a_forged_frame_with_a_huge_stamp_does_not_stop_the_genuine_stream() -> None:
    genuine = beats(20, Signing(KEY, stamp=NOW))
    forged = beats(1, Signing(b"x" * 32, stamp=(1 << 48) - 2))[0]
    signing, decoder = verifier()
    assert len(heard(decoder, *genuine[:10], forged, *genuine[10:])) == 20
    assert signing.refused == {Refusal.FORGED: 1}
    assert signing.stamp < NOW + 100


def test_every_bit_of_a_signed_frame_is_protected() -> None:
    frame = beats(1, Signing(KEY, stamp=NOW))[0]
    for place in range(3, len(frame)):
        signing, _ = verifier()
        changed = bytearray(frame)
        changed[place] ^= 1
        assert not signing.genuine(bytes(changed)), place
        assert signing.refused == {Refusal.FORGED: 1}


def test_unsigned_and_mavlink_1_are_refused_with_a_key() -> None:
    signing, decoder = verifier()
    (unsigned,) = beats(1, Signing(KEY, stamp=NOW))
    plain = Encoder(1, 1).encode(MessageId.HEARTBEAT, *HEARTBEAT)
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    old = bytes(dialect.mavlink_map[0](*HEARTBEAT).pack(mav, force_mavlink1=True))
    unknown = bytearray(plain)
    unknown[7:10] = b"\xff\xff\xff"
    assert heard(decoder, plain, old, bytes(unknown)) == []
    assert signing.refused == {Refusal.UNSIGNED: 2, Refusal.MAVLINK_1: 1}
    assert decoder.senders == {}
    assert len(heard(decoder, unsigned)) == 1


def test_a_replayed_copy_of_a_signed_frame_is_refused_and_not_passed_on() -> None:
    genuine, passed = beats(3, Signing(KEY, stamp=NOW)), list[tuple[bytes, int]]()
    decoder = Decoder(signing=(signing := Signing(KEY, stamp=NOW)), passed=passed)
    assert len(heard(decoder, *genuine, genuine[2], genuine[0])) == 3
    assert passed == [(frame, 0) for frame in genuine]
    assert signing.refused == {Refusal.REPLAYED: 2}


def test_each_stream_has_its_own_stamps_and_a_new_one_older_than_a_minute_is_stale() -> None:
    signing, decoder = verifier()
    late = NOW - STALE // 2
    assert len(heard(decoder, *beats(5, Signing(KEY, stamp=NOW)))) == 5
    assert len(heard(decoder, *beats(5, Signing(KEY, link_id=1, stamp=late)))) == 5
    assert heard(decoder, *beats(5, Signing(KEY, stamp=late))) == []
    assert signing.refused == {Refusal.REPLAYED: 5}
    assert heard(decoder, *beats(3, Signing(KEY, stamp=NOW - STALE - 10), compid=2)) == []
    assert signing.refused[Refusal.STALE] == 3
    assert len(heard(decoder, *beats(3, Signing(KEY, stamp=signing.stamp - STALE), compid=3))) == 3


def test_holders_of_the_key_cannot_fill_the_memory_either(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mavdiag.link.signing.STREAMS_MAX", 10)
    signing, decoder = verifier()
    for compid in range(1, 21):
        heard(decoder, *beats(1, Signing(KEY, stamp=NOW), compid))
    assert (signing.accepted, signing.refused) == (10, {Refusal.STALE: 10})


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


def test_what_is_no_regular_file_of_one_line_of_this_user_is_refused_at_once(tmp_path: Path) -> None:
    found = os.stat_result((0o100600, 0, 0, 1, 12_345, 0, 0, 0, 0, 0))
    with patch("mavdiag.link.keys.os.fstat", lambda _: found), pytest.raises(UsageError, match="another user's"):
        read_key(key_file(tmp_path))
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
