"""The senders on a link: where each is heard from, and honest loss figures from MAVLink's 8-bit sequence numbers.

A swapped pair is one reordered frame and no loss; a repeated frame is one duplicate; a sender that starts its count
again is a restart, not a loss of two hundred. In eight bits a gap of 256 n frames looks like none. What is repeated,
byte by byte within half a second, as two radios or routers in a ring do, is heard once.

A sender is heard from one source (a network address) as long as it is heard there; everything in a name that is ours is
refused. Two different frames of one running number, one right after the other, show two senders: neither is believed.
Made-up senders cost a bounded amount: those that sent least make room.
"""

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.jit import cached_loop, jit
from mavdiag.telemetry import IntArray
from mavdiag.units import NS_PER_S

Source: TypeAlias = Hashable | None  # where bytes came from: an address, or None on a link that has one end only

WINDOW = 64  # frames: how late one may come and still be known as late (a choice: 25 ms of 2,500 messages a second)
NEAR = 32  # places: a line that swaps frames moves them by less; of random numbers three in four are farther off
SENDERS_MAX = 512  # senders that are followed at a time (our choice)
REPEATED_NS = NS_PER_S // 2  # by so much a copy may be later than the frame (our choice)
CLASH = 8  # places: so near behind a frame another one with its number is another sender's, not a late one (our choice)
PINNED_S = 3.0  # a sender must be silent for so long before it may come from elsewhere: as a link is lost (our choice)
SOURCES_MAX = 4 * SENDERS_MAX  # sources that have a number at a time
_PINNED_NS = round(PINNED_S * NS_PER_S)

REFUSED, HEARD = 0, 1  # what becomes of a frame
_KEPT, _OURS = 1, 2  # flags of a sender

#: A frame as it lies in a buffer: when it was received; the places of its marker, its payload, its checksum and behind
#: it; the number of its source; the row of its message (`codec.ROWS`); its sender (system id << 8 | component id) and
#: running number; and what became of it.
_PLACES = [(name, "i4") for name in ("begin", "body", "stop", "after", "source")]
FRAME = np.dtype(
    [("host_ns", "i8"), *_PLACES, ("row", "i2"), ("sender", "u2"), ("seq", "u1"), ("heard", "u1")], align=True
)
PLAIN = np.dtype((np.void, FRAME.itemsize))  #: its bytes: numpy copies them twenty times as fast

# One sender. sums, times: checksum of the latest frame of each number, plus 1, and when it came [ns]; missed: how many
# frames had been received when a number was missed, plus 1; contested: numbers of clashes that nobody looked at yet.
_COUNTS = ("received", "lost", "reordered", "duplicated", "restarts", "clashes")
_OTHERS = ("key", "source", "heard_ns", "next", "jumps", "far", "intruder", "refused")
_SENDER = np.dtype(
    [
        *((name, "i8") for name in _COUNTS + _OTHERS),
        ("missed", "i8", 256),
        ("sums", "i4", 256),
        ("times", "i8", 256),
        ("contested", "i4", 256),
    ]
)


@dataclass(frozen=True, slots=True)
class LinkCount:
    """What came from one sender, or in its name, so far, in frames."""

    received: int = 0  # without duplicates
    lost: int = 0  # net of those that came late after all (reordered)
    reordered: int = 0
    duplicated: int = 0
    restarts: int = 0  # how often it began its count again
    by_message: Mapping[int, int] = field(default_factory=dict)
    clashes: int = 0  # whose number another, different frame had just had
    source: Source = None  # where it is heard from
    heard_ns: int = 0  # when it was last heard
    ours: bool = False  # whether its name is ours, and nobody else's
    refused: int = 0  # of other sources that send in its name
    intruder: Source = None  # the latest of these


