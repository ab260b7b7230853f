"""MAVLink 1 and 2 frames to values and back: the only module that knows pymavlink.

Of pymavlink only the generated dialect is used: the wire format and the checksum seed of each message. The decoder
never raises on input: what is not a frame is counted and skipped, and scanning resumes right after the false marker,
so that one fake header cannot swallow the good frames behind it. The encoder raises UsageError for what cannot be sent.

Wire format: https://mavlink.io/en/guide/serialization.html
"""

import re
import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
from fastcrc.crc16 import mcrf4xx

from mavdiag.errors import UsageError
from mavdiag.link.layout import EXTRA_LAYOUTS, Argument, FieldValue, Layout, cut
from mavdiag.link.messages import MessageId, Severity
from mavdiag.link.sequence import DecoderCount, LinkCount, Senders, Source
from mavdiag.link.signing import SEAL_BYTES, SIGNED_FLAG, Signing

MARKER_V1, MARKER_V2 = MARKERS = 0xFE, 0xFD
UNFINISHED = -1
UNKNOWN = -1  # stands for every message id outside the dialect in `LinkCount.by_message`
SHORTEST_V1, SHORTEST_V2 = 8, 12  # header and checksum round an empty payload
TEXT_BYTES = 50  # STATUSTEXT.text
# What came at once is searched up to so many false markers, or one in so many bytes; the rest is garbage (our choice).
FALSE_MARKERS = 64

_search_marker = re.compile(rb"[\xfd\xfe]").search
_header_v1 = struct.Struct("<xBBBBB").unpack_from  # length, seq, sysid, compid, msgid
_header_v2 = struct.Struct("<xBBxBBBI").unpack_from  # length, flags, seq, sysid, compid, msgid and one byte beyond
_pack_header = struct.Struct("<BBBBBBHB").pack  # the same, without the marker and with the message id in two parts


class Frame(NamedTuple):
    """One received message.

    msgid: number of the message.
    sysid, compid: its sender.
    seq: the sender's running number, 0..255.
    payload: as on the wire, with the trimmed zeros put back and unknown extensions cut off.
    host_ns: when it was received [ns].
    """

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


