"""The frames of a telemetry log, a window of it at a time: found by one compiled loop, handed out as columns.

The loop is that of `codec.Decoder.take`, whose words are there; a time stamp stands before each frame. Checksums are
taken eight bytes at a time by tables ("slicing by eight", Kounavis and Berry 2005).
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mavdiag.jit import cached
from mavdiag.link.batch import AUTOPILOT, Batch, Column
from mavdiag.link.codec import UNKNOWN, Frame, known_messages
from mavdiag.link.sequence import Senders
from mavdiag.link.signing import SEAL_BYTES
from mavdiag.telemetry import IntArray
from mavdiag.units import NS_PER_US

STAMP_BYTES = 8  # before each frame: microseconds since 1970, most significant first
LATEST_US = 1 << 52  # year 2112: a later stamp is damage, whatever follows it
LONGEST = 10 + 255 + 2 + SEAL_BYTES  # bytes of a frame: header, payload, checksum, signature
V1, V2 = 0xFE, 0xFD
SHORTEST = STAMP_BYTES + 8
_REFLECTED = 0x8408  # of CRC-16/MCRF4XX: 0x1021, bits in reverse
_BEGIN, _BODY, _STOP, _AFTER, _MSGID, _SENDER, _SEQ, _TIME_US = range(8)  # what is noted of a frame


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The frames of one message in a window, of all senders, in order of arrival.

    places: (n,) which of the window's sound frames they are.
    payloads: (n, size) as on the wire, with the trimmed zeros put back and unknown extensions cut off.
    host_ns: (n,) when they were received [ns].
    sender: (n,) system id << 8 | component id.
    seq: (n,) the sender's running numbers.
    """

    places: IntArray
    payloads: NDArray[np.uint8]
    host_ns: IntArray
    sender: IntArray
    seq: IntArray

    def of(self, sender: int) -> Column | None:
        """The frames of one sender; None if there are none."""
        own = self.sender == sender
        if own.all():
            return Column(self.places, self.payloads, self.host_ns)
        return Column(self.places[own], self.payloads[own], self.host_ns[own]) if own.any() else None


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """The wanted frames of a window of a log.

    size: sound frames of any kind.
    rows: by message.
    """

    size: int
    rows: Mapping[int, Rows]

    def heard(self) -> dict[int, int]:
        """When the first frame of each system id came [ns], of all components."""
        first: dict[int, tuple[int, int]] = {}
        for rows in self.rows.values():
            sysids, at = np.unique(rows.sender >> 8, return_index=True)
            for sysid, k in zip(sysids.tolist(), at.tolist(), strict=True):
                seen = (int(rows.places[k]), int(rows.host_ns[k]))
                first[sysid] = min(seen, first.get(sysid, seen))
        return {sysid: host_ns for sysid, (_, host_ns) in first.items()}

    def vehicle(self, sysid: int) -> Batch:
        """What one vehicle's autopilot sent."""
        columns = {msgid: own for msgid, rows in self.rows.items() if (own := rows.of(sysid << 8 | AUTOPILOT))}
        first = sorted(columns, key=lambda msgid: int(columns[msgid].places[0]))
        return Batch(self.size, {msgid: columns[msgid] for msgid in first})

    def frames(self, msgids: Collection[int] | None = None) -> list[Frame]:
        """The wanted frames one by one, in order of arrival. msgids: of which messages; None for all."""
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
        return [frame for _, frame in sorted(placed, key=lambda each: each[0])]


class LogDecoder:
    """Windows of a telemetry log in, their frames out, wherever the windows cut it.

    wanted: messages that are handed out; the others are checked and counted as well.
    records: sound frames of any kind so far. damaged: bytes that are in no sound record.
    size: bytes so far. sound_end: place behind the last sound frame.
    """

    def __init__(self, wanted: Collection[int]) -> None:
        known = known_messages()
        self._sizes = {msgid: known[msgid][0] for msgid in sorted(wanted)}
        self.senders = Senders()
        self.records = self.damaged = self.size = self.sound_end = 0
        self._data, self._held = np.empty(0, np.uint8), 0  # with room behind the bytes for the longest frame

    def feed(self, window: bytes, last: bool) -> Window:
        """Take the next window. last: the log ends with it; else it ends before the first frame that may go beyond."""
        size = self._held + len(window)
        if len(self._data) < size + LONGEST:
            self._data = np.concatenate((self._data[: self._held], np.zeros(len(window) + 2 * LONGEST, np.uint8)))
        data = self._data
        data[self._held : size] = np.frombuffer(window, np.uint8)
        # Where a frame must begin before, so that the window surely holds it and the first byte of the next one.
        limit = size if last else max(STAMP_BYTES, size - LONGEST - STAMP_BYTES)
        found = np.empty((8, size // SHORTEST + 1), np.int64)
        found = found[:, : _find(data, size, limit, last, _seeds(), _tables(), found)]
        resume = size if last else limit - STAMP_BYTES
        count, taken = found.shape[1], 0
        if count:
            self.sound_end = self.size + int(found[_AFTER, -1])
            resume = max(resume, int(found[_AFTER, -1]))
            taken = int((found[_AFTER] - found[_BEGIN]).sum()) + STAMP_BYTES * count
            senders, seqs = found[_SENDER].astype(np.uint16), found[_SEQ].astype(np.uint8)
            self.senders.note_all(senders, seqs, found[_MSGID], found[_TIME_US] * NS_PER_US)
        self.records, self.damaged = self.records + count, self.damaged + resume - taken
        decoded = Window(count, self._rows(found))
        self.size, self._held = self.size + resume, size - resume
        data[: self._held] = data[resume:size].copy()
        return decoded

    def _rows(self, found: IntArray) -> dict[int, Rows]:
        """The wanted frames by message."""
        keys = np.minimum(found[_MSGID], 0xFFFF).astype(np.uint16)  # sorted by radix; no wanted message is beyond
        order = np.argsort(keys, kind="stable")
        msgids = keys[order]
        rows = {}
        for msgid, size in self._sizes.items():
            first, last = np.searchsorted(msgids, (msgid, msgid + 1)).tolist()
            if first < last:
                rows[msgid] = _rows(self._data, found, order[first:last], size)
        return rows


def _rows(data: NDArray[np.uint8], found: IntArray, places: IntArray, size: int) -> Rows:
    body = found[_BODY][places]
    anywhere = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))  # a payload at every byte
    payloads = anywhere[body].view(np.uint8).reshape(len(places), size)
    lengths = found[_STOP][places] - body
    if int(lengths.min()) < size:
        kept = np.tri(size + 1, size, -1, np.uint8) * np.uint8(0xFF)  # row: length of the payload
        payloads &= kept[np.minimum(lengths, size)]
    return Rows(places, payloads, found[_TIME_US][places] * NS_PER_US, found[_SENDER][places], found[_SEQ][places])


