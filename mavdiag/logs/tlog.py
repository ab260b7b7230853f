"""Telemetry logs as ground stations write them: for each frame its time of arrival and its bytes.

A record is the time in microseconds since 1970, 8 bytes, most significant first, and one MAVLink frame. There is no
header and no checksum of the whole: damage is skipped, frame by frame, and counted.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mavdiag.errors import InputError
from mavdiag.link.codec import Decoder, Frame, field_index, next_marker
from mavdiag.link.messages import Autopilot, Component, MavType, MessageId
from mavdiag.link.profiles import PROFILES, detect_profile, profile_named
from mavdiag.link.samples import Converter, SampleState, by_vehicle
from mavdiag.link.sequence import LinkCount
from mavdiag.logs.log import Log, read_bytes, sha256_of

__all__ = ["TlogContent", "decode_tlog", "read_tlog", "tlog_record"]

STAMP_BYTES = 8
NS_PER_US = 1_000
LATEST_US = 1 << 52  # year 2112: a later stamp is damage, whatever follows it
DAMAGED_SHARE = 0.5  # of the bytes: beyond it there is no telling what was lost (our choice)

_TYPE, _AUTOPILOT = (field_index(MessageId.HEARTBEAT, name) for name in ("type", "autopilot"))
_WANTED = frozenset().union(*(Converter(profile).wanted for profile in PROFILES.values()))


@dataclass(frozen=True, slots=True, eq=False)
class TlogContent:
    """What a telemetry log holds. frames: those that a profile listens to, of all senders; Frame.host_ns is unix time.

    records: sound frames of any kind. damaged_bytes: what is in no sound record. senders: figures by (system id,
    component id).
    """

    frames: list[Frame]
    records: int
    damaged_bytes: int
    senders: Mapping[tuple[int, int], LinkCount]


def tlog_record(time_us: int, frame: bytes) -> bytes:
    """The bytes of one record, for a recorder. time_us: since 1970."""
    return time_us.to_bytes(STAMP_BYTES, "big") + frame


def decode_tlog(data: bytes) -> TlogContent:
    """The frames of a telemetry log. Never raises: what is damaged is skipped and counted."""
    decoder = Decoder(_WANTED, gap=STAMP_BYTES)
    take, stamp = decoder.take, int.from_bytes
    frames: list[Frame] = []
    at, end, records, damaged = 0, len(data), 0, 0
    while at < end:
        begin = at + STAMP_BYTES
        time_us = stamp(data[at:begin])
        after = take(data, begin, time_us * NS_PER_US, frames) if begin < end and time_us < LATEST_US else 0
        if after <= begin:
            after = max(at + 1, next_marker(data, begin + 1) - STAMP_BYTES) if begin < end else end
            damaged += after - at
        else:
            records += 1
        at = after
    return TlogContent(frames, records, damaged, decoder.senders)


def read_tlog(path: Path, vehicle: int | None = None, profile: str | None = None) -> Log:
    """Read one vehicle's flight from a telemetry log.

    vehicle: its system id; None takes the only one that has an autopilot. profile: name of the link profile; None
    infers it from the messages. Raises InputError if the file is not such a log, is damaged beyond use, or holds no
    vehicle or several; UsageError for an unknown profile.
    """
    data = read_bytes(path)
    content = decode_tlog(data)
    if content.records == 0:
        raise InputError(f"{path}: no MAVLink frame found; not a telemetry log")
    if content.damaged_bytes > DAMAGED_SHARE * len(data):
        share = round(100 * content.damaged_bytes / len(data))
        raise InputError(f"{path}: {share} % of the file is damaged; get a sound copy")
    vehicles = by_vehicle(content.frames)
    sysid = _only_vehicle(path, vehicles) if vehicle is None else vehicle
    if sysid not in vehicles:
        raise InputError(f"{path}: nothing from vehicle {sysid}; there is {_names(vehicles) or 'none'}")
    frames = vehicles[sysid]
    chosen = profile_named(profile or detect_profile(frames))
    _, telemetry = Converter(chosen).step(SampleState(), frames)
    return Log(path.name, sha256_of(data), chosen.name, telemetry, frames[0].host_ns)


def _only_vehicle(path: Path, vehicles: Mapping[int, Sequence[Frame]]) -> int:
    flying = [sysid for sysid, frames in vehicles.items() if any(_from_autopilot(frame) for frame in frames)]
    if not flying:
        raise InputError(f"{path}: no autopilot's heartbeat in the log; name the vehicle if there is one")
    if len(flying) > 1:
        raise InputError(f"{path}: holds the vehicles {_names(flying)}; choose one with --vehicle")
    return flying[0]


def _from_autopilot(frame: Frame) -> bool:
    return (
        frame.msgid == MessageId.HEARTBEAT
        and frame.compid == Component.AUTOPILOT1
        and frame.fields[_AUTOPILOT] != Autopilot.INVALID
        and frame.fields[_TYPE] not in (MavType.GCS, MavType.ONBOARD_CONTROLLER)
    )


def _names(sysids: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(sysids)))
