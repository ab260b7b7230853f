"""Telemetry logs as ground stations write them: for each frame its time of arrival and its bytes.

A record is the time in microseconds since 1970, 8 bytes, most significant first, and one MAVLink frame. There is no
header and no checksum of the whole: damage is skipped, frame by frame, and counted. A file is read twice, in windows:
to find its frames and whose they are, and to convert those of a vehicle.
"""

import hashlib
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, compress, repeat
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdiag.airframe.vehicle_type import refusal
from mavdiag.errors import InputError
from mavdiag.link.clock import LEAPS
from mavdiag.link.codec import AUTOPILOT, STAMP_BYTES, Decoder, Frames
from mavdiag.link.messages import MessageId
from mavdiag.link.parameters import parameters_in
from mavdiag.link.profiles import IMU_MESSAGES, PROFILES, Evidence, detect_profile, profile_named
from mavdiag.link.samples import SampleDecoder, joined
from mavdiag.link.sequence import FRAME, PLAIN, LinkCount
from mavdiag.link.vehicles import VehicleStream
from mavdiag.logs.log import TLOG_BYTES, LogKind, windows_of
from mavdiag.storage import Column, forget, open_regular
from mavdiag.telemetry import EARLIEST_NS, Log, Telemetry

PIECE_BYTES = 8 << 20  # of a file that is read at a time, of a longer one half: 5 min at 100 Hz (our choice)
CLASHING = 0.01  # of the frames: more are no damage (our choice)
DAMAGED_SHARE = 0.5  # of the bytes: beyond it what was lost is not known (our choice)

_WANTED = frozenset({*IMU_MESSAGES, MessageId.PARAM_VALUE}).union(
    *(SampleDecoder(profile).wanted for profile in PROFILES.values())
)


class _Piece(NamedTuple):
    """Frames of a log, without the bytes that they lie in: where these begin, and how many they are."""

    rows: NDArray[np.void]  # `FRAME`, whose places are counted from there
    at: int
    size: int


@dataclass(frozen=True, slots=True, eq=False)
class TlogContent:
    """What a telemetry log holds."""

    pieces: list[_Piece]  # frames that any profile reads, of all senders, in order
    systems: Mapping[int, Evidence]  # by system id
    span_ns: int  # from the earliest of these frames to the latest
    size: int  # bytes of the file
    records: int  # sound frames of any kind
    damaged_bytes: int  # what is in no sound record
    senders: Mapping[tuple[int, int], LinkCount]  # figures by (system id, component id)
    trailing_bytes: int  # how many of the damaged ones stand behind the last sound record

    @property
    def mav_types(self) -> dict[int, int]:
        """MAV_TYPE of each system id that has an autopilot, by most of its heartbeats."""
        types = {sysid: system.mav_type for sysid, system in self.systems.items()}
        return {sysid: kind for sysid, kind in types.items() if kind is not None}

    @property
    def flying(self) -> list[int]:
        """System ids of multirotors, by their autopilots' heartbeats; of any vehicles where there is no multirotor."""
        types = self.mav_types
        return sorted(sysid for sysid, kind in types.items() if not refusal(kind)) or sorted(types)

    @property
    def notes(self) -> tuple[str, ...]:
        """What is wrong with the file, one sentence each."""
        damaged = f"{(inner := self.damaged_bytes - self.trailing_bytes)} bytes are damaged and were skipped"
        cut = f"it ends within a record, {self.trailing_bytes} bytes are lost: the recording was cut off"
        pilots = (one for (_, component), one in self.senders.items() if component == AUTOPILOT)
        two = max(((one.clashes + one.restarts) / one.received for one in pilots), default=0.0)
        both = f"numbers of {100 * two:.0f} % of the frames clash: two vehicles of one id, or two links, are in it"
        return tuple(compress((damaged, both, cut), (inner, two > CLASHING, self.trailing_bytes)))


