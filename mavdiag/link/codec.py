"""MAVLink 1 and 2 frames to values and back: the only module that knows pymavlink.

Fields travel sorted by size and are declared in another order; arrays lie flat; text is bytes padded with NUL.
Of pymavlink only the generated dialect is used. One compiled loop finds the frames (https://mavlink.io/en/guide/serialization.html).
It never raises on input: what is not a frame is counted, and scanning resumes right behind the false marker. Checksums
are taken eight bytes at a time by tables ("slicing by eight", Kounavis and Berry 2005).
"""

import math
import re
import struct
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import accumulate
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
from fastcrc.crc16 import mcrf4xx
from numpy.typing import NDArray

from mavdiag.errors import UsageError
from mavdiag.jit import cached_loop, inline
from mavdiag.link.datagrams import Bytes, Datagrams
from mavdiag.link.messages import Component, MessageId, Severity
from mavdiag.link.sequence import FRAME, HEARD, PLAIN, REFUSED, LinkCount, Senders
from mavdiag.link.signing import SEAL_BYTES, SIGNED_FLAG, Signing
from mavdiag.telemetry import BoolArray, IntArray
from mavdiag.units import NS_PER_US

FieldValue: TypeAlias = int | float | bytes
Argument: TypeAlias = int | float | bytes | str | Sequence[int] | Sequence[float]
Record: TypeAlias = NDArray[Any]

UNKNOWN = -1  # stands for every message id outside the dialect in `LinkCount.by_message`
TEXT_BYTES = 50  # STATUSTEXT.text; Mission Planner and MAVROS do not put longer ones together
AUTOPILOT = int(Component.AUTOPILOT1)
STAMP_BYTES = 8  # before each frame of a telemetry log: microseconds since 1970, most significant first
LATEST_US = 1 << 52  # year 2112: a later stamp is damage, whatever follows it
# What came at once is searched up to so many false markers, or one in so many bytes; the rest is garbage (our choice).
FALSE_MARKERS = 64

_V1, _V2 = 0xFE, 0xFD
_MARKER = re.compile(rb"[\xFD\xFE]")
_SHORTEST_V1, _SHORTEST_V2 = 8, 12  # header and checksum round an empty payload
_NOT_YET = -1
FLOAT32_MAX = 3.4028234663852886e38  # IEEE 754 binary32
_INTEGERS = {
    code: (-(1 << bits - 1), (1 << bits - 1) - 1) if code.islower() else (0, (1 << bits) - 1)
    for codes, bits in (("bB", 8), ("hH", 16), ("iI", 32), ("qQ", 64))
    for code in codes
}
_pack_header = struct.Struct("<BBBBBBHB").pack  # without the marker and with the message id in two parts


