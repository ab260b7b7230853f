"""MAVLink 1 and 2 frames to values and back: the only module that knows pymavlink.

Of pymavlink only the generated dialect is used: the wire format and the checksum seed of each message. The decoder
never raises on input: what is not a frame is counted and skipped, and scanning resumes right after the false marker,
so that one fake header cannot swallow the good frames behind it. The encoder raises UsageError for what cannot be sent.

Wire format: https://mavlink.io/en/guide/serialization.html
"""

import re
import struct
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
from fastcrc.crc16 import mcrf4xx

from mavdiag.errors import UsageError
from mavdiag.link.layout import Argument, FieldValue, Layout, cut
from mavdiag.link.messages import MessageId, Severity
from mavdiag.link.sequence import DecoderCount, LinkCount, SequenceTracker

__all__ = [
    "Decoder",
    "DecoderCount",
    "Encoder",
    "FieldValue",
    "Frame",
    "StatusText",
    "decode_statustext",
    "field_index",
    "message_name",
    "record_dtype",
    "wire_fields",
]

MARKER_V1, MARKER_V2 = MARKERS = 0xFE, 0xFD
SIGNED_FLAG = 0x01  # MAVLINK_IFLAG_SIGNED, the only incompatibility flag defined
SIGNATURE_BYTES = 13
UNKNOWN = -1  # stands for every message id outside the dialect in `LinkCount.by_message`
SHORTEST_V1, SHORTEST_V2 = 8, 12  # header and checksum round an empty payload
TEXT_BYTES = 50  # STATUSTEXT.text

_next_marker = re.compile(rb"[\xfd\xfe]").search
_header_v1 = struct.Struct("<xBBBBB").unpack_from  # length, seq, sysid, compid, msgid
_header_v2 = struct.Struct("<xBBxBBBI").unpack_from  # length, flags, seq, sysid, compid, msgid and one byte beyond
_pack_header = struct.Struct("<BBBBBBHB").pack  # the same, without the marker and with the message id in two parts


class Frame(NamedTuple):
    """One received message. payload: as on the wire, with the trimmed zeros put back and unknown extensions cut off."""

    msgid: int
    sysid: int
    compid: int
    seq: int
    payload: bytes
    host_ns: int

    @property
    def fields(self) -> tuple[FieldValue, ...]:
        """The values, flat, in the order of the wire; an array takes one place per element (see `field_index`)."""
        return _LAYOUTS[self.msgid].packer.unpack(self.payload)


def _generated_layout(message: type[dialect.MAVLink_message]) -> Layout:
    wire = message.ordered_fieldnames
    return Layout(
        message.msgname,
        tuple(message.fieldnames),
        tuple(message.lengths[wire.index(name)] for name in message.fieldnames),
        tuple(message.fieldnames.index(name) for name in wire),
        message.unpacker,
        bytes([message.crc_extra]),
    )


_LAYOUTS: Mapping[int, Layout] = {number: _generated_layout(m) for number, m in dialect.mavlink_map.items()} | {
    # In common.xml, but not in the dialect that pymavlink ships.
    MessageId.ESC_INFO: Layout(
        "ESC_INFO",
        (
            "index",
            "time_usec",
            "counter",
            "count",
            "connection_type",
            "info",
            "failure_flags",
            "error_count",
            "temperature",
        ),
        (1, 1, 1, 1, 1, 1, 4, 4, 4),
        (1, 7, 2, 6, 8, 0, 3, 4, 5),
        struct.Struct("<Q4IH4H4h4B"),
        bytes([251]),
    ),
    MessageId.ESC_STATUS: Layout(
        "ESC_STATUS",
        ("index", "time_usec", "rpm", "voltage", "current"),
        (1, 1, 4, 4, 4),
        (1, 2, 3, 4, 0),
        struct.Struct("<Q4i4f4fB"),
        bytes([10]),
    ),
}


def _layout(msgid: int) -> Layout:
    layout = _LAYOUTS.get(msgid)
    if layout is None:
        raise UsageError(f"message {msgid} is not in the dialect")
    return layout


def message_name(msgid: int) -> str:
    """The name of a message, or `UNKNOWN_<id>` outside the dialect."""
    layout = _LAYOUTS.get(msgid)
    return layout.name if layout else f"UNKNOWN_{msgid}"


