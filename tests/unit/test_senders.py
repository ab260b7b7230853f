"""Who is heard on a link, from where, and what made-up senders cost."""

import tracemalloc

import numpy as np
import pytest

from mavdiag.link.codec import Decoder, Encoder
from mavdiag.link.messages import Autopilot, MavType, MessageId
from mavdiag.link.profiles import PROFILES
from mavdiag.link.sequence import FRAME, HEARD, SENDERS_MAX, Intruder, Senders, Source
from mavdiag.link.vehicles import VEHICLES_MAX, LinkDecoder

S = 1_000_000_000
HERE, THERE = ("10.0.0.1", 14550), ("10.0.0.66", 4444)
KEY = 1 << 8 | 1


def heard(senders: Senders, key: int, seq: int, host_ns: int, source: Source) -> bool:
    """Whether a frame of a sender is heard."""
    row = np.zeros(1, FRAME)
    row["sender"], row["seq"], row["host_ns"], row["source"] = key, seq, host_ns, senders.numbers([source])[0]
    senders.hear(np.frombuffer(bytes(2), np.uint8), row)
    return bool(row["heard"][0] == HEARD)


def beat(encoder: Encoder, kind: MavType = MavType.QUADROTOR) -> bytes:
    return encoder.encode(MessageId.HEARTBEAT, kind, Autopilot.ARDUPILOTMEGA, 128, 0, 4, 3)


def second(encoder: Encoder, k: int) -> list[tuple[bytes, int]]:
    """One second of a vehicle, a datagram each."""
    frames = [beat(encoder)]
    for j in range(20):
        frames.append(encoder.encode(MessageId.ATTITUDE_TARGET, 1000 * k + 50 * j, 0, (1.0, 0, 0, 0), 0, 0, 0, 0.5))
        frames.append(encoder.encode(MessageId.RAW_IMU, 1000 * (1000 * k + 50 * j), 0, 0, -1000, 1, 2, 3))
    return [(frame, k * S + n * S // 50) for n, frame in enumerate(frames)]


def test_a_second_source_is_not_heard_while_the_first_is_alive() -> None:
    senders = Senders()
    assert heard(senders, KEY, 0, 0, HERE)
    assert not heard(senders, KEY, 1, S, THERE)
    assert heard(senders, KEY, 1, 2 * S, HERE)
    assert not heard(senders, KEY, 2, 4 * S, THERE)
    count = senders.count(KEY)
    assert count is not None
    assert (senders.source(KEY), senders.intruder(KEY), count.received) == (HERE, Intruder(THERE, 2), 2)


def test_senders_are_bounded_and_those_that_sent_most_stay() -> None:
    senders = Senders()
    senders.keep(7 << 8 | 1)
    heard(senders, 7 << 8 | 1, 0, 0, HERE)
    for k in range(50):
        heard(senders, KEY, k, k, HERE)
    for key in range(65_536):
        if key != KEY:
            heard(senders, key, 0, 0, THERE)
        assert len(senders) <= SENDERS_MAX
    genuine = senders.count(KEY)
    assert genuine is not None
    assert (genuine.received, senders.source(7 << 8 | 1)) == (50, HERE)


@pytest.mark.parametrize(
    ("numbers", "sound"),
    [
        ([0], False),
        ([0, 1], False),
        ([255, 0, 1], True),
        ([0, 0, 0], False),
        ([5, 7, 8, 9], False),
        ([5, 7, *range(8, 16)], True),
        ([9, 3, 200, 77, 78], False),
    ],
)
def test_running_numbers_of_one_sender_follow_on(numbers: list[int], sound: bool) -> None:
    senders = Senders()
    assert all(heard(senders, KEY, seq, 0, HERE) for seq in numbers)
    assert senders.sound(KEY) is sound


def test_made_up_senders_and_unknown_ids_cost_bounded_memory() -> None:
    decoder, link = Decoder(), LinkDecoder(careful=True)
    frames = [beat(Encoder(sysid, compid)) for sysid in range(1, 256) for compid in range(1, 256)]
    ids = [(70_000 + k).to_bytes(3, "little") for k in range(50_000)]
    unknown = [b"\xfd\x01\x00\x00" + bytes([k & 0xFF, 9, 1]) + one + b"xyz" for k, one in enumerate(ids)]
    for warm in (frames[:2000], unknown[:2000]):
        for frame in warm:
            decoder.feed_datagram(frame, 0)
            link.feed([(frame, 0)], 0, [THERE])
    flood = [(frame, k) for k, frame in enumerate((*frames, *unknown))]
    tracemalloc.start()
    for k in range(0, len(flood), 100):
        decoder.take_datagrams(flood[k : k + 100])
    link.feed([(frame, 0) for frame in frames], S, [THERE] * len(frames))
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert grown < 3e6
    assert decoder.records == 52_000 + len(frames) + 2000
    assert len(decoder.senders) <= SENDERS_MAX
    assert not link.vehicles


def test_a_careful_decoder_wants_two_heartbeats_of_one_sender() -> None:
    link, encoder = LinkDecoder(careful=True), Encoder(1, 1)
    for k in range(3):
        chunks = second(encoder, k)
        link.feed(chunks, chunks[-1][1], [HERE] * len(chunks))
        assert bool(link.vehicles) is (k > 0)
    assert link.source(1) == HERE
    assert link.heard_since(2 * S) == [1]
    assert link.heard_since(30 * S) == []


def test_a_link_takes_so_many_vehicles_and_says_so() -> None:
    link = LinkDecoder(PROFILES["ardupilot"], careful=True)
    encoders = [Encoder(sysid, 1) for sysid in range(1, 141)]
    for k in range(3):
        data = [(beat(one), k * S) for one in encoders]
        link.feed(data, k * S, [HERE] * len(data))
    assert len(link.vehicles) == VEHICLES_MAX
    assert set(link.waiting.values()) == {"there are 128 vehicles already (max_vehicles)"}
    assert all(not one.frames for one in link._waiting.values())