@dataclass(frozen=True)
class Layout:
    """One message on the wire."""

    name: str
    names: tuple[str, ...]  # fields as declared
    sizes: tuple[int, ...]  # places that each takes in a flat tuple
    order: tuple[int, ...]  # declared index of each wire field
    packer: struct.Struct
    crc_extra: bytes  # the one-byte checksum seed, different for each definition of a message

    @cached_property
    def codes(self) -> tuple[str, ...]:
        """The struct code of each place of the wire; text is one place, with its length, as in `50s`."""
        runs = re.findall(r"(\d*)([a-zA-Z])", self.packer.format)
        places = ([count + code] if code == "s" else [code] * int(count or 1) for count, code in runs)
        return tuple(code for run in places for code in run)

    def place(self, name: str) -> int:
        """Where a field, or an array's first element, is in the flat tuple. Raises UsageError if there is none."""
        if name not in self.names:
            raise UsageError(f"{self.name} has no field {name}")
        before = self.order[: self.order.index(self.names.index(name))]
        return sum(self.sizes[index] for index in before)

    def offset(self, name: str) -> tuple[int, str]:
        """At which byte of the payload a field begins, and its struct code. Raises UsageError if there is none."""
        place = self.place(name)
        return struct.calcsize("<" + "".join(self.codes[:place])), self.codes[place]

    def record_dtype(self, *columns: tuple[str, int]) -> np.dtype[np.void]:
        """How numpy reads payloads as records of some columns (field, count): so many places from the field on.

        Raises UsageError if there is no such field, or the places differ in type.
        """
        formats, offsets = [], []
        for name, count in columns:
            place, (offset, code) = self.place(name), self.offset(name)
            if set(self.codes[place : place + count]) != {code}:
                raise UsageError(f"{self.name}: {count} places from {name} on are not of one type")
            formats.append(np.dtype("<" + code) if count == 1 else np.dtype(("<" + code, count)))
            offsets.append(offset)
        names = [name for name, _ in columns]
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.packer.size})

    def pack(self, fields: Sequence[Argument]) -> bytes:
        """The payload, not trimmed, from fields in the declared order; trailing ones left out are zero.

        Integers are rounded and saturated, text is cut. Raises UsageError for too many fields, an array of the wrong
        length, or a value that its field cannot hold at all.
        """
        if len(fields) > len(self.names):
            raise UsageError(f"{self.name} has {len(self.names)} fields, not {len(fields)}")
        if len(fields) < len(self.names):
            fields = [*fields, *(0 if size == 1 else (0,) * size for size in self.sizes[len(fields) :])]
        places: list[Argument] = []
        for index in self.order:
            if self.sizes[index] == 1:
                places.append(fields[index])
            else:
                places += fields[index]  # type: ignore[arg-type]  # a scalar here raises TypeError below
        try:
            return self.packer.pack(*places)  # the common case: everything fits as it is
        except (struct.error, OverflowError):
            pass
        if len(self.codes) != len(places):
            wanted = f"{self.name} takes {len(self.codes)} values in all, not {len(places)}"
            raise UsageError(f"{wanted}: an array is too long or short")
        try:
            return self.packer.pack(*(_fit(code, place) for code, place in zip(self.codes, places, strict=True)))
        except (struct.error, TypeError, ValueError) as error:
            raise UsageError(f"{self.name}: {error}") from error


def _fit(code: str, value: Argument) -> FieldValue:
    """The nearest value that the field can hold. Raises ValueError or TypeError if there is none (a NaN integer)."""
    limits = _INTEGERS.get(code)
    if limits is not None:
        number = cast(float, value)  # anything else raises TypeError in the comparison
        return limits[0] if number < limits[0] else limits[1] if number > limits[1] else round(number)
    if code in ("f", "d"):
        number = cast(float, value)
        within = min(max(number, -FLOAT32_MAX), FLOAT32_MAX)
        return within if code == "f" and math.isfinite(number) else number
    if isinstance(value, str):
        return cut(value, int(code[:-1]))
    if isinstance(value, bytes):
        return value
    raise TypeError(f"text wanted, not {value!r}")


def cut(text: str, size: int) -> bytes:
    """The text in UTF-8 within `size` bytes, cut at a whole character."""
    return text.encode()[:size].decode(errors="ignore").encode()


_ESC = ("index", "time_usec", "rpm", "voltage", "current")
_VERSION = ("version", "min_version", "max_version", "spec_version_hash", "library_version_hash")
_BASIC = (
    "capabilities",
    "time_boot_ms",
    "time_manufacture_s",
    "vendor_name",
    "model_name",
    "software_version",
    "hardware_version",
    "serial_number",
)
_MODE = ("number_modes", "mode_index", "standard_mode", "custom_mode", "properties", "mode_name")

#: Messages of common.xml that the dialect shipped with pymavlink 2.4 leaves out, as its generator would make them.
EXTRA_LAYOUTS: Mapping[int, Layout] = {
    MessageId.ESC_STATUS: Layout(
        "ESC_STATUS", _ESC, (1, 1, 4, 4, 4), (1, 2, 3, 4, 0), struct.Struct("<Q4i4f4fB"), b"\x0a"
    ),
    MessageId.PROTOCOL_VERSION: Layout(
        "PROTOCOL_VERSION", _VERSION, (1, 1, 1, 8, 8), (0, 1, 2, 3, 4), struct.Struct("<3H8B8B"), b"\xd9"
    ),
    MessageId.COMPONENT_INFORMATION_BASIC: Layout(
        "COMPONENT_INFORMATION_BASIC", _BASIC, (1,) * 8, tuple(range(8)), struct.Struct("<Q2I32s32s24s24s32s"), b"\x32"
    ),
    MessageId.AVAILABLE_MODES: Layout(
        "AVAILABLE_MODES", _MODE, (1,) * 6, (3, 4, 0, 1, 2, 5), struct.Struct("<2I3B35s"), b"\x86"
    ),
}