@cache
def _seeds() -> NDArray[np.int16]:
    """By message, the byte that its definition adds to the checksum; -1 where there is no such message.

    The last one stands for all ids beyond.
    """
    known = known_messages()
    seeds = np.full(max(known) + 2, -1, np.int16)
    for msgid, (_, seed) in known.items():
        seeds[msgid] = seed
    return seeds


@cache
def _tables() -> NDArray[np.uint16]:
    """(8, 256): what a byte makes of the checksum that stands 0 to 7 bytes behind it."""
    tables = np.zeros((8, 256), np.uint16)
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ (_REFLECTED if crc & 1 else 0)
        tables[0, byte] = crc
    for k in range(1, 8):
        tables[k] = tables[k - 1] >> np.uint16(8) ^ tables[0, tables[k - 1] & 0xFF]
    return tables


@cached
def _find(
    data: NDArray[np.uint8],
    size: int,
    limit: int,
    last: bool,
    seeds: NDArray[np.int16],
    tables: NDArray[np.uint16],
    found: IntArray,
) -> int:
    """Write down the sound frames, a column each; returns how many.

    Of each is noted the place of the marker, of the payload, of the checksum and behind the frame; message
    (`codec.UNKNOWN` outside the dialect), sender, running number and time since 1970 [us].
    """
    zero = np.int64(0)  # `zero +` makes a byte a signed number for numba
    count, at, beyond = 0, STAMP_BYTES, len(seeds) - 1
    while at < limit:
        marker, begin = data[at], at
        at += 1
        if (marker != V2 and marker != V1) or data[begin - 8] != 0 or data[begin - 7] >= LATEST_US >> 48:
            continue
        body, header, flags, msgid = begin + 6, begin + 2, zero, zero + data[begin + 5]
        if marker == V2:
            body, header, flags = begin + 10, begin + 4, zero + data[begin + 2]
            msgid = (zero + data[begin + 7]) | (zero + data[begin + 8]) << 8 | (zero + data[begin + 9]) << 16
        stop = body + data[begin + 1]
        after = stop + 2 + SEAL_BYTES * flags
        following = after + STAMP_BYTES
        if flags > 1 or after > size:
            continue
        seed = zero + seeds[min(msgid, beyond)]
        if seed < 0:  # it cannot be checked: it counts if another frame follows, or the end
            goes_on = following < size and (data[following] == V1 or data[following] == V2)
            if not goes_on and not (last and after == size):
                continue
            msgid = zero + UNKNOWN
        else:
            crc, k = zero + 0xFFFF, begin + 1
            while k + 8 <= stop:
                before, crc = crc, zero
                for j in range(8):
                    byte = zero + data[k + j]
                    if j < 2:
                        byte ^= before >> 8 * j & 0xFF
                    crc ^= tables[7 - j, byte]
                k += 8
            while k < stop:
                crc = crc >> 8 ^ tables[0, (crc ^ data[k]) & 0xFF]
                k += 1
            crc = crc >> 8 ^ tables[0, (crc ^ seed) & 0xFF]
            if crc != (zero + data[stop]) | (zero + data[stop + 1]) << 8:
                continue
        time_us = zero
        for j in range(begin - STAMP_BYTES, begin):
            time_us = time_us << 8 | data[j]
        sender = (zero + data[header + 1]) << 8 | (zero + data[header + 2])
        noted = (begin, body, stop, after, msgid, sender, zero + data[header], time_us)
        for j in range(8):
            found[j, count] = noted[j]
        count, at = count + 1, following
    return count
