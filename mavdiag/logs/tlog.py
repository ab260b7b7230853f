"""Telemetry logs as ground stations write them: for each frame its time of arrival and its bytes.

A record is the time in microseconds since 1970, 8 bytes, most significant first, and one MAVLink frame. There is no
header and no checksum of the whole: damage is skipped, frame by frame, and counted.

A file is read in windows, and each window decoded as a whole by the decoder of live links.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from mavdiag.airframe.vehicle_type import refusal
from mavdiag.errors import InputError
from mavdiag.link.codec import STAMP_BYTES, Decoder, Frame, Frames
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import IMU_MESSAGES, PROFILES, Profile, beats_of, detect_profile, profile_named, with_imu
from mavdiag.link.samples import SampleDecoder, SampleState, joined
from mavdiag.link.sequence import LinkCount
from mavdiag.link.vehicles import parameters_in
from mavdiag.logs.log import TLOG_BYTES, WINDOW_BYTES, LogKind, windows_of
from mavdiag.telemetry import Log, Telemetry

DAMAGED_SHARE = 0.5  # of the bytes: beyond it what was lost is not known (our choice)

_WANTED = frozenset({*IMU_MESSAGES, MessageId.PARAM_VALUE}).union(
    *(SampleDecoder(profile).wanted for profile in PROFILES.values())
)


@dataclass(frozen=True, slots=True, eq=False)
class TlogContent:
    """What a telemetry log holds.

    pieces: the frames that any profile reads, and parameters, of all senders, in order of arrival; times are unix time.
    size: bytes of the file.
    sha256: of the file, hexadecimal; empty where there is none.
    records: sound frames of any kind.
    damaged_bytes: what is in no sound record.
    senders: figures by (system id, component id).
    trailing_bytes: how many of those stand behind the last sound record.
    """

    pieces: tuple[Frames, ...]
    size: int
    sha256: str
    records: int
    damaged_bytes: int
    senders: Mapping[tuple[int, int], LinkCount]
    trailing_bytes: int

    @property
    def frames(self) -> list[Frame]:
        """The frames one by one; Frame.host_ns is unix time."""
        return [frame for piece in self.pieces for frame in piece]

    @property
    def heard(self) -> dict[int, int]:
        """When the first frame of each system id came [ns]."""
        first: dict[int, int] = {}
        for piece in self.pieces:
            for sysid, own in piece.by_sysid().items():
                first.setdefault(sysid, int(own.rows["host_ns"][0]))
        return first

    @property
    def mav_types(self) -> dict[int, int]:
        """MAV_TYPE of each system id that has an autopilot, by most of its heartbeats."""
        told: dict[int, Counter[int]] = {}
        for piece in self.pieces:
            for sysid, own in piece.of(MessageId.HEARTBEAT).by_sysid().items():
                for (kind, _), count in beats_of(own).items():
                    told.setdefault(sysid, Counter())[kind] += count
        return {sysid: types.most_common(1)[0][0] for sysid, types in told.items() if types}

    @property
    def flying(self) -> list[int]:
        """System ids of multirotors, by their autopilots' heartbeats; of any vehicles where there is no multirotor."""
        types = self.mav_types
        return [sysid for sysid, kind in types.items() if not refusal(kind)] or list(types)

    @property
    def span_ns(self) -> int:
        """Time from the earliest frame to the latest [ns]."""
        times = [piece.rows["host_ns"] for piece in self.pieces if len(piece)]
        return max(int(span.max()) for span in times) - min(int(span.min()) for span in times) if times else 0

    @property
    def notes(self) -> tuple[str, ...]:
        """What is wrong with the file, one sentence each."""
        inner = self.damaged_bytes - self.trailing_bytes
        damaged = f"{inner} bytes are damaged and were skipped" if inner else ""
        cut = f"it ends within a record, {self.trailing_bytes} bytes are lost: the recording was cut off"
        return tuple(note for note in (damaged, cut if self.trailing_bytes else "") if note)


class VehicleLog(NamedTuple):
    """One vehicle of a file.

    vehicle: its system id.
    log: its flight.
    """

    vehicle: int
    log: Log


def tlog_record(time_us: int, frame: bytes) -> bytes:
    """The bytes of one record, for a recorder. time_us: since 1970."""
    return time_us.to_bytes(STAMP_BYTES, "big") + frame


def decode_tlog(data: bytes) -> TlogContent:
    """What the bytes of a telemetry log hold. Never raises: what is damaged is skipped and counted."""
    return decode_windows(data[at : at + WINDOW_BYTES] for at in range(0, len(data), WINDOW_BYTES))


def read_content(path: Path) -> TlogContent:
    """What a telemetry log holds. Raises InputError if it cannot be read or is empty."""
    digest = hashlib.sha256()

    def summed() -> Iterator[bytes]:
        for window in windows_of(path, most=TLOG_BYTES):
            digest.update(window)
            yield window

    return replace(decode_windows(summed()), sha256=digest.hexdigest())


