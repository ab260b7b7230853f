"""Whatever bytes come over the wire, the fleet neither raises nor says more than it may."""

import struct
from collections.abc import Callable

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
from fastcrc.crc16 import mcrf4xx
from hypothesis import given, settings
from hypothesis import strategies as st
from made_session import baseline_for
from made_vehicle import MadeVehicle

from detector.config import SessionSettings
from detector.fleet import Fleet
from detector.values import SendText, SessionSpec
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import PROFILES, Profile
from mavdiag.link.samples import sources
from mavdiag.telemetry import Instant

TICK_NS = 40_000_000
COMMANDS = {MessageId.COMMAND_ACK, MessageId.COMMAND_LONG, MessageId.COMMAND_INT}
HEARD = COMMANDS | {source.message for profile in PROFILES.values() for source in sources(profile)}
MESSAGES = sorted(int(message) for message in HEARD if message in dialect.mavlink_map)


def wild(sysid: int, compid: int, rng: np.random.Generator, messages: list[int] = MESSAGES) -> bytes:
    """A frame with a good checksum and any content: noise, or all bytes alike (zeros, -1, NaN, infinities, ...)."""
    message = dialect.mavlink_map[int(rng.choice(messages))]
    size = message.unpacker.size
    one = bytes([int(rng.choice([0x00, 0x01, 0x7F, 0x80, 0xFF]))])
    payload = rng.bytes(size) if rng.random() < 0.5 else one * size
    if messages is not MESSAGES:  # often to the autopilot or the detector of vehicle 1
        payload = bytes(rng.choice([0, 1, 1, 27, 191, 191, 255], size).tolist())
    number = message.id
    seq = int(rng.integers(256))
    body = struct.pack("<BBBBBBHB", size, 0, 0, seq, sysid, compid, number & 0xFFFF, number >> 16) + payload
    return b"\xfd" + body + mcrf4xx(bytes([message.crc_extra]), mcrf4xx(body)).to_bytes(2, "little")


def fleet(datagrams: bool, spec_of: Callable[[int, Profile], SessionSpec]) -> Fleet:
    return Fleet(spec_of, profile=None, only=None, datagrams=datagrams)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), datagrams=st.booleans(), learning=st.booleans())
def test_wild_frames_and_garbage_are_survived(seed: int, datagrams: bool, learning: bool) -> None:
    rng = np.random.default_rng(seed)
    baseline = None if learning else baseline_for()
    one = fleet(datagrams, lambda sysid, profile: SessionSpec(profile, baseline, SessionSettings(learn=2.0)))
    vehicle, other = MadeVehicle(1), (int(rng.integers(0, 256)), int(rng.choice([1, 191])))
    now = Instant(10**12)
    for _ in range(150):
        frames = vehicle.samples(4)
        for _ in range(int(rng.integers(0, 3))):
            sender = (1, 1) if rng.random() < 0.3 else other
            frames.insert(int(rng.integers(0, 5)), wild(*sender, rng))
        if rng.random() < 0.3:
            frames.insert(int(rng.integers(0, 5)), rng.bytes(int(rng.integers(0, 300))))
        now = Instant(now.ns + TICK_NS)
        one.take([(frame, now.ns) for frame in frames], now)
        for turn in one.judge(now):
            for effect in turn.effects:
                assert not isinstance(effect, SendText) or 0 < len(effect.text.encode()) <= 50
    one.finish(now)
    if 1 not in one.vehicles:  # wild heartbeats of its own id came between all of its own
        assert "does another vehicle use this system id" in one.link.waiting[1]
