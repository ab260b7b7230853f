"""Laws of the decoder: nothing raises, nothing is lost to garbage, and the way a stream is cut does not matter."""

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.link.codec import Decoder, Encoder
from mavdiag.link.messages import MessageId

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


int16 = st.integers(-(2**15), 2**15 - 1)


@given(st.integers(0, 2**64 - 1), st.lists(int16, min_size=9, max_size=9), st.integers(0, 255), int16)
def test_encoding_equals_pymavlink(stamp: int, counts: list[int], number: int, temperature: int) -> None:
    fields = [stamp, *counts, number, temperature]
    theirs = dialect.mavlink_map[27](*fields).pack(dialect.MAVLink(None, 3, 4))
    assert Encoder(3, 4).encode(MessageId.RAW_IMU, *fields) == theirs
    (frame,) = Decoder().feed(theirs, 0)
    assert list(frame.fields) == fields


pieces = st.lists(st.tuples(bytes_like_frames, st.integers(0, 4 * 10**9), st.sampled_from("ab")), max_size=12)


@given(pieces)
def test_datagrams_at_once_are_heard_as_one_by_one(datagrams: list[tuple[bytes, int, str]]) -> None:
    """Whatever is in them, whenever they come, and from wherever."""
    times = np.cumsum([gap_ns for _, gap_ns, _ in datagrams]).tolist()
    chunks = [(data, at_ns) for (data, _, _), at_ns in zip(datagrams, times, strict=True)]
    sources = [source for _, _, source in datagrams]
    single, whole = Decoder(), Decoder()
    each = [frame for one in zip(chunks, sources, strict=True) for frame in single.take_datagrams([one[0]], [one[1]])]
    assert list(whole.take_datagrams(chunks, sources)) == each
    assert (whole.garbage_bytes, whole.records) == (single.garbage_bytes, single.records)
    assert whole.senders == single.senders
    for sender in single.senders:
        assert whole.heard.source(sender[0] << 8 | sender[1]) == single.heard.source(sender[0] << 8 | sender[1])