def decode_windows(windows: Iterable[bytes]) -> TlogContent:
    """As `decode_tlog`, for a log that comes in windows, wherever they cut it."""
    decoder = Decoder(_WANTED, stamped=True)
    pieces = [decoder.take_stream(window) for window in windows]
    pieces.append(decoder.take_stream(b"", last=True))
    lost = decoder.size - decoder.sound_end
    return TlogContent(tuple(pieces), decoder.size, "", decoder.records, decoder.garbage_bytes, decoder.senders, lost)


def read_tlog(path: Path, vehicle: int | None = None, profile: str | None = None) -> Log:
    """Read one vehicle's flight from a telemetry log.

    vehicle: its system id; None takes the only multirotor that has an autopilot. profile: name of the link profile;
    None recognises it by the messages. Raises InputError if the file is not such a log, is damaged beyond use, holds no
    multirotor or several, or does not show its profile; UsageError for an unknown profile.
    """

    def chosen(content: TlogContent) -> list[int]:
        heard, flying = content.heard, content.flying if vehicle is None else [vehicle]
        if not flying:
            raise InputError(f"{path}: no autopilot's heartbeat in the log; name the vehicle if there is one")
        if len(flying) > 1:
            each = "choose one with --vehicle (in Python, mavdiag.vehicle_stream reads each of them)"
            raise InputError(f"{path}: holds the vehicles {_names(flying)}; {each}")
        if flying[0] not in heard:
            raise InputError(f"{path}: nothing from vehicle {flying[0]}; there is {_names(heard) or 'none'}")
        return flying

    return next(_flights(path, profile, chosen)).log


def vehicle_stream(path: str | Path, profile: str | None = None) -> Iterator[VehicleLog]:
    """The flight of each vehicle in a telemetry log, one after the other, by rising system id; the file is read once.

    A vehicle is what sends the heartbeats of a multirotor's autopilot. The logs are as `read_tlog` gives them, but
    their names end with the vehicle where there are several: "flight.tlog vehicle 7". profile: name of the link profile
    of all; None recognises that of each. Raises as `read_tlog` does; for a vehicle whose profile is not clear when its
    turn comes.
    """

    path = Path(path)

    def chosen(content: TlogContent) -> list[int]:
        if not content.flying:
            raise InputError(f"{path}: no autopilot's heartbeat in the log")
        return sorted(content.flying)

    return _flights(path, profile, chosen)


def _flights(path: Path, profile: str | None, choose: Callable[[TlogContent], list[int]]) -> Iterator[VehicleLog]:
    """The flights of the vehicles that are chosen. What was decoded is given up as the last one is converted."""
    content = _usable(path)
    sysids, heard, types, pieces = choose(content), content.heard, content.mav_types, list(content.pieces)
    if refused := next((text for sysid in sysids if (text := refusal(types.get(sysid)))), ""):
        raise InputError(f"{path}: {refused}")
    left_out = tuple(f"vehicle {sysid} is left out: {text}" for sysid, kind in types.items() if (text := refusal(kind)))
    named = [frame for piece in pieces for frame in piece.of(MessageId.PARAM_VALUE)]
    content = replace(content, pieces=())
    for sysid in sysids:
        own = [piece.where(piece.rows["sender"] >> 8 == sysid) for piece in pieces]
        if sysid == sysids[-1]:
            pieces.clear()
        known, why = detect_profile(own) if profile is None else (profile_named(profile), "")
        if known is None:
            raise InputError(f"{path}: vehicle {sysid}: {why}")
        parameters = parameters_in((frame for frame in named if frame.sysid == sysid), known.autopilot)
        name = path.name if len(sysids) == 1 else f"{path.name} vehicle {sysid}"
        telemetry = _converted(own, known)
        notes, kind = (*content.notes, *left_out), types.get(sysid)
        log = Log(
            name, content.sha256, known.name, telemetry, heard[sysid], notes, parameters, mav_type=kind, vehicle=sysid
        )
        yield VehicleLog(sysid, log)


def _converted(pieces: list[Frames], profile: Profile) -> Telemetry:
    """The telemetry of one vehicle; uses the pieces up."""
    counts = sum((piece.counts() for piece in pieces), Counter[int]())
    decoder = SampleDecoder(with_imu(profile, counts))

    def converted() -> Iterator[Telemetry]:
        state = SampleState()
        pieces.reverse()
        while pieces:
            state, telemetry = decoder.step(state, pieces.pop())
            yield telemetry

    return joined(converted())


def _usable(path: Path) -> TlogContent:
    content = read_content(path)
    if content.records == 0:
        raise InputError(f"{path}: no MAVLink frame found; not a telemetry log")
    if content.damaged_bytes > DAMAGED_SHARE * content.size:
        share = round(100 * content.damaged_bytes / content.size)
        raise InputError(f"{path}: {share} % of the file is damaged; get a sound copy")
    return content


def _names(sysids: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(sysids)))


# Last of all kinds: the weakest signature, a MAVLink marker after the first time stamp, or soon after damage.
KIND = LogKind("tlog", lambda head: b"\xfd" in head or b"\xfe" in head, read_tlog)
