"""A telemetry log decoded record by record with the live decoder: what the arrays must find as well."""

from dataclasses import dataclass
from functools import cache

from mavdiag.link.codec import Decoder, Frame, next_marker
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import IMU_MESSAGES, PROFILES
from mavdiag.link.samples import SampleDecoder
from mavdiag.link.sequence import LinkCount

STAMP_BYTES, LATEST_US = 8, 1 << 52


@dataclass(frozen=True)
class Framewise:
    frames: list[Frame]
    records: int
    damaged_bytes: int
    senders: dict[tuple[int, int], LinkCount]
    trailing_bytes: int


@cache
def wanted() -> frozenset[int]:
    every = (SampleDecoder(profile).wanted for profile in PROFILES.values())
    return frozenset({*IMU_MESSAGES, MessageId.PARAM_VALUE}).union(*every)


def decode_framewise(data: bytes) -> Framewise:
    decoder, frames = Decoder(wanted(), gap=STAMP_BYTES), list[Frame]()
    at, end, records, damaged, sound_end = 0, len(data), 0, 0, 0
    while at < end:
        begin = at + STAMP_BYTES
        time_us = int.from_bytes(data[at:begin], "big")
        after = decoder.take(data, begin, time_us * 1000, frames) if begin < end and time_us < LATEST_US else 0
        if after <= begin:
            after = max(at + 1, next_marker(data, begin + 1) - STAMP_BYTES) if begin < end else end
            damaged += after - at
        else:
            records, sound_end = records + 1, after
        at = after
    return Framewise(frames, records, damaged, dict(decoder.senders), end - sound_end)
