"""The codec against pymavlink's own, which packs and parses the same bytes; its laws; and signing, also by hand."""

import hashlib
import os
import struct
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.errors import UsageError
from mavdiag.link.codec import UNKNOWN, Decoder, Encoder, FieldValue, Frame, layout_of
from mavdiag.link.datagrams import as_columns
from mavdiag.link.keys import AHEAD, open_signing, read_key
from mavdiag.link.messages import MessageId
from mavdiag.link.signing import STALE, Refusal, Signing, stamp_at

HEARTBEAT = (2, 3, 128, 0, 4, 3)
BY_VERSION = [(v, n) for v in (1, 2) for n in sorted(dialect.mavlink_map) if v == 2 or n < 256]


def peer(seq: int = 0) -> dialect.MAVLink:
    mav = dialect.MAVLink(None, 1, 1)
    mav.seq = seq
    return mav


def wire_values(message: dialect.MAVLink_message) -> tuple[FieldValue, ...]:
    """The field values of pymavlink's parsed message, flattened in wire order."""
    values: list[FieldValue] = []
    for name in type(message).ordered_fieldnames:
        value = getattr(message, name)
        values += value if isinstance(value, list) else [value.encode() if isinstance(value, str) else value]
    return tuple(values)


def sample_arguments(message: type[dialect.MAVLink_message]) -> list[object]:
    """Small values that differ from field to field, in declaration order, as pymavlink's constructor takes them."""
    arguments: list[object] = []
    for place, name in enumerate(message.fieldnames):
        order = message.ordered_fieldnames.index(name)
        if message.fieldtypes[place] == "char":
            arguments.append(b"ab" if message.array_lengths[order] else b"x")
        else:
            size = message.lengths[order]
            base = 0.5 if message.fieldtypes[place] in ("float", "double") else 0
            values = [(place * 7 + k) % 100 + base for k in range(size)]
            arguments.append(values if message.array_lengths[order] else values[0])
    return arguments


@pytest.mark.parametrize(("version", "number"), BY_VERSION)
def test_every_message_of_the_dialect_travels_both_ways(version: int, number: int) -> None:
    message = dialect.mavlink_map[number]
    arguments = sample_arguments(message)
    theirs = message(*arguments).pack(peer(), force_mavlink1=version == 1)
    (frame,) = Decoder().feed(theirs, 5)
    parsed = peer().parse_buffer(theirs)
    assert parsed is not None
    assert (frame.msgid, frame.sysid, frame.compid, frame.seq, frame.host_ns) == (number, 1, 1, 0, 5)
    fields = tuple(one.rstrip(b"\0") if isinstance(one, bytes) else one for one in frame.fields)
    assert fields == wire_values(parsed[0])
    if version == 2:
        assert Encoder(1, 1).encode(number, *arguments) == theirs  # type: ignore[arg-type]  # generic test values
        assert Encoder(1, 1).encode_payload(number, frame.payload) == theirs


@pytest.mark.parametrize(("msgid", "seed"), [(291, 10), (300, 217), (435, 134)])
def test_messages_that_pymavlink_lacks_have_the_seed_of_the_published_definition(msgid: int, seed: int) -> None:
    assert layout_of(msgid).crc_extra[0] == seed


def test_integers_are_rounded_and_saturated_and_text_is_cut() -> None:
    data = Encoder(1, 1).encode(MessageId.RAW_IMU, 7.6, 4e4, -4e4, -1.5, float("inf"), 1, 2, 3, 4, 5)
    (frame,) = Decoder().feed(data, 0)
    assert frame.fields[:6] == (8, 32767, -32768, -2, 32767, 1)
    data = Encoder(1, 1).encode(MessageId.NAMED_VALUE_FLOAT, 1, "a name too long", 1e39)
    (frame,) = Decoder().feed(data, 0)
    assert frame.fields == (1, struct.unpack("<f", b"\xff\xff\x7f\x7f")[0], b"a name too")


