"""A telemetry log decoded record by record in plain Python: what the compiled loop must find as well."""

from dataclasses import dataclass
from functools import cache

from fastcrc.crc16 import mcrf4xx

from mavdiag.link.codec import LATEST_US, MSGIDS, STAMP_BYTES, UNKNOWN, Frame, layout_of
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import IMU_MESSAGES, PROFILES
from mavdiag.link.samples import SampleDecoder

MARKERS = (0xFE, 0xFD)


@dataclass(frozen=True)
class Framewise:
    """frames: those that are wanted. numbers: message and running number of every sound record, by sender."""

    frames: list[Frame]
    records: int
    damaged_bytes: int
    numbers: dict[tuple[int, int], list[tuple[int, int]]]
    trailing_bytes: int


@cache
def wanted() -> frozenset[int]:
    every = (SampleDecoder(profile).wanted for profile in PROFILES.values())
    return frozenset({*IMU_MESSAGES, MessageId.PARAM_VALUE}).union(*every)


def frame_at(data: bytes, at: int, host_ns: int) -> tuple[Frame, int] | None:
    """The frame that starts here and the place behind it; message `UNKNOWN` outside the dialect. None if none does."""
    new = data[at] == 0xFD
    header = data[at : at + (10 if new else 6)]
    if data[at] not in MARKERS or len(header) < (10 if new else 6) or (new and header[2] > 1):
        return None
    body = at + len(header)
    stop = body + header[1]
    after = stop + 2 + (13 if new and header[2] else 0)
    if after > len(data):
        return None
    seq, sysid, compid = header[4:7] if new else header[2:5]
    msgid = int.from_bytes(header[7:10], "little") if new else header[5]
    if msgid not in MSGIDS[:-1]:
        following = after + STAMP_BYTES
        if after != len(data) and (following >= len(data) or data[following] not in MARKERS):
            return None
        return Frame(UNKNOWN, sysid, compid, seq, b"", host_ns), after
    layout = layout_of(msgid)
    size = layout.packer.size
    if mcrf4xx(layout.crc_extra, mcrf4xx(data[at + 1 : stop])) != int.from_bytes(data[stop : stop + 2], "little"):
        return None
    return Frame(msgid, sysid, compid, seq, data[body:stop].ljust(size, b"\0")[:size], host_ns), after


def decode_framewise(data: bytes) -> Framewise:
    frames, numbers = list[Frame](), dict[tuple[int, int], list[tuple[int, int]]]()
    at, end, records, damaged, sound_end = 0, len(data), 0, 0, 0
    while at < end:
        begin = at + STAMP_BYTES
        time_us = int.from_bytes(data[at:begin], "big")
        found = frame_at(data, begin, time_us * 1000) if begin < end and time_us < LATEST_US else None
        if found is None:
            damaged, at = damaged + 1, at + 1
            continue
        frame, at = found
        records, sound_end = records + 1, at
        numbers.setdefault((frame.sysid, frame.compid), []).append((frame.msgid, frame.seq))
        frames += [frame] if frame.msgid in wanted() else []
    return Framewise(frames, records, damaged, numbers, end - sound_end)