def wire_fields(msgid: int) -> tuple[tuple[str, int], ...]:
    """Name and number of places of each field of `Frame.fields`, in order. Raises UsageError for an unknown message."""
    return _layout(msgid).wire_fields


def field_index(msgid: int, name: str) -> int:
    """Place of a field (of an array: its first element) in `Frame.fields`; look it up once, outside the loop.

    >>> field_index(MessageId.ATTITUDE_TARGET, "type_mask")
    9

    Raises UsageError if there is no such message or field.
    """
    place = 0
    for wire_name, size in wire_fields(msgid):
        if wire_name == name:
            return place
        place += size
    raise UsageError(f"{message_name(msgid)} has no field {name}")


def record_dtype(msgid: int, *columns: tuple[str, int]) -> np.dtype[np.void]:
    """How `numpy.frombuffer` reads joined payloads of one message: the way to convert many frames at once.

    columns: (field, count) each; a column of count > 1 takes that many consecutive places from the field on, all of
    one type. Raises UsageError if there is no such message or field, or the places differ in type.
    """
    layout = _layout(msgid)
    codes = layout.codes
    formats, offsets = [], []
    for name, count in columns:
        first = field_index(msgid, name)
        kinds = set(codes[first : first + count])
        if len(kinds) != 1:
            raise UsageError(f"{layout.name}: {count} places from {name} on are not of one type")
        kind = np.dtype("<" + kinds.pop())
        formats.append(kind if count == 1 else np.dtype((kind, count)))
        offsets.append(struct.calcsize("<" + "".join(codes[:first])))
    names = [name for name, _ in columns]
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": layout.packer.size})


class Decoder:
    """Bytes in, frames out, for one link. At most 281 bytes are kept between calls.

    wanted: message ids to hand out, None for all. Others are checked and counted all the same.
    """

    def __init__(self, wanted: Collection[int] | None = None) -> None:
        self._table = {
            msgid: (layout.packer.size, layout.crc_extra, wanted is None or msgid in wanted)
            for msgid, layout in _LAYOUTS.items()
        }
        self._senders: dict[int, SequenceTracker] = {}
        self._pending = b""
        self._garbage = self._bad_crc = self._incompatible = self._unknown = 0

    @property
    def senders(self) -> Mapping[tuple[int, int], LinkCount]:
        """Figures of each sender, by (system id, component id)."""
        return {(key >> 8, key & 0xFF): tracker.count() for key, tracker in self._senders.items()}

    @property
    def count(self) -> DecoderCount:
        """Figures of the whole link."""
        return DecoderCount(self._garbage, self._bad_crc, self._incompatible, self._unknown)

    def feed(self, data: bytes, host_ns: int) -> list[Frame]:
        """Take the next bytes of a stream, received at `host_ns`. A frame may span calls, wherever they cut it."""
        buffer = self._pending + data if self._pending else data
        frames, used = self._scan(buffer, host_ns, whole=False)
        self._pending = buffer[used:]
        return frames

    def feed_datagram(self, data: bytes, host_ns: int) -> list[Frame]:
        """Take one datagram: what it leaves unfinished is garbage and does not spoil the next one."""
        return self._scan(data, host_ns, whole=True)[0]

    def _scan(self, buffer: bytes, host_ns: int, *, whole: bool) -> tuple[list[Frame], int]:
        """Frames of the buffer, and how many bytes are done with: all of them if it is whole."""
        frames: list[Frame] = []
        table, new_tuple = self._table, tuple.__new__
        at, end = 0, len(buffer)
        while at < end:
            marker, left = buffer[at], end - at
            if marker == MARKER_V2 and left >= SHORTEST_V2:
                length, flags, seq, sysid, compid, msgid = _header_v2(buffer, at)
                if flags > SIGNED_FLAG:
                    self._incompatible += 1
                    at = self._skip(buffer, at)
                    continue
                msgid &= 0xFFFFFF
                start = at + 10
                stop = start + length
                after = stop + 2 + flags * SIGNATURE_BYTES
            elif marker == MARKER_V1 and left >= SHORTEST_V1:
                length, seq, sysid, compid, msgid = _header_v1(buffer, at)
                start = at + 6
                stop = start + length
                after = stop + 2
            elif marker in MARKERS:
                after = end + 1  # even the header is unfinished
            else:
                at = self._skip(buffer, at)
                continue
            if after <= end and (entry := table.get(msgid)) is not None:
                size, extra, wanted = entry
                if mcrf4xx(extra, mcrf4xx(buffer[at + 1 : stop])) == buffer[stop] | buffer[stop + 1] << 8:
                    self._note(sysid, compid, seq, msgid)
                    if wanted:
                        payload = buffer[start:stop]
                        if length != size:  # MAVLink 2 trims trailing zeros; a newer definition may be longer
                            payload = payload.ljust(size, b"\0")[:size]
                        frames.append(new_tuple(Frame, (msgid, sysid, compid, seq, payload, host_ns)))
                    at = after
                    continue
                self._bad_crc += 1
            elif after >= end and not whole:
                break  # unfinished; or unknown, and what follows must confirm it
            elif after == end or (after < end and buffer[after] in MARKERS):
                self._unknown += 1
                self._note(sysid, compid, seq, UNKNOWN)
                at = after
                continue
            at = self._skip(buffer, at)
        return frames, at

    def _note(self, sysid: int, compid: int, seq: int, msgid: int) -> None:
        key = sysid << 8 | compid
        tracker = self._senders.get(key)
        if tracker is None:
            tracker = self._senders[key] = SequenceTracker(seq)
        tracker.step(seq, msgid)

    def _skip(self, buffer: bytes, at: int) -> int:
        """The next place after `at` where a frame could start; what lies between is garbage."""
        found = _next_marker(buffer, at + 1)
        resume = found.start() if found else len(buffer)
        self._garbage += resume - at
        return resume