def tlog_record(time_us: int, frame: bytes) -> bytes:
    """The bytes of one record, for a recorder. time_us: since 1970."""
    return time_us.to_bytes(STAMP_BYTES, "big") + frame


def decode_tlog(windows: Iterable[bytes]) -> TlogContent:
    """What the bytes of a telemetry log hold, which come in windows, wherever these cut it.

    Never raises by itself: what is damaged is skipped and counted.
    """
    decoder = Decoder(_WANTED, stamped=True)
    systems = defaultdict[int, Evidence](Evidence)
    seen_ns, kept, places = list[int](), Column(np.empty(0, PLAIN)), list[tuple[int, int, int]]()
    for window, last in chain(zip(windows, repeat(False)), ((b"", True),)):
        at, frames = decoder.size, decoder.feed(window, last=last)
        if not len(frames):
            continue
        for sysid in np.flatnonzero(np.bincount(frames.rows["sender"] >> 8)).tolist():
            systems[sysid].take(_of_system(frames, sysid))
        seen_ns += [int(frames.rows["host_ns"].min()), int(frames.rows["host_ns"].max())]
        kept.add(frames.rows.view(PLAIN))
        places.append((len(frames), at, len(frames.data)))
    cut = np.split(kept.whole().view(FRAME), np.cumsum([count for count, *_ in places])[:-1])
    pieces = [_Piece(rows, at, size) for rows, (_, at, size) in zip(cut, places, strict=False)]
    span_ns = max(seen_ns, default=0) - min(seen_ns, default=0)
    totals = (decoder.size, decoder.records, decoder.garbage_bytes, decoder.senders, decoder.size - decoder.sound_end)
    return TlogContent(pieces, systems, span_ns, *totals)


def read_tlog(path: Path, vehicle: int | None = None, profile: str | None = None) -> Log:
    """Read one vehicle's flight from a telemetry log.

    vehicle: its system id; None takes the only multirotor that has an autopilot. profile: name of the link profile;
    None recognises it by the messages. Raises InputError if the file is not such a log, is damaged beyond use, holds no
    multirotor or several, or does not show its profile; UsageError for an unknown profile.
    """
    return next(_flights(path, profile, vehicle, several=False))


def vehicle_stream(path: str | Path, profile: str | None = None) -> Iterator[Log]:
    """The flight of each vehicle in a telemetry log, one after the other, by rising system id (`Log.vehicle`).

    A vehicle is what sends the heartbeats of a multirotor's autopilot. The logs are as `read_tlog` gives them, but
    their names end with the vehicle where there are several: "flight.tlog vehicle 7". profile: name of the link profile
    of all; None recognises that of each. Raises as `read_tlog` does, where a profile is unclear at its vehicle's turn.
    """
    return _flights(Path(path), profile, None, several=True)