class Frame(NamedTuple):
    """One received message: its number, its sender and that one's running number, and when it was received [ns]."""

    msgid: int
    sysid: int
    compid: int
    seq: int
    payload: bytes  # as on the wire, with the trimmed zeros put back and unknown extensions cut off
    host_ns: int

    @property
    def fields(self) -> tuple[FieldValue, ...]:
        """The values, flat, in the order of the wire; an array takes one place per element (see `field_index`)."""
        return _LAYOUTS[self.msgid].packer.unpack(self.payload)

    def value(self, name: str) -> Any:
        """One field. Raises UsageError if the message has no such field."""
        return self.fields[field_index(self.msgid, name)]

    def numbers(self, *names: str) -> tuple[int, ...]:
        """Some fields as whole numbers. Raises as `value`, and TypeError for a text."""
        fields = self.fields
        return tuple(int(fields[field_index(self.msgid, name)]) for name in names)

    def text(self, name: str) -> str:
        """A field of text, up to its end; what is not UTF-8 is replaced. Empty for a number. Raises as `value`."""
        value = self.value(name)
        return value.partition(b"\0")[0].decode(errors="replace") if isinstance(value, bytes) else ""


def _generated_layout(message: type[dialect.MAVLink_message]) -> Layout:
    wire, names = message.ordered_fieldnames, message.fieldnames
    sizes, order = [message.lengths[wire.index(name)] for name in names], [names.index(name) for name in wire]
    seed = bytes([message.crc_extra])
    return Layout(message.msgname, tuple(names), tuple(sizes), tuple(order), message.unpacker, seed)


_LAYOUTS: Mapping[int, Layout] = {
    **{number: _generated_layout(message) for number, message in dialect.mavlink_map.items()},
    **EXTRA_LAYOUTS,
}
#: The message of each row of `FRAME`; the last one stands for all that are unknown.
MSGIDS = (*sorted(_LAYOUTS), UNKNOWN)
ROWS = {msgid: row for row, msgid in enumerate(MSGIDS)}
# By message: its row, the byte that its definition adds to the checksum; -1 in the last ones, for all ids beyond.
_KNOWN = np.full((max(_LAYOUTS) + 2, 2), -1, np.int16)
for _msgid, _row in ROWS.items():
    _KNOWN[_msgid] = (_row, _LAYOUTS[_msgid].crc_extra[0]) if _msgid in _LAYOUTS else (_row, -1)


def layout_of(msgid: int) -> Layout:
    """How a message lies on the wire. Raises UsageError for an unknown one."""
    layout = _LAYOUTS.get(msgid)
    if layout is None:
        raise UsageError(f"message {msgid} is not in the dialect")
    return layout


def message_name(msgid: int) -> str:
    """The name of a message, or `UNKNOWN_<id>` outside the dialect; `UNKNOWN` for all of those together."""
    layout = _LAYOUTS.get(msgid)
    if layout is None:
        return "UNKNOWN" if msgid == UNKNOWN else f"UNKNOWN_{msgid}"
    return layout.name


def command_numbers() -> dict[str, int]:
    """Every MAV_CMD of the dialect by its name without MAV_CMD_."""
    return {entry.name.removeprefix("MAV_CMD_"): number for number, entry in dialect.enums["MAV_CMD"].items()}


@cache
def field_index(msgid: int, name: str) -> int:
    """Place of a field (of an array: its first element) in `Frame.fields`. Raises UsageError if there is none."""
    return layout_of(msgid).place(name)


