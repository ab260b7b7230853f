"""The frames of a whole piece of a recording at once: as `codec.Decoder` finds them one by one, by arrays.

Places where a frame may begin are found over the whole piece; each says by its length where the next one is. The chain
is followed on trust, all its checksums are tested at once, those that are wrong are struck out, and the chain is
followed anew, until nothing on it is wrong. Where numba is there, one compiled loop does the same (`frame_loop`).

A piece that is not the last ends before the first frame that may go beyond it; the walk says where to go on.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.link.codec import known_messages
from mavdiag.link.crc_columns import Bytes, rows_at, sound_frames
from mavdiag.link.signing import SEAL_BYTES, SIGNED_FLAG
from mavdiag.telemetry import BoolArray, IntArray

__all__ = [
    "LATEST_US",
    "LONGEST",
    "STAMP_BYTES",
    "Dialect",
    "Finder",
    "Frames",
    "Piece",
    "Walk",
    "by_arrays",
    "dialect",
    "frames_at",
    "walk",
]

STAMP_BYTES = 8  # before each frame
LATEST_US = 1 << 52  # year 2112: a later stamp is damage, whatever follows it
LONGEST = 10 + 255 + 2 + SEAL_BYTES  # bytes of a frame: header, payload, checksum, signature
V1, V2 = 0xFE, 0xFD
_HEADER = 10  # bytes of the longer header, MAVLink 2's
_OUTSIDE = -1


@dataclass(frozen=True, slots=True, eq=False)
class Dialect:
    """The messages that can be checked.

    seeds: by message id, the byte that its definition adds to the checksum; -1 where there is no such message. The last
    one stands for all ids beyond.
    sizes: bytes of its payload, likewise.
    """

    seeds: NDArray[np.int16]
    sizes: NDArray[np.int16]

    def row(self, msgid: IntArray) -> IntArray:
        """Where a message is in the arrays."""
        return np.minimum(msgid, len(self.seeds) - 1)


def dialect() -> Dialect:
    """The messages that `codec` knows."""
    known = known_messages()
    seeds, sizes = np.full((2, max(known) + 2), _OUTSIDE, np.int16)
    for msgid, (size, seed) in known.items():
        seeds[msgid], sizes[msgid] = seed, size
    return Dialect(seeds, sizes)


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A piece of a recording.

    data: its bytes, and `LONGEST` bytes of room behind them at least. The first eight are a time stamp.
    size: how many there are, without the room.
    last: whether the recording ends with it.
    """

    data: Bytes
    size: int
    last: bool

    @property
    def limit(self) -> int:
        """Where a frame must begin before, so that the piece surely holds it and the first byte of the next one."""
        return self.size if self.last else max(STAMP_BYTES, self.size - LONGEST - STAMP_BYTES)


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Seeming or sound frames of a piece, (n,) each.

    begin: place of the marker. body: of the payload. stop: of the checksum. after: behind the frame.
    msgid, sender, seq: from the header; sender is system id << 8 | component id.
    time_us: since 1970.
    """

    begin: IntArray
    body: IntArray
    stop: IntArray
    after: IntArray
    msgid: IntArray
    sender: NDArray[np.uint16]
    seq: Bytes
    time_us: IntArray

    def __len__(self) -> int:
        return len(self.begin)


Finder: TypeAlias = Callable[[Piece, Dialect], IntArray]
"""From a piece to where its sound frames begin."""


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """What a piece holds.

    frames: the sound ones.
    resume: where the next piece must begin; the size of this one if it is the last.
    sound_end: behind the last sound frame; 0 if there is none.
    damaged: bytes before `resume` that are in no sound record.
    """

    frames: Frames
    resume: int
    sound_end: int
    damaged: int


def walk(piece: Piece, known: Dialect, find: Finder | None = None) -> Walk:
    """The sound frames of a piece of a recording. find: how to find them; None for arrays."""
    frames = frames_at(piece.data, (find or by_arrays)(piece, known))
    sound_end = int(frames.after[-1]) if len(frames) else 0
    resume = piece.size if piece.last else max(sound_end, piece.limit - STAMP_BYTES)
    taken = int((frames.after - frames.begin).sum()) + STAMP_BYTES * len(frames)
    return Walk(frames, resume, sound_end, resume - taken)


def by_arrays(piece: Piece, known: Dialect) -> IntArray:
    """Where the sound frames of a piece begin."""
    begin = _seeming(piece)
    spans = _spans(piece.data, begin)
    row = known.row(spans.msgid)
    outside = known.seeds[row] < 0
    left = np.flatnonzero(_complete(begin, spans, piece, outside))
    untested = ~outside
    while True:
        path = left[_path(begin[left], spans.after[left] + STAMP_BYTES)]
        tested = path[untested[path]]
        untested[tested] = False
        start, seeds = begin[tested] + 1, known.seeds[row[tested]].astype(np.uint8)
        wrong = tested[~sound_frames(piece.data, start, spans.stop[tested] - start, seeds)]
        if len(wrong) == 0:
            return begin[path]
        left = np.setdiff1d(left, wrong, assume_unique=True)


def _seeming(piece: Piece) -> IntArray:
    """Where a marker stands behind a time stamp that may be one."""
    found, step, data, limit = [], 1 << 18, piece.data, piece.limit
    for at in range(0, limit - STAMP_BYTES, step):
        part = data[at : min(at + step + STAMP_BYTES, limit)]
        seems = part[STAMP_BYTES:] - np.uint8(V2) <= V1 - V2
        seems &= part[:-STAMP_BYTES] == 0  # a stamp before LATEST_US, in bytes
        seems &= part[1 : 1 - STAMP_BYTES] < LATEST_US >> 48
        found.append(np.flatnonzero(seems) + (at + STAMP_BYTES))
    return np.concatenate(found) if found else np.empty(0, np.int64)


class _Spans(NamedTuple):
    """How far seeming frames go, (n,) each; the words are those of `Frames`."""

    body: IntArray
    stop: IntArray
    after: IntArray
    msgid: IntArray


def _spans(data: Bytes, begin: IntArray) -> _Spans:
    head = rows_at(data, begin, _HEADER)
    length, flags = head[:, 1].astype(np.int64), head[:, 2]
    msgid = head[:, 7] | head[:, 8].astype(np.int64) << 8 | head[:, 9].astype(np.int64) << 16
    body = begin + _HEADER
    old = np.flatnonzero(head[:, 0] == V1)
    msgid[old], body[old] = head[old, 5], begin[old] + 6
    stop = body + length
    after = stop + 2
    after[flags == SIGNED_FLAG] += SEAL_BYTES
    after[old] = stop[old] + 2
    return _Spans(body, stop, after, msgid)


def frames_at(data: Bytes, begin: IntArray) -> Frames:
    """What the headers behind these markers say."""
    head = rows_at(data, begin, _HEADER)
    time_us = rows_at(data, begin - STAMP_BYTES, STAMP_BYTES).view(">u8")[:, 0].astype(np.int64)
    old = np.flatnonzero(head[:, 0] == V1)
    head[old, 4:7] = head[old, 2:5]
    sender = head[:, 5].astype(np.uint16) << np.uint16(8) | head[:, 6]
    return Frames(begin, *_spans(data, begin), sender, head[:, 4].copy(), time_us)


def _complete(begin: IntArray, spans: _Spans, piece: Piece, outside: BoolArray) -> BoolArray:
    """Which seeming frames may be one: all there, no flags that we do not know, and the next one behind an unknown."""
    flags = piece.data[begin + 2]
    may: BoolArray = (spans.after <= piece.size) & ((flags <= SIGNED_FLAG) | (piece.data[begin] == V1))
    at = np.flatnonzero(outside & may)
    if len(at):
        following = spans.after[at] + STAMP_BYTES
        inside = following < piece.size
        after = piece.data[np.where(inside, following, 0)]
        goes_on = inside & ((after == V1) | (after == V2))
        may[at] = goes_on | (spans.after[at] == piece.size) if piece.last else goes_on
    return may


def _path(begin: IntArray, following: IntArray) -> IntArray:
    """Which of the frames are met on the way from the first one on, if all are sound. following: where the next is.

    Mostly the next one in the list is the next on the way. Only from the others, the hops, it must be looked for.
    """
    count = len(begin)
    if count == 0:
        return np.empty(0, np.int64)
    hops = np.append(np.flatnonzero(following[:-1] != begin[1:]), count - 1)
    target = np.searchsorted(begin, following[hops])
    after, used, hop, end = np.searchsorted(hops, target).tolist(), [], 0, len(hops)
    while hop < end:
        used.append(hop)
        hop = after[hop]
    met = np.zeros(count + 1, np.int8)
    met[0] = 1
    met[target[used[:-1]]] = 1
    met[hops[used] + 1] -= 1
    return np.flatnonzero(np.cumsum(met, dtype=np.int8)[:-1].view(np.bool_))