@pytest.mark.parametrize(
    ("msgid", "fields", "words"),
    [
        (54321, (), "54321"),
        (MessageId.HEARTBEAT, (1, 2, 3, 4, 5, 6, 7), "6 fields"),
        (MessageId.RAW_IMU, (float("nan"),), "NaN"),
        (MessageId.ATTITUDE_TARGET, (0, 0, (1.0, 0.0)), "array"),
        (MessageId.NAMED_VALUE_FLOAT, (0, 5, 1.0), "text"),
        (MessageId.HEARTBEAT, ("x",), "HEARTBEAT"),
    ],
)
def test_what_cannot_be_sent_is_refused(msgid: int, fields: tuple[float, ...], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        Encoder(1, 1).encode(msgid, *fields)


def test_a_fake_header_does_not_swallow_the_frames_behind_it() -> None:
    encoder = Encoder(1, 1)
    beats = b"".join(encoder.encode(MessageId.HEARTBEAT, *HEARTBEAT) for _ in range(20))
    fake = b"\xfd\xff\x00\x00\x00\x01\x01\x00\x00\x00"  # a heartbeat of 255 bytes
    decoder = Decoder()
    assert (len(decoder.feed(fake + beats, 0)), decoder.records, decoder.garbage_bytes) == (20, 20, len(fake))


def unknown_frame(seq: int = 0) -> bytes:
    return bytes([0xFD, 3, 0, 0, seq, 1, 1, 0x31, 0xD4, 0x00]) + b"abc" + b"??"


def test_frames_outside_the_dialect_are_taken_on_trust_only_before_another_frame() -> None:
    good, decoder = Encoder(1, 1).encode(MessageId.HEARTBEAT, *HEARTBEAT), Decoder()
    assert (len(decoder.feed(unknown_frame(255))), decoder.records, len(decoder.feed(good))) == (0, 0, 1)  # waits
    assert (decoder.senders[1, 1].lost, decoder.senders[1, 1].by_message) == (0, {UNKNOWN: 1, MessageId.HEARTBEAT: 1})
    decoder = Decoder()
    assert (len(decoder.feed(unknown_frame() + b"x" + good, 0)), decoder.records) == (1, 1)
    decoder = Decoder()  # of two clients of a server
    decoder.take(as_columns([(unknown_frame(), 0), (good, 0)], [(1,), (2,)]), datagrams=False)
    assert (decoder.records, decoder.heard.source(1 << 8 | 1)) == (2, (1,))


@pytest.mark.parametrize(
    ("sequence", "lost", "reordered", "duplicated", "restarts"),
    [
        ([*range(600)], 0, 0, 0, 0),
        ([0, 1, 3, 4, 5], 1, 0, 0, 0),
        ([0, 1, 3, 2, 4, 5], 0, 1, 0, 0),
        ([254, 256, 255, 257], 0, 1, 0, 0),
        ([0, 1, 1, 2], 0, 0, 1, 0),
        ([*range(40), *(k + late for k in range(200) for late in (40, 0))], 0, 0, 200, 0),  # by another way
        ([*range(100), *range(200, 300)], 100, 0, 0, 0),
        ([*range(100), *range(50)], 0, 0, 0, 1),
        ([0, 4, 3, 1, 2, 5], 0, 3, 0, 0),
        ([0, 2, *range(3, 257), 257, 256 + 1], 1, 0, 1, 0),  # the gap was a whole turn ago
    ],
)
def test_losses_are_counted(sequence: list[int], lost: int, reordered: int, duplicated: int, restarts: int) -> None:
    message, decoder = dialect.mavlink_map[0](*HEARTBEAT), Decoder()
    heard = [len(decoder.feed(message.pack(peer(seq % 256)), 6_000_000 * k)) for k, seq in enumerate(sequence)]
    count = decoder.senders[1, 1]
    assert count.received == sum(heard) == len(sequence) - duplicated
    assert (count.lost, count.reordered, count.duplicated, count.restarts) == (lost, reordered, duplicated, restarts)


bytes_like_frames = st.lists(
    st.one_of(
        st.binary(max_size=40),
        st.sampled_from([b"\xfd", b"\xfe", b"\xfd\xff\x00\x00", b"\xfd\x09\x01\x00", b"\xfe\xff\x00\x01\x01\x00"]),
        st.integers(0, 200).map(lambda k: Encoder(1, 1).encode(MessageId.ATTITUDE_TARGET, k, 0, (1.0, 0.0, 0.0, 0.0))),
        st.integers(0, 200).map(lambda k: Encoder(2, 9).encode(MessageId.RAW_IMU, k, -k, k)),
        st.just(bytes([0xFD, 1, 0, 0, 0, 1, 1, 0x31, 0xD4, 0x00, 7, 7, 7])),  # outside the dialect
    ),
    max_size=12,
).map(b"".join)


@given(st.lists(st.binary(max_size=300), max_size=8), st.integers(0, 2**31))
def test_frames_in_garbage_are_found(garbage: list[bytes], stamp: int) -> None:
    encoder = Encoder(1, 1)
    sent, decoder = [encoder.encode(MessageId.ATTITUDE, stamp, 0.5 * k) for k in range(len(garbage))], Decoder()
    frames = decoder.feed(b"".join(g + s for g, s in zip(garbage, sent, strict=True)) + bytes(300), 0)
    mine = [f.fields[:2] for f in frames if f.msgid == MessageId.ATTITUDE]
    assert mine == [(stamp, 0.5 * k) for k in range(len(garbage))]


@given(st.binary(max_size=600))
def test_the_buffer_stays_small_and_garbage_never_raises(data: bytes) -> None:
    decoder = Decoder()
    for k in range(0, len(data), 7):
        decoder.feed(data[k : k + 7], 0)
        assert len(decoder._pending) <= 280 + 1


pieces = st.lists(st.tuples(bytes_like_frames, st.integers(0, 4 * 10**9), st.sampled_from("ab")), max_size=12)


@given(pieces)
def test_datagrams_at_once_are_heard_as_one_by_one(datagrams: list[tuple[bytes, int, str]]) -> None:
    """Whatever is in them, whenever they come, and from wherever."""
    times = np.cumsum([gap_ns for _, gap_ns, _ in datagrams]).tolist()
    chunks = [(data, at_ns) for (data, _, _), at_ns in zip(datagrams, times, strict=True)]
    sources = [source for _, _, source in datagrams]
    single, whole = Decoder(), Decoder()
    alone = (as_columns([chunk], [source]) for chunk, source in zip(chunks, sources, strict=True))
    each = [frame for one in alone for frame in single.take(one)]
    assert list(whole.take(as_columns(chunks, sources))) == each
    assert (whole.garbage_bytes, whole.records) == (single.garbage_bytes, single.records)
    assert whole.senders == single.senders
    for sender in single.senders:
        assert whole.heard.source(sender[0] << 8 | sender[1]) == single.heard.source(sender[0] << 8 | sender[1])


KEY = hashlib.sha256(b"correct horse").digest()
NOW_NS = 1_800_000_000 * 1_000_000_000
NOW = stamp_at(NOW_NS)
S = 1_000_000_000


def signer(link_id: int = 0) -> dialect.MAVLink:
    """pymavlink, signing with the key and checking by it."""
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.robust_parsing = True
    mav.signing.secret_key, mav.signing.sign_outgoing = KEY, True
    mav.signing.timestamp, mav.signing.link_id = NOW, link_id
    return mav


def beats(count: int, signing: Signing, compid: int = 1) -> list[bytes]:
    encoder = Encoder(1, compid, signing)
    return [encoder.encode(MessageId.HEARTBEAT, *HEARTBEAT) for _ in range(count)]


def verifier() -> tuple[Signing, Decoder]:
    signing = Signing(KEY, stamp=NOW)
    return signing, Decoder(signing=signing)


def heard(decoder: Decoder, *datagrams: bytes) -> list[Frame]:
    return list(decoder.take(as_columns([(data, 0) for data in datagrams])))


def test_a_heartbeat_is_sealed_as_the_specification_has_it() -> None:
    """By hand, with printf, xxd and sha256sum: link id 7, stamp 0x010203040507, the first 6 bytes of the hash."""
    frame = Encoder(1, 1, Signing(bytes(range(32)), link_id=7, stamp=0x010203040506)).encode(0, 2, 3, 0, 0, 4, 3)
    body, link, stamp, signature = "fd090100000101000000000000000203000403ad2f", "07", "070504030201", "4a418387aab5"
    assert frame.hex() == body + link + stamp + signature


def test_what_we_sign_pymavlink_accepts_and_the_other_way_round() -> None:
    mav, theirs = signer(), list[bytes]()
    for frame in beats(300, Signing(KEY, stamp=NOW)):
        assert [message.get_type() for message in mav.parse_buffer(frame) or ()] == ["HEARTBEAT"]
    (signing, decoder), mav = verifier(), signer(link_id=9)
    for mav.seq in (k % 256 for k in range(300)):
        theirs.append(bytes(dialect.mavlink_map[0](*HEARTBEAT).pack(mav)))
    assert ([frame.seq for frame in heard(decoder, *theirs)], signing.refused) == ([k % 256 for k in range(300)], {})


def test_a_forged_frame_with_a_huge_stamp_does_not_stop_the_genuine_stream() -> None:
    genuine, forged = beats(20, Signing(KEY, stamp=NOW)), beats(1, Signing(b"x" * 32, stamp=(1 << 48) - 2))[0]
    signing, decoder = verifier()
    assert (len(heard(decoder, *genuine[:10], forged, *genuine[10:])), signing.refused) == (20, {Refusal.FORGED: 1})
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
    plain, mav = Encoder(1, 1).encode(0, *HEARTBEAT), dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    old, unknown = bytes(dialect.mavlink_map[0](*HEARTBEAT).pack(mav, force_mavlink1=True)), bytearray(plain)
    unknown[7:10] = b"\xff\xff\xff"
    assert heard(decoder, plain, old, bytes(unknown)) == []
    assert (signing.refused, decoder.senders) == ({Refusal.UNSIGNED: 2, Refusal.MAVLINK_1: 1}, {})
    assert len(heard(decoder, unsigned)) == 1


def test_a_replayed_copy_of_a_signed_frame_is_refused_and_not_passed_on() -> None:
    genuine, passed = beats(3, Signing(KEY, stamp=NOW)), list[tuple[bytes, int]]()
    decoder = Decoder(signing=(signing := Signing(KEY, stamp=NOW)), passed=passed)
    assert (len(heard(decoder, *genuine, genuine[2], genuine[0])), passed) == (3, [(frame, 0) for frame in genuine])
    assert signing.refused == {Refusal.REPLAYED: 2}


def test_each_stream_has_its_own_stamps_and_a_new_one_older_than_a_minute_is_stale() -> None:
    signing, decoder = verifier()
    late = NOW - STALE // 2
    assert len(heard(decoder, *beats(5, Signing(KEY, stamp=NOW)))) == 5
    assert len(heard(decoder, *beats(10, Signing(KEY, link_id=1, stamp=late)))) == 5  # of which it heard five already
    assert (heard(decoder, *beats(5, Signing(KEY, stamp=late))), signing.refused) == ([], {Refusal.REPLAYED: 5})
    assert heard(decoder, *beats(3, Signing(KEY, stamp=NOW - STALE - 10), compid=2)) == []
    assert signing.refused[Refusal.STALE] == 3
    assert len(heard(decoder, *beats(3, Signing(KEY, stamp=signing.stamp - STALE), compid=3))) == 3


def test_holders_of_the_key_cannot_fill_the_memory_either(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mavdiag.link.signing.STREAMS_MAX", 10)
    signing, decoder = verifier()
    for compid in range(1, 21):
        heard(decoder, *beats(1, Signing(KEY, stamp=NOW), compid))
    assert signing.refused == {Refusal.STALE: 10}


def key_file(folder: Path, content: bytes = b"correct horse\n", mode: int = 0o600) -> Path:
    path = folder / "key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


def test_a_passphrase_is_hashed_as_ground_stations_do_and_one_that_others_may_read_refused(tmp_path: Path) -> None:
    for end in (b"", b"\n", b"\r\n"):
        assert read_key(key_file(tmp_path, b"correct horse" + end)) == KEY
    for mode in (0o640, 0o604, 0o660, 0o644, 0o610):
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
