"""MAVLink 2 signing, against pymavlink's signer and verifier, a vector made by hand, and what an attacker does."""

import hashlib

import pymavlink.dialects.v20.ardupilotmega as dialect

from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.messages import MessageId
from mavdiag.link.signing import Refusal, Signing, stamp_at

KEY = hashlib.sha256(b"correct horse").digest()
NOW_NS = 1_800_000_000 * 1_000_000_000
NOW = stamp_at(NOW_NS)
HEARTBEAT = (2, 3, 0, 0, 4, 3)


def peer(key: bytes = KEY, stamp: int = NOW, link_id: int = 0) -> dialect.MAVLink:
    """pymavlink, signing with a key and checking by it."""
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.robust_parsing = True
    mav.signing.secret_key, mav.signing.sign_outgoing = key, True
    mav.signing.timestamp, mav.signing.link_id = stamp, link_id
    return mav


def beat(mav: dialect.MAVLink) -> bytes:
    """pymavlink's next heartbeat."""
    packed = bytes(dialect.mavlink_map[0](*HEARTBEAT).pack(mav))
    mav.seq = (mav.seq + 1) % 256
    return packed


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


def test_what_pymavlink_signs_we_accept() -> None:
    (signing, decoder), mav = verifier(), peer(link_id=9)
    assert [frame.seq for frame in heard(decoder, *(beat(mav) for _ in range(300)))] == [k % 256 for k in range(300)]
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


def test_a_replayed_copy_is_neither_heard_nor_passed_on() -> None:
    passed: list[tuple[bytes, int]] = []
    signing = Signing(KEY, stamp=NOW)
    decoder = Decoder(signing=signing, passed=passed)
    unsigned = Encoder(1, 1).encode(MessageId.HEARTBEAT, *HEARTBEAT)
    first, second = beats(2, Signing(KEY, stamp=NOW))
    assert len(heard(decoder, unsigned, first, second, first, second)) == 2
    assert passed == [(first, 0), (second, 0)]
    assert signing.refused == {Refusal.UNSIGNED: 1, Refusal.REPLAYED: 2}