def _flights(path: Path, profile: str | None, vehicle: int | None, *, several: bool) -> Iterator[Log]:
    digest = hashlib.sha256()
    content = decode_tlog(_summed(path, digest.update))
    if content.records == 0:
        raise InputError(f"{path}: no MAVLink frame found; not a telemetry log")
    if content.damaged_bytes > DAMAGED_SHARE * content.size:
        plain, share = Decoder(()), round(100 * content.damaged_bytes / content.size)
        for window in windows_of(path, PIECE_BYTES, TLOG_BYTES):
            plain.feed(window)
        if plain.garbage_bytes <= DAMAGED_SHARE * content.size:
            raise InputError(f"{path}: its frames have no time stamps (as in MAVProxy's .raw); take its .tlog")
        raise InputError(f"{path}: {share} % of the file is damaged, or it is no telemetry log; get a sound copy")
    sysids, types = _chosen(path, content, vehicle, several=several), content.mav_types
    if refused := next((text for sysid in sysids if (text := refusal(types.get(sysid)))), ""):
        raise InputError(f"{path}: {refused}")
    left_out = tuple(f"vehicle {sysid} is left out: {text}" for sysid, kind in types.items() if (text := refusal(kind)))
    for sysid in sysids:
        system = content.systems[sysid]
        known, why = detect_profile(system) if profile is None else (profile_named(profile), "")
        if known is None:
            remedy = "name it with `mavdiag look --profile` (in Python, read_log takes a profile)"
            raise InputError(f"{path}: vehicle {sysid}: {why}; {remedy}")
        stream = VehicleStream(known)
        pieces = content.pieces if sysid == sysids[-1] else content.pieces.copy()
        parameters = parameters_in(system.parameters, known.autopilot)
        stream.state.take_parameters(parameters)
        telemetry = joined(_converted(path, pieces, sysid, stream))
        name = path.name if len(sysids) == 1 else f"{path.name} vehicle {sysid}"
        leaps = [f"{n} samples are left out: their stamps leap"] if (n := stream.state.timeline.leaps) >= LEAPS else []
        dated = ((x.t_ns[k], x.host_ns[k]) for x in telemetry for k in np.flatnonzero(x.host_ns > EARLIEST_NS)[:1])
        t_ns, host_ns = map(int, min(dated, default=(telemetry.first_ns, 0)))  # since the recorder's clock is set
        started_ns, notes = host_ns - (t_ns - telemetry.first_ns), (*content.notes, *left_out, *leaps)
        named = (name, digest.hexdigest(), known.name, telemetry, started_ns, notes, parameters)
        yield Log(*named, mav_type=types.get(sysid), vehicle=sysid)


def _chosen(path: Path, content: TlogContent, vehicle: int | None, *, several: bool) -> list[int]:
    flying = content.flying if vehicle is None else [vehicle]
    if not flying:
        remedy = "" if several else "; name the vehicle with --vehicle if there is one"
        raise InputError(f"{path}: no autopilot's heartbeat in the log{remedy}")
    if len(flying) > 1 and not several:
        each = "choose one with --vehicle (in Python, mavdiag.vehicle_stream reads each of them)"
        raise InputError(f"{path}: holds the vehicles {_names(flying)}; {each}")
    if flying[0] not in content.systems:
        raise InputError(f"{path}: nothing from vehicle {flying[0]}; there is {_names(content.systems) or 'none'}")
    return flying


def _summed(path: Path, update: Callable[[bytes], None]) -> Iterator[bytes]:
    with open_regular(path, TLOG_BYTES) as file:
        size = PIECE_BYTES if os.fstat(file.fileno()).st_size <= PIECE_BYTES else PIECE_BYTES // 2
    for window in windows_of(path, size, TLOG_BYTES):
        update(window)
        yield window


def _converted(path: Path, pieces: list[_Piece], sysid: int, stream: VehicleStream) -> Iterator[Telemetry]:
    """The telemetry of one vehicle, piece by piece; uses the pieces up."""
    pieces.reverse()
    with open_regular(path, TLOG_BYTES) as file:
        while pieces:
            rows, at, size = pieces.pop()
            file.seek(at)
            data = np.frombuffer(file.read(size), np.uint8)
            if len(data) < size:
                raise InputError(f"{path}: it became shorter while it was read; read it again")
            own = _of_system(Frames(data, rows), sysid)
            forget(rows)
            yield from stream.take_log(own)


def _of_system(frames: Frames, sysid: int) -> Frames:
    own = frames.rows["sender"] >> 8 == sysid
    # what lies in a file is copied, too: compiled functions take what can be written to
    return frames if own.all() and frames.rows.flags.writeable else frames.where(own)


def _names(sysids: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(sysids)))


def _recognise(head: bytes) -> bool:
    """Whether a marker of MAVLink stands behind a time stamp at its beginning, or a sound frame behind damage."""
    stamped = head[:1] == b"\0" and head[STAMP_BYTES : STAMP_BYTES + 1] in (b"\xfd", b"\xfe")
    return stamped or len(Decoder().feed(head, last=True)) > 0


KIND = LogKind("tlog", _recognise, read_tlog)
