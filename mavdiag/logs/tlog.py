"""Telemetry logs as ground stations write them: for each frame its time of arrival and its bytes.

A record is the time in microseconds since 1970, 8 bytes, most significant first, and one MAVLink frame. There is no
header and no checksum of the whole: damage is skipped, frame by frame, and counted.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mavdiag.errors import InputError
from mavdiag.link.codec import Decoder, Frame, next_marker
from mavdiag.link.messages import MessageId
from mavdiag.link.parameters import parameters_in
from mavdiag.link.profiles import (
    IMU_MESSAGES,
    PROFILES,
    detect_profile,
    is_autopilot_heartbeat,
    profile_named,
    with_imu,
)
from mavdiag.link.samples import SampleDecoder, SampleState, by_vehicle
from mavdiag.link.sequence import LinkCount
from mavdiag.logs.log import LogKind, read_bytes, sha256_of
from mavdiag.telemetry import Log
from mavdiag.units import NS_PER_US

__all__ = ["KIND", "TlogContent", "decode_tlog", "read_tlog", "tlog_record"]

STAMP_BYTES = 8
LATEST_US = 1 << 52  # year 2112: a later stamp is damage, whatever follows it
DAMAGED_SHARE = 0.5  # of the bytes: beyond it what was lost is not known (our choice)

_WANTED = frozenset({*IMU_MESSAGES, MessageId.PARAM_VALUE}).union(
    *(SampleDecoder(profile).wanted for profile in PROFILES.values())
)


@dataclass(frozen=True, slots=True, eq=False)
class TlogContent:
    """What a telemetry log holds.

    frames: those that any profile reads, and parameters, of all senders; Frame.host_ns is unix time.
    records: sound frames of any kind.
    damaged_bytes: what is in no sound record.
    senders: figures by (system id, component id).
    trailing_bytes: how many of those stand behind the last sound record.
    """

    frames: list[Frame]
    records: int
    damaged_bytes: int
    senders: Mapping[tuple[int, int], LinkCount]
    trailing_bytes: int

    @property
    def notes(self) -> tuple[str, ...]:
        """What is wrong with the file, one sentence each."""
        inner = self.damaged_bytes - self.trailing_bytes
        damaged = f"{inner} bytes are damaged and were skipped" if inner else ""
        cut = f"it ends within a record, {self.trailing_bytes} bytes are lost: the recording was cut off"
        return tuple(note for note in (damaged, cut if self.trailing_bytes else "") if note)


def tlog_record(time_us: int, frame: bytes) -> bytes:
    """The bytes of one record, for a recorder. time_us: since 1970."""
    return time_us.to_bytes(STAMP_BYTES, "big") + frame


def decode_tlog(data: bytes) -> TlogContent:
    """The frames of a telemetry log. Never raises: what is damaged is skipped and counted."""
    decoder = Decoder(_WANTED, gap=STAMP_BYTES)
    take, stamp = decoder.take, int.from_bytes
    frames: list[Frame] = []
    at, end, records, damaged, sound_end = 0, len(data), 0, 0, 0
    while at < end:
        begin = at + STAMP_BYTES
        time_us = stamp(data[at:begin])
        after = take(data, begin, time_us * NS_PER_US, frames) if begin < end and time_us < LATEST_US else 0
        if after <= begin:
            after = max(at + 1, next_marker(data, begin + 1) - STAMP_BYTES) if begin < end else end
            damaged += after - at
        else:
            records, sound_end = records + 1, after
        at = after
    return TlogContent(frames, records, damaged, decoder.senders, end - sound_end)


def read_tlog(path: Path, vehicle: int | None = None, profile: str | None = None) -> Log:
    """Read one vehicle's flight from a telemetry log.

    vehicle: its system id; None takes the only one that has an autopilot. profile: name of the link profile; None
    recognises it by the messages. Raises InputError if the file is not such a log, is damaged beyond use, holds no
    vehicle or several, or does not show its profile; UsageError for an unknown profile.
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
    recognised = detect_profile(frames)
    chosen = recognised.profile if profile is None else profile_named(profile)
    if chosen is None:
        raise InputError(f"{path}: vehicle {sysid}: {recognised.reason}")
    _, telemetry = SampleDecoder(with_imu(chosen, frames)).step(SampleState(), frames)
    parameters = parameters_in(frames, chosen.autopilot)
    return Log(path.name, sha256_of(data), chosen.name, telemetry, frames[0].host_ns, content.notes, parameters)


def _only_vehicle(path: Path, vehicles: Mapping[int, Sequence[Frame]]) -> int:
    flying = [sysid for sysid, frames in vehicles.items() if any(map(is_autopilot_heartbeat, frames))]
    if not flying:
        raise InputError(f"{path}: no autopilot's heartbeat in the log; name the vehicle if there is one")
    if len(flying) > 1:
        raise InputError(f"{path}: holds the vehicles {_names(flying)}; choose one with --vehicle")
    return flying[0]


def _names(sysids: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(sysids)))


# Last of all kinds: the weakest signature, a MAVLink marker after the first time stamp, or soon after damage.
KIND = LogKind("tlog", lambda head: b"\xfd" in head or b"\xfe" in head, read_tlog)
