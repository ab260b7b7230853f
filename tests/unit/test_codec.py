"""The codec against pymavlink's own MAVLink class, which packs and parses the same bytes both ways."""

import struct

import pymavlink.dialects.v20.ardupilotmega as dialect
import pytest

from mavdiag.errors import UsageError
from mavdiag.link.codec import (
    UNKNOWN,
    Decoder,
    Encoder,
    Frame,
    decode_statustext,
    field_index,
    layout_of,
    message_name,
)
from mavdiag.link.layout import FieldValue, defined
from mavdiag.link.messages import MessageId, Severity

HEARTBEAT = (2, 3, 128, 0, 4, 3)


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


def stripped(fields: tuple[FieldValue, ...]) -> tuple[FieldValue, ...]:
    return tuple(v.rstrip(b"\0") if isinstance(v, bytes) else v for v in fields)


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


BY_VERSION = [(v, n) for v in (1, 2) for n in sorted(dialect.mavlink_map) if v == 2 or n < 256]


@pytest.mark.parametrize(("version", "number"), BY_VERSION)
def test_every_message_of_the_dialect_travels_both_ways(version: int, number: int) -> None:
    message = dialect.mavlink_map[number]
    arguments = sample_arguments(message)
    theirs = message(*arguments).pack(peer(), force_mavlink1=version == 1)
    (frame,) = Decoder().feed(theirs, 5)
    parsed = peer().parse_buffer(theirs)
    assert parsed is not None
    assert (frame.msgid, frame.sysid, frame.compid, frame.seq, frame.host_ns) == (number, 1, 1, 0, 5)
    assert stripped(frame.fields) == wire_values(parsed[0])
    if version == 2:
        encoder = Encoder(1, 1)
        assert encoder.encode(number, *arguments) == theirs  # type: ignore[arg-type]  # generic test values
        assert Encoder(1, 1).encode_payload(number, frame.payload) == theirs


@pytest.mark.parametrize(("msgid", "seed"), [(291, 10), (300, 217), (435, 134)])
def test_messages_that_pymavlink_lacks_have_the_seed_of_the_published_definition(msgid: int, seed: int) -> None:
    assert layout_of(msgid).crc_extra[0] == seed


def test_a_layout_by_definition_is_that_of_the_dialect() -> None:
    rates = [f"float body_{axis}_rate" for axis in ("roll", "pitch", "yaw")]
    fields = ["uint32_t time_boot_ms", "uint8_t type_mask", "float q[4]", *rates, "float thrust"]
    one, known = defined("ATTITUDE_TARGET", *fields), layout_of(MessageId.ATTITUDE_TARGET)
    assert (one.names, one.sizes, one.order, one.crc_extra) == (known.names, known.sizes, known.order, known.crc_extra)
    assert one.packer.size == known.packer.size


def test_a_field_is_found_by_name() -> None:
    assert field_index(MessageId.HEARTBEAT, "base_mode") == 3
    assert field_index(MessageId.ATTITUDE_TARGET, "thrust") == 8
    with pytest.raises(UsageError, match="HEARTBEAT has no field thrust"):
        field_index(MessageId.HEARTBEAT, "thrust")
    with pytest.raises(UsageError, match="54321"):
        layout_of(54321)
    assert message_name(54321) == "UNKNOWN_54321"


def test_longer_payloads_of_a_newer_definition_are_cut() -> None:
    body = bytes([30, 0, 0, 0, 1, 1, 0, 0, 0]) + bytes(range(1, 31))
    crc = dialect.x25crc(body + bytes([50])).crc
    (frame,) = Decoder().feed(b"\xfd" + body + crc.to_bytes(2, "little"), 0)
    assert frame.payload == bytes(range(1, 10))


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


def test_statustext_of_50_bytes_has_no_terminator_and_longer_is_cut_at_a_character() -> None:
    encoder = Encoder(1, 191)
    (full,) = Decoder().feed(encoder.statustext(Severity.CRITICAL, "x" * 50), 0)
    assert decode_statustext(full).text == "x" * 50
    (long,) = Decoder().feed(encoder.statustext(Severity.INFO, "x" * 49 + "é" * 9), 0)
    assert decode_statustext(long).text == "x" * 49
    assert decode_statustext(long).severity is not None
    (heartbeat,) = Decoder().feed(encoder.encode(MessageId.HEARTBEAT, *HEARTBEAT), 0)
    with pytest.raises(UsageError, match="HEARTBEAT"):
        decode_statustext(heartbeat)


def test_a_fake_header_does_not_swallow_the_frames_behind_it() -> None:
    encoder = Encoder(1, 1)
    beats = b"".join(encoder.encode(MessageId.HEARTBEAT, *HEARTBEAT) for _ in range(20))
    fake = b"\xfd\xff\x00\x00\x00\x01\x01\x00\x00\x00"  # a heartbeat of 255 bytes
    decoder = Decoder()
    assert len(decoder.feed(fake + beats, 0)) == 20
    assert decoder.count.bad_crc == 1
    assert decoder.count.garbage_bytes == len(fake)


@pytest.mark.parametrize("marker", [b"\xfd", b"\xfe\x00", b"\xfd\x00\x02"])
def test_a_stream_of_markers_costs_little_and_hides_nothing_that_comes_later(marker: bytes) -> None:
    decoder, frame = Decoder(), Encoder(1, 1).encode(MessageId.HEARTBEAT, 2, 3)
    for _ in range(10):
        assert decoder.feed(marker * (8192 // len(marker)), 0) == []
    refused = decoder.count.bad_crc + decoder.count.incompatible
    assert 0 < refused + decoder.count.unknown <= 10 * 8192 / 64
    found = [*decoder.feed(frame, 0), *decoder.feed(frame * 20, 0)]
    assert len(found) >= 20


def unknown_frame(seq: int = 0) -> bytes:
    return bytes([0xFD, 3, 0, 0, seq, 1, 1, 0x31, 0xD4, 0x00]) + b"abc" + b"??"


def test_frames_outside_the_dialect_are_taken_on_trust_only_before_another_frame() -> None:
    good = Encoder(1, 1).encode(MessageId.HEARTBEAT, *HEARTBEAT)
    decoder = Decoder()
    assert decoder.feed(unknown_frame(255), 0) == []
    assert decoder.count.unknown == 0  # not yet confirmed
    assert len(decoder.feed(good, 0)) == 1
    assert decoder.count.unknown == 1
    assert decoder.senders[1, 1].by_message == {UNKNOWN: 1, MessageId.HEARTBEAT: 1}
    assert decoder.senders[1, 1].lost == 0
    decoder = Decoder()
    assert len(decoder.feed(unknown_frame() + b"x" + good, 0)) == 1
    assert decoder.count.unknown == 0
    decoder = Decoder()
    decoder.feed_datagram(unknown_frame(), 0)
    assert decoder.count.unknown == 1


def numbered(sequence: list[int]) -> Decoder:
    """A decoder that was fed heartbeats with these sequence numbers."""
    message = dialect.mavlink_map[0](*HEARTBEAT)
    decoder = Decoder()
    frames: list[Frame] = []
    for seq in sequence:
        frames += decoder.feed(message.pack(peer(seq % 256)), 0)
    assert len(frames) == len(sequence)
    return decoder


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
def test_loss_is_counted_honestly(
    sequence: list[int], lost: int, reordered: int, duplicated: int, restarts: int
) -> None:
    count = numbered(sequence).senders[1, 1]
    assert count.received == len(sequence)
    assert (count.lost, count.reordered, count.duplicated, count.restarts) == (lost, reordered, duplicated, restarts)
