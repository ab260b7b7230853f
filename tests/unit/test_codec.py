"""The codec against pymavlink's own, which packs and parses the same bytes, and its laws."""

import struct

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.errors import UsageError
from mavdiag.link.codec import UNKNOWN, Decoder, Encoder, FieldValue, layout_of
from mavdiag.link.datagrams import as_columns
from mavdiag.link.messages import MessageId

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
        encoder = Encoder(1, 1)
        assert encoder.encode(number, *arguments) == theirs  # type: ignore[arg-type]  # generic test values
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
    assert len(decoder.feed(fake + beats, 0)) == 20
    assert (decoder.records, decoder.garbage_bytes) == (20, len(fake))


def unknown_frame(seq: int = 0) -> bytes:
    return bytes([0xFD, 3, 0, 0, seq, 1, 1, 0x31, 0xD4, 0x00]) + b"abc" + b"??"


def test_frames_outside_the_dialect_are_taken_on_trust_only_before_another_frame() -> None:
    good = Encoder(1, 1).encode(MessageId.HEARTBEAT, *HEARTBEAT)
    decoder = Decoder()
    assert decoder.feed(unknown_frame(255), 0) == []
    assert decoder.records == 0  # not yet confirmed
    assert len(decoder.feed(good, 0)) == 1
    assert decoder.senders[1, 1].by_message == {UNKNOWN: 1, MessageId.HEARTBEAT: 1}
    assert decoder.senders[1, 1].lost == 0
    decoder = Decoder()
    assert len(decoder.feed(unknown_frame() + b"x" + good, 0)) == 1
    assert decoder.records == 1
    decoder = Decoder()
    decoder.feed_datagram(unknown_frame(), 0)
    assert decoder.records == 1


@pytest.mark.parametrize(
    ("sequence", "lost", "reordered", "duplicated", "restarts"),
    [
        ([*range(600)], 0, 0, 0, 0),
        ([0, 1, 3, 4, 5], 1, 0, 0, 0),
        ([0, 1, 3, 2, 4, 5], 0, 1, 0, 0),
        ([254, 256, 255, 257], 0, 1, 0, 0),
        ([0, 1, 1, 2], 0, 0, 1, 0),
        ([0, 1, 3, 2, 2, 4], 0, 1, 1, 0),
        ([*range(100), *range(200, 300)], 100, 0, 0, 0),
        ([*range(100), *range(50)], 0, 0, 0, 1),
        ([0, 4, 3, 1, 2, 5], 0, 3, 0, 0),
        ([0, 2, *range(3, 257), 257, 256 + 1], 1, 0, 1, 0),  # the gap was a whole turn ago
    ],
)
def test_losses_are_counted(sequence: list[int], lost: int, reordered: int, duplicated: int, restarts: int) -> None:
    message, decoder = dialect.mavlink_map[0](*HEARTBEAT), Decoder()
    assert [len(decoder.feed(message.pack(peer(seq % 256)), 0)) for seq in sequence] == [1] * len(sequence)
    count = decoder.senders[1, 1]
    assert count.received == len(sequence)
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
    sent = [encoder.encode(MessageId.ATTITUDE, stamp, 0.5 * k) for k in range(len(garbage))]
    decoder = Decoder()
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
    each = [frame for one in alone for frame in single.take_datagrams(one)]
    assert list(whole.take_datagrams(as_columns(chunks, sources))) == each
    assert (whole.garbage_bytes, whole.records) == (single.garbage_bytes, single.records)
    assert whole.senders == single.senders
    for sender in single.senders:
        assert whole.heard.source(sender[0] << 8 | sender[1]) == single.heard.source(sender[0] << 8 | sender[1])