class Encoder:
    """Values in, MAVLink 2 frames out, with this sender's own running sequence number."""

    def __init__(self, sysid: int, compid: int) -> None:
        if not (0 < sysid < 256 and 0 < compid < 256):
            raise UsageError(f"system and component id must be 1 to 255, not {sysid} and {compid}")
        self._sysid, self._compid, self._seq = sysid, compid, 0

    def encode(self, msgid: int, *fields: Argument) -> bytes:
        """One frame from the fields as declared; trailing ones left out are zero.

        Integers are rounded and saturated to their field, text is cut to it. Raises UsageError for an unknown message,
        too many fields, an array of the wrong length, or a value that its field cannot hold at all.
        """
        layout = _layout(msgid)
        return self._frame(msgid, layout, layout.pack(fields))

    def encode_wire(self, msgid: int, fields: Sequence[FieldValue]) -> bytes:
        """One frame from all the fields of `Frame.fields`, in their order and already of the right type: the fast way.

        Raises UsageError if they do not fit.
        """
        layout = _layout(msgid)
        try:
            payload = layout.packer.pack(*fields)
        except (struct.error, OverflowError) as error:
            raise UsageError(f"{layout.name}: {error}") from error
        return self._frame(msgid, layout, payload)

    def statustext(self, severity: Severity, text: str) -> bytes:
        """A STATUSTEXT frame; text beyond 50 bytes is cut, at a whole character."""
        return self.encode(MessageId.STATUSTEXT, severity, cut(text, TEXT_BYTES))

    def _frame(self, msgid: int, layout: Layout, payload: bytes) -> bytes:
        payload = payload.rstrip(b"\0") or b"\0"
        seq = self._seq
        self._seq = (seq + 1) & 0xFF
        body = _pack_header(len(payload), 0, 0, seq, self._sysid, self._compid, msgid & 0xFFFF, msgid >> 16) + payload
        return b"\xfd" + body + mcrf4xx(layout.crc_extra, mcrf4xx(body)).to_bytes(2, "little")


@dataclass(frozen=True, slots=True)
class StatusText:
    """A STATUSTEXT as received. chunk_id: 0 for a text in one piece, else the same for all pieces of a longer one."""

    severity: int
    text: str
    chunk_id: int
    chunk_seq: int


def decode_statustext(frame: Frame) -> StatusText:
    """What a STATUSTEXT frame says; what is not UTF-8 is replaced. Raises UsageError for another message."""
    severity, raw, chunk_id, chunk_seq = frame.fields if frame.msgid == MessageId.STATUSTEXT else (None,) * 4
    if not (
        isinstance(severity, int)
        and isinstance(raw, bytes)
        and isinstance(chunk_id, int)
        and isinstance(chunk_seq, int)
    ):
        raise UsageError(f"not a STATUSTEXT: {message_name(frame.msgid)}")
    return StatusText(severity, raw.split(b"\0", 1)[0].decode(errors="replace"), chunk_id, chunk_seq)
