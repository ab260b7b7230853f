"""The fields of many frames at once: payloads of one message side by side, for `numpy` to read as records."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavdiag.link.batch import AUTOPILOT, Column, ColumnBatch
from mavdiag.link.codec import UNKNOWN, Frame
from mavdiag.link.crc_columns import Bytes, rows_at
from mavdiag.link.frame_walk import Dialect, Frames, Piece
from mavdiag.telemetry import IntArray
from mavdiag.units import NS_PER_US

__all__ = ["Decoded", "Rows", "decoded", "known_ids"]


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The frames of one message in a piece of a recording, of all senders, in order of arrival.

    places: (n,) which of the piece's sound frames they are.
    payloads: (n, size) as on the wire, with the trimmed zeros put back and unknown extensions cut off.
    host_ns: (n,) when they were received [ns].
    sender: (n,) system id << 8 | component id.
    seq: (n,) the sender's running numbers.
    """

    places: IntArray
    payloads: Bytes
    host_ns: IntArray
    sender: NDArray[np.uint16]
    seq: Bytes

    def of(self, sender: int) -> tuple[IntArray, Column] | None:
        """Places and frames of one sender; None if there are none."""
        own = self.sender == sender
        if own.all():
            return self.places, Column(self.payloads, self.host_ns)
        return (self.places[own], Column(self.payloads[own], self.host_ns[own])) if own.any() else None


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """The frames that are wanted of a piece of a recording.

    size: sound frames of any kind.
    rows: by message.
    """

    size: int
    rows: Mapping[int, Rows]

    def heard(self) -> dict[int, int]:
        """When the first frame of each system id came [ns], of all components."""
        first: dict[int, tuple[int, int]] = {}
        for rows in self.rows.values():
            sysids, at = np.unique(rows.sender >> np.uint16(8), return_index=True)
            for sysid, k in zip(sysids.tolist(), at.tolist(), strict=True):
                found = (int(rows.places[k]), int(rows.host_ns[k]))
                first[sysid] = min(found, first.get(sysid, found))
        return {sysid: host_ns for sysid, (_, host_ns) in first.items()}

    def vehicle(self, sysid: int) -> ColumnBatch:
        """What one vehicle's autopilot sent."""
        found = {msgid: rows.of(sysid << 8 | AUTOPILOT) for msgid, rows in self.rows.items()}
        return ColumnBatch(self.size, {msgid: own for msgid, own in found.items() if own is not None})

    def frames(self, msgids: Collection[int] | None = None) -> list[Frame]:
        """The frames one by one, in order of arrival. msgids: of which messages; None for all."""
        placed = [
            (place, Frame(msgid, sender >> 8, sender & 0xFF, seq, payload.tobytes(), host_ns))
            for msgid, rows in self.rows.items()
            if msgids is None or msgid in msgids
            for place, sender, seq, payload, host_ns in zip(
                rows.places.tolist(),
                rows.sender.tolist(),
                rows.seq.tolist(),
                rows.payloads,
                rows.host_ns.tolist(),
                strict=True,
            )
        ]
        return [frame for _, frame in sorted(placed, key=lambda one: one[0])]


def known_ids(frames: Frames, known: Dialect) -> IntArray:
    """(n,) message ids as `LinkCount` has them: those outside the dialect are `codec.UNKNOWN`."""
    ids = known.row(frames.msgid)
    ids[known.seeds[ids] < 0] = UNKNOWN
    return ids


def decoded(piece: Piece, frames: Frames, known: Dialect, wanted: Collection[int]) -> Decoded:
    """The payloads of the wanted messages among the sound frames of a piece."""
    ids = sorted(wanted)
    number = np.zeros(len(known.sizes), np.uint8 if len(ids) < 256 else np.uint16)
    number[ids] = np.arange(1, len(ids) + 1)
    numbers = number[known.row(frames.msgid)]
    order = np.argsort(numbers, kind="stable")
    ends = np.cumsum(np.bincount(numbers, minlength=len(ids) + 1)).tolist()
    rows = {
        msgid: _rows(piece.data, frames, order[first:last], int(known.sizes[msgid]))
        for msgid, first, last in zip(ids, ends, ends[1:], strict=False)
        if first < last
    }
    return Decoded(len(frames), rows)


def _rows(data: Bytes, frames: Frames, own: IntArray, size: int) -> Rows:
    body = frames.body[own]
    lengths = frames.stop[own] - body
    payloads = rows_at(data, body, size)
    if int(lengths.min()) < size:
        kept = np.tri(size + 1, size, -1, np.uint8) * np.uint8(0xFF)  # row: length of the payload
        payloads &= kept[np.minimum(lengths, size)]
    return Rows(own, payloads, frames.time_us[own] * NS_PER_US, frames.sender[own], frames.seq[own])