def frame_length(data: bytes, start: int) -> int | None:
    """Bytes of the frame that starts here with its marker, None if too few are there to say."""
    if len(data) < start + 3:
        return None
    if data[start] == _V1:
        return data[start + 1] + _SHORTEST_V1
    return data[start + 1] + _SHORTEST_V2 + (SEAL_BYTES if data[start + 2] & SIGNED_FLAG else 0)


def split_frames(data: bytes) -> tuple[list[bytes], bytes]:
    """The frames of a byte stream, bytes between them as messages of their own, and the beginning of the next frame."""
    found, at, begin = list[bytes](), 0, len(data)
    while marker := _MARKER.search(data, at):
        begin = marker.start()
        length = frame_length(data, begin)
        if length is None or begin + length > len(data):
            break
        found += filter(None, (data[at:begin], data[begin : begin + length]))
        at, begin = begin + length, len(data)
    return [*found, data[at:begin]] if begin > at else found, data[begin:]


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Many received messages, in order of arrival; iterates them one by one, as `Frame`."""

    data: Bytes  # that they lie in
    rows: NDArray[np.void]  # (n,) where, and from whom, see `sequence.FRAME`

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Frame]:
        for host_ns, _, body, stop, _, _, row, sender, seq, _ in self.rows.tolist():
            msgid = MSGIDS[row]
            size = _LAYOUTS[msgid].packer.size
            payload = self.data[body : min(stop, body + size)].tobytes().ljust(size, b"\0")
            yield Frame(msgid, sender >> 8, sender & 0xFF, seq, payload, host_ns)

    def where(self, chosen: BoolArray | IntArray | slice) -> "Frames":
        """Some of them."""
        return Frames(self.data, _those(self.rows, chosen))

    def of(self, *msgids: int) -> "Frames":
        """The autopilots' own of some messages."""
        chosen = np.zeros(len(self), np.bool_)
        for msgid in msgids:  # `isin` takes three times as long
            chosen |= self.rows["row"] == ROWS[msgid]
        return self.where(chosen & (self.rows["sender"] & 0xFF == AUTOPILOT))

    def counts(self) -> Counter[int]:
        """How many of each message came from an autopilot."""
        own = np.bincount(self.rows["row"][self.rows["sender"] & 0xFF == AUTOPILOT])
        return Counter({MSGIDS[row]: int(own[row]) for row in np.flatnonzero(own).tolist()})

    def records(self, dtype: np.dtype[np.void]) -> Record:
        """(n,) the payloads as records, see `Layout.record_dtype`: all must be of that one message."""
        size, bodies = dtype.itemsize, self.rows["body"].astype(np.int64)
        if not len(bodies):
            return np.empty(0, dtype)
        data, behind = self.data, int(bodies.max()) + size - len(self.data)
        if behind > 0:
            data = np.concatenate((data, np.zeros(behind, np.uint8)))
        payloads = anywhere(data, f"V{size}")[bodies]
        lengths, fields = self.rows["stop"] - bodies, (dtype.fields or {}).values()
        short = np.flatnonzero(lengths < max(at + kind.itemsize for kind, at, *_ in fields))  # trailing zeros trimmed
        raw = payloads.view(np.uint8).reshape(-1, size)
        raw[short] = np.where(np.arange(size) < lengths[short, None], raw[short], 0)
        return payloads.view(dtype)


def anywhere(data: Bytes, code: str) -> NDArray[Any]:
    """(n,) what lies at each byte as a number or as bytes of this type, where it has room; none is copied.

    n is 2 at least, with zeros behind the data, for numba compiles anew for an array of one or none.
    """
    size = np.dtype(code).itemsize
    data = data if len(data) > size else np.frombuffer(data.tobytes().ljust(size + 1, b"\0"), np.uint8)
    return np.ndarray((len(data) + 1 - size,), code, data, 0, (1,))


def frames_of(frames: Iterable[Frame]) -> Frames:
    """As columns what came one by one, if it did."""
    if isinstance(frames, Frames):
        return frames
    some = list(frames)
    rows = np.zeros(len(some), FRAME)
    msgids, sysids, compids, seqs, payloads, host_ns = zip(*some, strict=True) if some else ((),) * 6
    ends = np.cumsum(np.fromiter(map(len, payloads), np.int64, len(some)))
    rows["stop"], rows["body"][1:] = ends, ends[:-1]
    rows["row"] = [ROWS[msgid] for msgid in msgids]
    rows["sender"] = np.array(sysids, np.int64) << 8 | np.array(compids, np.int64)
    rows["seq"], rows["host_ns"] = seqs, host_ns
    return Frames(np.frombuffer(b"".join(payloads), np.uint8), rows)