_LAYOUTS: Mapping[int, Layout] = {
    **{number: _generated_layout(message) for number, message in dialect.mavlink_map.items()},
    **EXTRA_LAYOUTS,
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


def known_messages() -> dict[int, tuple[int, int]]:
    """Length of the payload and checksum seed of each message of the dialect, by its number."""
    return {msgid: (layout.packer.size, layout.crc_extra[0]) for msgid, layout in _LAYOUTS.items()}


def wire_fields(msgid: int) -> tuple[tuple[str, int], ...]:
    """Name and number of places of each field of `Frame.fields`, in order. Raises UsageError for an unknown message."""
    return _layout(msgid).wire_fields


def field_index(msgid: int, name: str) -> int:
    """Place of a field (of an array: its first element) in `Frame.fields`; look it up once, outside the loop.

    >>> field_index(MessageId.ATTITUDE_TARGET, "type_mask")
    9

    Raises UsageError if there is no such message or field.
    """
    return _layout(msgid).place(name)


def record_dtype(msgid: int, *columns: tuple[str, int]) -> np.dtype[np.void]:
    """How `numpy.frombuffer` reads joined payloads of one message: the way to convert many frames at once.

    columns: (field, count) each; a column of count > 1 takes that many consecutive places from the field on, all of
    one type. Raises UsageError if there is no such message or field, or the places differ in type.
    """
    return _layout(msgid).record_dtype(columns)


def next_marker(buffer: bytes, start: int) -> int:
    """The first place from `start` on where a frame could begin; the length of the buffer if there is none."""
    found = _search_marker(buffer, start)
    return found.start() if found else len(buffer)


_Noted: TypeAlias = tuple[int, int, int, int, Source, int]
"""What is noted of a frame: key of its sender, running number, message, time of arrival, source, checksum."""


class Decoder:
    """Bytes in, frames out, for one link. At most 281 bytes are kept between calls.

    wanted: message ids to hand out, None for all. Others are checked and counted all the same.
    gap: bytes that stand between frames, as the time stamps of a log do.
    signing: lets only genuine frames pass; None passes all.
    source: where the next bytes come from.
    heard: the senders, and from where each is heard.
    passed: gets the bytes of every frame that passes, wanted or not, with its time of arrival; None for nobody.
    """

    def __init__(
        self,
        wanted: Collection[int] | None = None,
        gap: int = 0,
        signing: Signing | None = None,
        passed: list[tuple[bytes, int]] | None = None,
    ) -> None:
        self._gap, self._signing, self._passed = gap, signing, passed
        self._guarded = signing is not None or passed is not None
        self.source: Source = None
        self.heard = Senders()
        self._note = self.heard.note
        self._table = {
            msgid: (layout.packer.size, layout.crc_extra, wanted is None or msgid in wanted)
            for msgid, layout in _LAYOUTS.items()
        }
        self._pending = b""
        self._garbage = self._bad_crc = self._incompatible = self._unknown = 0

    @property
    def senders(self) -> Mapping[tuple[int, int], LinkCount]:
        """Figures of each sender, by (system id, component id)."""
        return self.heard.counts()

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
        at, end, take = 0, len(buffer), self.take
        left = max(FALSE_MARKERS, end // FALSE_MARKERS)
        while at < end:
            after = take(buffer, at, host_ns, frames, whole)
            if after > at:
                at = after
            elif after == UNFINISHED:
                break
            else:
                left -= 1
                resume = next_marker(buffer, at + 1) if left else end
                self._garbage += resume - at
                at = resume
        return frames, at

    def take(self, buffer: bytes, at: int, host_ns: int, frames: list[Frame], whole: bool = True) -> int:
        """Append the frame that starts at `at`, if it is wanted, and return the place behind it; `at` if there is none.

        whole: the buffer goes on no further; else UNFINISHED says that more bytes must decide.
        """
        marker, end = buffer[at], len(buffer)
        after: int
        if marker == MARKER_V2:
            if end - at < SHORTEST_V2:
                return at if whole else UNFINISHED
            length, flags, seq, sysid, compid, msgid = _header_v2(buffer, at)
            if flags > SIGNED_FLAG:
                self._incompatible += 1
                return at
            msgid &= 0xFFFFFF
            start = at + 10
            after = start + length + (2 + SEAL_BYTES if flags else 2)
        elif marker == MARKER_V1:
            if end - at < SHORTEST_V1:
                return at if whole else UNFINISHED
            length, seq, sysid, compid, msgid = _header_v1(buffer, at)
            start = at + 6
            after = start + length + 2
        else:
            return at
        if after > end:
            return at if whole else UNFINISHED
        entry = self._table.get(msgid)
        if entry is None:
            sender = (sysid << 8 | compid, seq, UNKNOWN, host_ns, self.source, -1)
            return self._take_unknown(buffer, at, after, sender, whole)
        size, extra, wanted = entry
        stop = start + length
        checksum = buffer[stop] | buffer[stop + 1] << 8
        if mcrf4xx(extra, mcrf4xx(buffer[at + 1 : stop])) != checksum:
            self._bad_crc += 1
            return at
        sender = (sysid << 8 | compid, seq, msgid, host_ns, self.source, checksum)
        if not (self._passes(buffer[at:after], sender) if self._guarded else self._note(*sender)):
            return after
        if wanted:
            payload = buffer[start:stop]
            if length != size:  # MAVLink 2 trims trailing zeros; a newer definition may be longer
                payload = payload.ljust(size, b"\0")[:size]
            frames.append(tuple.__new__(Frame, (msgid, sysid, compid, seq, payload, host_ns)))
        return after

    def _take_unknown(self, buffer: bytes, at: int, after: int, sender: _Noted, whole: bool) -> int:
        """A frame outside the dialect has no seed to check it by: it counts if another one follows, or the end."""
        following = after + self._gap
        if following >= len(buffer) and not whole:
            return UNFINISHED
        if after != len(buffer) and (following >= len(buffer) or buffer[following] not in MARKERS):
            return at
        self._unknown += 1
        self._passes(buffer[at:after], sender)
        return after

    def _passes(self, frame: bytes, sender: _Noted) -> bool:
        """Whether a whole frame is genuine, and its sender is heard from where it came.

        Its stamp is kept only then: who sends a genuine frame again from elsewhere does not make the genuine one old.
        """
        key, _, _, host_ns, source, _ = sender
        if self._signing is not None and not (
            self._signing.genuine(frame) and self.heard.admits(key, host_ns, source) and self._signing.fresh(frame)
        ):
            return False
        if not self._note(*sender):
            return False
        if self._passed is not None:
            self._passed.append((frame, host_ns))
        return True


class Encoder:
    """Values in, MAVLink 2 frames out, with this sender's own running sequence number.

    signing: signs them; None leaves them unsigned.
    """

    def __init__(self, sysid: int, compid: int, signing: Signing | None = None) -> None:
        if not (0 < sysid < 256 and 0 < compid < 256):
            raise UsageError(f"system and component id must be 1 to 255, not {sysid} and {compid}")
        self._sysid, self._compid, self._seq = sysid, compid, 0
        self._signing, self._flags = signing, 0 if signing is None else SIGNED_FLAG

    def encode(self, msgid: int, *fields: Argument) -> bytes:
        """One frame from the fields as declared; trailing ones left out are zero.

        Integers are rounded and saturated to their field, text is cut to it. Raises UsageError for an unknown message,
        too many fields, an array of the wrong length, or a value that its field cannot hold at all.
        """
        layout = _layout(msgid)
        return self._frame(msgid, layout, layout.pack(fields))

    def encode_payload(self, msgid: int, payload: bytes) -> bytes:
        """One frame from a whole payload, as `Frame.payload` has it. Raises UsageError for an unknown message."""
        return self._frame(msgid, _layout(msgid), payload)

    def statustext(self, severity: Severity, text: str) -> bytes:
        """A STATUSTEXT frame; text beyond 50 bytes is cut, at a whole character."""
        return self.encode(MessageId.STATUSTEXT, severity, cut(text, TEXT_BYTES))

    def _frame(self, msgid: int, layout: Layout, payload: bytes) -> bytes:
        payload = payload.rstrip(b"\0") or b"\0"
        seq = self._seq
        self._seq = (seq + 1) & 0xFF
        sender = (seq, self._sysid, self._compid)
        body = _pack_header(len(payload), self._flags, 0, *sender, msgid & 0xFFFF, msgid >> 16) + payload
        frame = b"\xfd" + body + mcrf4xx(layout.crc_extra, mcrf4xx(body)).to_bytes(2, "little")
        return frame if self._signing is None else frame + self._signing.seal(frame)


@dataclass(frozen=True, slots=True)
class StatusText:
    """A STATUSTEXT as received.

    severity: MAV_SEVERITY.
    text: this piece of it.
    chunk_id: 0 for a text in one piece, else the same for all pieces of a longer one.
    chunk_seq: number of the piece.
    """

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