class Senders:
    """All senders of one link, at most `SENDERS_MAX`, by key: system id << 8 | component id.

    msgids: message of each row; the last one stands for all that are unknown.
    """

    def __init__(self, msgids: Sequence[int] = (0,)) -> None:
        self._msgids = msgids
        # Most of these pages are never touched, and cost nothing.
        self._senders, self._seen = np.zeros(SENDERS_MAX, _SENDER), np.zeros((SENDERS_MAX, len(msgids)), np.int64)
        self._places, self._flags = np.zeros(1 << 16, np.uint16), np.zeros(1 << 16, np.uint8)
        self._used = 0
        self._numbers: dict[Source, int] = {None: 0}
        self._sources: dict[int, Source] = {0: None}
        self._latest = 0  # number of a source

    def keep(self, key: int) -> None:
        """Let a sender never make room."""
        self._flags[key] |= _KEPT

    def claim(self, keys: Iterable[int], *, ours: bool = True) -> None:
        """Hear nobody else in these names, for they are ours; or let others use them again."""
        for key in keys:
            self._flags[key] = self._flags[key] & (0xFF ^ _OURS) | _OURS * ours

    def numbers(self, sources: Sequence[Source]) -> list[int]:
        """The numbers that stand for sources in `FRAME`: those of frames that are heard before the next call."""
        if len(self._sources) >= SOURCES_MAX:
            used = self._senders[: self._used]
            held = {0, *used["source"].tolist(), *used["intruder"].tolist()}
            self._sources = {number: source for number, source in self._sources.items() if number in held}
            self._numbers = {source: number for number, source in self._sources.items()}
        for source in dict.fromkeys(sources):
            if source not in self._numbers:
                self._latest += 1
                self._numbers[source], self._sources[self._latest] = self._latest, source
        return list(map(self._numbers.__getitem__, sources))

    def hear(self, data: NDArray[np.uint8], rows: NDArray[np.void]) -> None:
        """Count these frames, in order of arrival, and note in `heard` what becomes of each.

        data: the bytes that they lie in.
        """
        done, memory = 0, (self._senders, self._seen, self._places, self._flags)
        while True:
            done, self._used = _hear(data, rows, done, *memory, self._used)
            if done >= len(rows):
                break
            self._make_room()

    def admits(self, row: np.void) -> bool:
        """Whether the sender of a frame may come from where it came."""
        sender = self._row(int(row["sender"]))
        ours = bool(self._flags[row["sender"]] & _OURS)
        return not ours if sender is None else _admits(sender, row, ours)

    def _make_room(self) -> None:
        received = self._senders["received"]
        kept = (received > np.sort(received)[-1 - SENDERS_MAX // 2]) | (self._flags[self._senders["key"]] & _KEPT > 0)
        self._used = int(np.count_nonzero(kept))
        for memory in (self._senders, self._seen):
            memory[: self._used] = memory[kept]
            memory[self._used :] = 0
        self._places[:] = 0
        self._places[self._senders["key"][: self._used]] = 1 + np.arange(self._used)

    def _row(self, key: int) -> np.void | None:
        place = int(self._places[key])
        return self._senders[place - 1] if place else None

    def source(self, key: int) -> Source:
        """Where a sender is heard from; None if it is not followed."""
        row = self._row(key)
        return None if row is None else self._sources[int(row["source"])]

    def sound(self, key: int) -> bool:
        """Whether a sender's numbers are those of one sender.

        Of eight frames or more most follow on, or of three all; or of 32 frames three quarters are no farther off than
        a line moves them that swaps frames.
        """
        row = self._row(key)
        received, jumps, far = (0, 0, 0) if row is None else (int(row[name]) for name in ("received", "jumps", "far"))
        in_order = received >= 3 and 2 * jumps < received - 1 and (received >= 8 or jumps == 0)
        return in_order or (received >= NEAR and 4 * far <= received)

    @property
    def clashed(self) -> frozenset[int]:
        """The senders of which two frames ever had one number."""
        used = self._senders[: self._used]
        return frozenset(used["key"][used["clashes"] > 0].tolist())

    def contested(self, key: int) -> IntArray:
        """The numbers that two senders claimed since the last call."""
        row = self._senders[int(self._places[key]) - 1]
        found = np.flatnonzero(row["contested"])
        row["contested"][:] = 0
        return found

    def count(self, key: int) -> LinkCount | None:
        """Figures of one sender; None if it is not followed."""
        row = self._row(key)
        if row is None:
            return None
        seen = self._seen[self._places[key] - 1]
        by_message = {self._msgids[at]: int(seen[at]) for at in np.flatnonzero(seen).tolist()}
        source, intruder = (self._sources[int(row[name])] for name in ("source", "intruder"))
        figures = {name: int(row[name]) for name in (*_COUNTS, "heard_ns", "refused")}
        ours = bool(self._flags[key] & _OURS)
        return LinkCount(by_message=by_message, source=source, intruder=intruder, ours=ours, **figures)

    def counts(self) -> dict[tuple[int, int], LinkCount]:
        """Figures of each sender, by (system id, component id)."""
        keys = self._senders["key"][: self._used].tolist()
        return {(key >> 8, key & 0xFF): count for key in keys if (count := self.count(key))}


Fields: TypeAlias = Any  # one record, as numba has it


@jit
def _jump(sender: Fields, seq: int, clash: bool) -> None:
    received = sender.received
    distance = (seq - sender.next + 128) % 256 - 128  # signed, modulo 256
    sender.jumps += 1
    sender.far += int(abs(distance) > NEAR)
    if -WINDOW <= distance < 0:
        if sender.missed[seq] and received + 1 - sender.missed[seq] <= WINDOW:
            sender.reordered += 1
            sender.lost -= 1
        else:
            sender.duplicated += not clash
        sender.missed[seq] = 0
        return
    if distance > 0:
        sender.lost += distance
        for back in range(1, min(distance, WINDOW) + 1):
            sender.missed[(seq - back) % 256] = received + 1
    else:
        sender.restarts += 1
        sender.missed[:] = 0
    sender.next = (seq + 1) % 256


def _admits(sender: Fields, frame: Fields, ours: bool) -> bool:
    """Whether a sender may come from where a frame of it came."""
    if ours:
        return False
    pinned = sender["received"] > 0 and frame["host_ns"] - sender["heard_ns"] < _PINNED_NS
    return bool(sender["source"] == frame["source"] or not pinned)


_admits_in_loop = jit(_admits)  # what one frame asks does not wait for a compiler


@cached_loop
def _hear(
    data: NDArray[np.uint8],
    rows: NDArray[Any],
    first: int,
    senders: NDArray[Any],
    seen: IntArray,
    places: NDArray[np.uint16],
    flags: NDArray[np.uint8],
    used: int,
) -> tuple[int, int]:
    """How many frames are done before there is no room for one more sender, and how many senders there are."""
    for k in range(first, len(rows)):
        frame = rows[k]
        frame.heard = REFUSED
        if places[frame.sender] == 0:
            if used == len(senders):
                return k, used
            senders[used].key, senders[used].next = frame.sender, frame.seq
            used += 1
            places[frame.sender] = used
        sender, seq = senders[places[frame.sender] - 1], 0 + frame.seq
        if not _admits_in_loop(sender, frame, flags[frame.sender] & _OURS > 0):
            sender.intruder = frame.source
            sender.refused += 1
            continue
        sender.source, sender.heard_ns = frame.source, frame.host_ns
        checksum = (np.int64(data[frame.stop]) | np.int64(data[frame.stop + 1]) << 8) + 1
        if seq == sender.next:
            sender.next = (seq + 1) % 256
        elif sender.sums[seq] == checksum and frame.host_ns - sender.times[seq] < REPEATED_NS:
            sender.duplicated += 1
            continue
        else:
            near = (sender.next - seq) % 256 <= CLASH and sender.sums[seq] != 0 and sender.sums[seq] != checksum
            clash = near and not (sender.missed[seq] and sender.received + 1 - sender.missed[seq] <= WINDOW)
            sender.clashes += clash
            sender.contested[seq] = max(sender.contested[seq], int(clash))
            _jump(sender, seq, clash)
        sender.sums[seq], sender.times[seq] = checksum, frame.host_ns
        sender.received += 1
        seen[places[frame.sender] - 1, frame.row] += 1
        frame.heard = HEARD
    return len(rows), used