NO_FRAMES = frames_of(())


def frames_joined(pieces: Sequence[Frames]) -> Frames:
    """All of these frames as one, in this order."""
    if len(pieces) < 2:
        return pieces[0] if pieces else NO_FRAMES
    rows = np.frombuffer(bytearray().join(piece.rows.data for piece in pieces), FRAME)  # numpy is slow to join records
    data, ends = b"".join(piece.data.data for piece in pieces), accumulate(len(piece.data) for piece in pieces[:-1])
    shifts = np.repeat(np.array([0, *ends], np.int32), np.array([len(piece.rows) for piece in pieces]))
    rows["body"] += shifts
    rows["stop"] += shifts
    return Frames(np.frombuffer(data, np.uint8), rows)


class Decoder:
    """Bytes in, frames out, for one link or one telemetry log. At most 289 bytes are kept between calls.

    wanted: message ids to hand out, None for all of the dialect; others are checked and counted all the same.
    signing: lets only genuine frames pass. passed: gets the bytes of every frame that passes, and its time of arrival.
    stamped: a time stamp stands before each frame, as in a telemetry log; then garbage is searched to its end.
    heard: the senders. records: frames so far. size: bytes done with; sound_end: place behind the last frame in them.
    """

    def __init__(
        self,
        wanted: Collection[int] | None = None,
        signing: Signing | None = None,
        passed: list[tuple[bytes, int]] | None = None,
        *,
        stamped: bool = False,
    ) -> None:
        self._gap, self._signing, self._passed = STAMP_BYTES if stamped else 0, signing, passed
        self.heard = Senders(MSGIDS)
        self._wanted = np.array([msgid != UNKNOWN and (wanted is None or msgid in wanted) for msgid in MSGIDS])
        self._pending = b""
        self.records = self.size = self.sound_end = self._sound = 0

    @property
    def senders(self) -> Mapping[tuple[int, int], LinkCount]:
        """Figures of each sender, by (system id, component id)."""
        return self.heard.counts()

    @property
    def garbage_bytes(self) -> int:
        """Bytes that are in no frame, nor in the time stamp of one."""
        return self.size - self._sound

    def feed(self, data: bytes, host_ns: int = 0, *, last: bool = False) -> Frames:
        """Take the next bytes of a stream, received at `host_ns`. A frame may span calls, wherever they cut it.

        last: nothing follows them.
        """
        buffer = self._pending + data if self._pending else data
        chunk = np.array([[len(buffer)], [host_ns], self.heard.numbers((None,))], np.int64)
        frames, used = self._scan(np.frombuffer(buffer, np.uint8), chunk, whole=last)
        self._pending = buffer[used:]
        return frames

    def take(self, some: Datagrams, *, datagrams: bool = True) -> Frames:
        """Take what an endpoint brought. What a datagram leaves unfinished is garbage and does not spoil the next one.

        datagrams: as of the endpoint; else the chunks are of one stream, or of several ends and cut between frames.
        """
        if not datagrams and set(some.peers) == {None}:
            return frames_joined([self.feed(*chunk) for chunk in some])
        numbers = np.array(self.heard.numbers(some.peers), np.int64)[some.whose]
        return self._scan(some.data, np.array([some.sizes, some.host_ns, numbers]), whole=True)[0]

    def _scan(self, data: Bytes, chunks: IntArray, *, whole: bool) -> tuple[Frames, int]:
        found = np.empty(len(data) // (_SHORTEST_V1 + self._gap) + 1, FRAME)
        count, used, sound = _find(data, anywhere(data, "<i8"), chunks, whole, self._gap, _KNOWN, _tables(), found)
        rows = found[:count]
        if count:
            self.sound_end = self.size + int(rows["after"][-1])
            self._sound += sound + self._gap * count
            self.records += count
            chosen = self._admitted(data, rows) & self._wanted[rows["row"]]
            rows = rows if chosen.all() else _those(rows, chosen)
        self.size += used
        return Frames(data, rows), used

    def _admitted(self, data: Bytes, rows: NDArray[np.void]) -> BoolArray:
        """Which frames are genuine, and of senders that are heard from where they came."""
        signing, rows["heard"] = self._signing, REFUSED
        for k in range(len(rows) if signing else 0):
            # A stamp is kept only if its sender may come from there: who sends a genuine frame again from elsewhere
            # does not make the genuine one old.
            frame = data[int(rows[k]["begin"]) : int(rows[k]["after"])].tobytes()
            if signing and signing.genuine(frame) and (not self.heard.admits(rows[k]) or signing.fresh(frame)):
                self.heard.hear(data, rows[k : k + 1])
        if signing is None:
            self.heard.hear(data, rows)
        heard: BoolArray = rows["heard"] == HEARD
        if self._passed is not None:
            places = (rows[name][heard].tolist() for name in ("begin", "after", "host_ns"))
            whole = data.tobytes()
            self._passed += [(whole[begin:after], host_ns) for begin, after, host_ns in zip(*places, strict=True)]
        return heard


def _those(rows: NDArray[np.void], chosen: BoolArray | IntArray | slice) -> NDArray[np.void]:
    """Some of the rows, as plain bytes: numpy is slow to copy records."""
    those: NDArray[np.void] = rows.view(PLAIN)[chosen].view(FRAME)
    return those


class Encoder:
    """Values in, MAVLink 2 frames out, with this sender's own running sequence number. signing: signs them."""

    def __init__(self, sysid: int, compid: int, signing: Signing | None = None) -> None:
        if not (0 < sysid < 256 and 0 < compid < 256):
            raise UsageError(f"system and component id must be 1 to 255, not {sysid} and {compid}")
        self._sysid, self._compid, self._seq = sysid, compid, 0
        self._signing, self._flags = signing, 0 if signing is None else SIGNED_FLAG

    def encode(self, msgid: int, *fields: Argument) -> bytes:
        """One frame from the fields as declared; trailing ones left out are zero. Raises as `Layout.pack`."""
        return self.encode_payload(msgid, layout_of(msgid).pack(fields))

    def statustext(self, severity: Severity, text: str) -> bytes:
        """A STATUSTEXT frame; text beyond 50 bytes is cut, at a whole character."""
        return self.encode(MessageId.STATUSTEXT, severity, cut(text, TEXT_BYTES))

    def encode_payload(self, msgid: int, payload: bytes) -> bytes:
        """One frame from a whole payload, as `Frame.payload` has it. Raises UsageError for an unknown message."""
        layout, payload = layout_of(msgid), payload.rstrip(b"\0") or b"\0"
        seq = self._seq
        self._seq = (seq + 1) & 0xFF
        sender = (seq, self._sysid, self._compid)
        body = _pack_header(len(payload), self._flags, 0, *sender, msgid & 0xFFFF, msgid >> 16) + payload
        frame = b"\xfd" + body + mcrf4xx(body + layout.crc_extra).to_bytes(2, "little")
        return frame if self._signing is None else frame + self._signing.seal(frame)


@cache
def _tables() -> NDArray[np.uint16]:
    """(8, 256): what a byte makes of the checksum that stands 0 to 7 bytes behind it (CRC-16/MCRF4XX)."""
    tables = np.zeros((8, 256), np.uint16)
    tables[0] = np.arange(256)
    for _ in range(8):
        tables[0] = tables[0] >> np.uint16(1) ^ np.where(tables[0] & 1, np.uint16(0x8408), 0)  # 0x1021, bits in reverse
    for k in range(1, 8):
        tables[k] = tables[k - 1] >> np.uint16(8) ^ tables[0, tables[k - 1] & 0xFF]
    return tables


@cached_loop
def _find(
    data: Bytes,
    words: IntArray,
    chunks: IntArray,
    whole: bool,
    gap: int,
    known: NDArray[np.int16],
    tables: NDArray[np.uint16],
    found: NDArray[Any],
) -> tuple[int, int, int]:
    """Write down the frames; returns how many, how many bytes are done with, and how many of them the frames are.

    chunks: (3, k) sizes, times of arrival [ns] and sources. whole: none goes on in the next one, else there is one.
    """
    count = end = sound = 0
    for k in range(chunks.shape[1]):
        first, end = end, end + chunks[0, k]
        at, left = first + gap, max(FALSE_MARKERS, (end - first) // FALSE_MARKERS)
        while at < end:
            marker, after = data[at], at
            if marker in (_V1, _V2):
                after = _take(data, words, at, end, whole, gap, known, tables, found[count])
            if after == _NOT_YET:
                break
            if after > at:
                time_us = np.int64(0)  # of the record of a log
                for j in range(at - gap, at):
                    time_us = time_us << 8 | np.int64(data[j])
                found[count].host_ns = time_us * NS_PER_US if gap else chunks[1, k]
                found[count].source = chunks[2, k]
                count, sound, at = count + 1, sound + after - at, after + gap
                continue
            left -= int(gap == 0 and (marker in (_V1, _V2)))
            at = at + 1 if left else end
        if not whole:
            return count, min(max(at - gap, 0), end), sound
    return count, end, sound


@inline
def _take(
    data: Bytes,
    words: IntArray,
    begin: int,
    end: int,
    whole: bool,
    gap: int,
    known: NDArray[np.int16],
    tables: NDArray[np.uint16],
    frame: Any,
) -> int:
    """Write down the frame that begins at a marker; returns the place behind it, `begin` for none, or `_NOT_YET`."""
    zero = np.int64(0)  # `zero +` makes a byte a signed number for numba
    if gap and (data[begin - 8] != 0 or data[begin - 7] >= LATEST_US >> 48):
        return begin
    later = begin if whole else _NOT_YET
    if end - begin < (_SHORTEST_V2 if data[begin] == _V2 else _SHORTEST_V1):
        return later
    body, header, flags, msgid = begin + 6, begin + 2, zero, zero + data[begin + 5]
    if data[begin] == _V2:
        body, header, flags = begin + 10, begin + 4, zero + data[begin + 2]
        msgid = (zero + data[begin + 7]) | (zero + data[begin + 8]) << 8 | (zero + data[begin + 9]) << 16
    if flags > SIGNED_FLAG:
        return begin
    stop = body + data[begin + 1]
    after = stop + 2 + SEAL_BYTES * flags
    if after > end:
        return later
    place = min(msgid, len(known) - 1)
    row, seed = known[place, 0], zero + known[place, 1]
    if seed < 0:  # it cannot be checked: it counts if another frame follows, or the end
        following = after + gap
        if following >= end and not whole:
            return _NOT_YET
        if after != end and (following >= end or (data[following] != _V1 and data[following] != _V2)):
            return begin
        row = known[len(known) - 1, 0]
    elif _checksum(data, words, begin + 1, stop, seed, tables) != (zero + data[stop]) | (zero + data[stop + 1]) << 8:
        return begin
    frame.begin, frame.body, frame.stop, frame.after, frame.row = begin, body, stop, after, row
    frame.sender = (zero + data[header + 1]) << 8 | (zero + data[header + 2])
    frame.seq = data[header]
    return int(after)


@inline
def _checksum(data: Bytes, words: IntArray, first: int, stop: int, seed: int, tables: NDArray[np.uint16]) -> int:
    crc, k = np.int64(0xFFFF), first
    while k + 8 <= stop:
        word, later = words[k], np.int64(0)
        for j in range(2, 8):
            later ^= tables[7 - j, word >> 8 * j & 0xFF]
        word ^= crc
        crc = later ^ (tables[7, word & 0xFF] ^ tables[6, word >> 8 & 0xFF])
        k += 8
    while k < stop:
        crc = crc >> 8 ^ tables[0, (crc ^ data[k]) & 0xFF]
        k += 1
    return int(crc >> 8 ^ tables[0, (crc ^ seed) & 0xFF])
