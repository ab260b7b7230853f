"""The senders on a link: where each is heard from, and honest loss figures from MAVLink's 8-bit sequence numbers.

A swapped pair is one reordered frame and no loss; a repeated frame is one duplicate; a sender that starts its count
again is a restart, not a loss of two hundred. In eight bits a gap of 256 n frames looks like none.

A sender is heard from one source (a network address) as long as it is heard there: frames in its name from another are
refused, and so is everything in a name that is ours. Where somebody forges the source too, two different frames of one
running number, one right after the other, show it: neither is believed. Made-up senders cost a bounded amount: those
that sent least make room.
"""

from collections import defaultdict
from collections.abc import Container, Hashable, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.telemetry import IntArray
from mavdiag.units import NS_PER_S

__all__ = ["PINNED_S", "DecoderCount", "Intruder", "LinkCount", "Senders", "SequenceTracker", "Source"]

Source: TypeAlias = Hashable | None
"""Where bytes came from: an address, or None on a link that has one end only."""

WINDOW = 64  # frames: how late one may come and still be known as late (a choice: 25 ms of 2,500 messages a second)
NEAR = 32  # places: a line that swaps frames moves them by less; of random numbers three in four are farther off
SENDERS_MAX = 512  # senders that are followed at a time (our choice)
CLASH = 8  # places: so near behind a frame another one with its number is another sender's, not a late one (our choice)
PINNED_S = 3.0  # a sender must be silent for so long before it may come from elsewhere: as a link is lost (our choice)


@dataclass(frozen=True, slots=True)
class LinkCount:
    """What came from one sender so far.

    received: frames.
    lost: net of those that came late after all.
    reordered: frames that came late.
    duplicated: frames that came twice.
    restarts: how often it began its count again.
    clashes: frames whose number another, different frame had just had.
    by_message: frames of each message id.
    """

    received: int
    lost: int
    reordered: int
    duplicated: int
    restarts: int
    by_message: Mapping[int, int]
    clashes: int = 0


@dataclass(frozen=True, slots=True)
class DecoderCount:
    """What a decoder made of its input so far, besides the frames themselves.

    garbage_bytes: bytes outside any accepted frame.
    bad_crc: seeming frames with a wrong checksum.
    incompatible: seeming frames with incompatibility flags that we do not know.
    unknown: frames outside the dialect.
    """

    garbage_bytes: int
    bad_crc: int
    incompatible: int
    unknown: int


@dataclass(frozen=True, slots=True)
class Intruder:
    """Another source that sends in a sender's name.

    source: the latest one.
    frames: refused so far.
    """

    source: Source
    frames: int


class SequenceTracker:
    """Follows one sender's sequence numbers. `step` is on the hot path: all but the next number is left to `_jump`.

    source: where the sender is heard from.
    heard_ns: when its last frame was received [ns].
    intruder: who else uses its name, if anybody does.
    clashes: frames whose number another, different frame had just had.
    contested: numbers of clashes that nobody has looked at yet.
    """

    __slots__ = (
        "_duplicated",
        "_far",
        "_jumps",
        "_lost",
        "_missing",
        "_next",
        "_reordered",
        "_restarts",
        "_seen",
        "_sums",
        "clashes",
        "contested",
        "heard_ns",
        "intruder",
        "source",
    )

    def __init__(self, first: int, source: Source = None, heard_ns: int = 0) -> None:
        self.source, self.heard_ns = source, heard_ns
        self.intruder: Intruder | None = None
        self.contested = set[int]()
        self._sums = [-1] * 256  # checksum of the latest frame of each number
        self._next = first
        self._seen: defaultdict[int, int] = defaultdict(int)
        self._missing: dict[int, int] = {}  # number -> frames received when it was missed
        self._lost = self._reordered = self._duplicated = self._restarts = self._jumps = self._far = self.clashes = 0

    def step(self, seq: int, msgid: int, checksum: int = -1) -> None:
        """Count a frame with this sequence number, message id and checksum."""
        if seq == self._next:
            self._next = (seq + 1) & 0xFF
        else:
            if (self._next - seq) & 0xFF <= CLASH and self._sums[seq] not in (-1, checksum):
                self._clash(seq)
            self._jump(seq, self.received)
        self._sums[seq] = checksum
        self._seen[msgid] += 1

    def _clash(self, seq: int) -> None:
        if seq not in self._missing:
            self.clashes += 1
            self.contested.add(seq)

    def run(self, seqs: NDArray[np.uint8], msgids: IntArray) -> None:
        """As `step` for each of these frames in turn, (n,) each; a stretch that goes on regularly is one step."""
        count, received = len(seqs), self.received
        odd = np.flatnonzero(seqs[1:] - seqs[:-1] != 1) + 1  # modulo 256, as the numbers are
        after = iter([*odd.tolist(), count])
        at = stretch_end = 0
        while at < count:
            seq = int(seqs[at])
            if seq == self._next:
                self._next = (seq + 1) & 0xFF
            else:
                self._jump(seq, received + at)
            at += 1
            while stretch_end < at:
                stretch_end = next(after)
            if at < stretch_end and self._next == (seq + 1) & 0xFF:
                at = stretch_end
                self._next = (int(seqs[at - 1]) + 1) & 0xFF
        times = np.bincount(msgids + 1)  # UNKNOWN is -1
        for place in np.flatnonzero(times).tolist():
            self._seen[place - 1] += int(times[place])

    def _jump(self, seq: int, received: int) -> None:
        distance = (seq - self._next + 128) % 256 - 128  # signed, modulo 256
        self._jumps += 1
        self._far += abs(distance) > NEAR
        if -WINDOW <= distance < 0:
            missed_at = self._missing.pop(seq, None)
            if missed_at is not None and received - missed_at <= WINDOW:
                self._reordered += 1
                self._lost -= 1
            else:
                self._duplicated += 1
            return
        if distance > 0:
            self._lost += distance
            self._missing = {number: at for number, at in self._missing.items() if received - at <= WINDOW}
            self._missing |= {number % 256: received for number in range(seq + 256 - min(distance, WINDOW), seq + 256)}
        else:
            self._restarts += 1
            self._missing = {}
        self._next = (seq + 1) & 0xFF

    @property
    def received(self) -> int:
        """Frames so far."""
        return sum(self._seen.values())

    @property
    def sound(self) -> bool:
        """Whether its numbers are those of one sender.

        Of eight frames or more most follow on, or of three all; or of 32 frames three quarters are no farther off than
        a line moves them that swaps frames.
        """
        received, jumps = self.received, self._jumps
        in_order = received >= 3 and 2 * jumps < received - 1 and (received >= 8 or jumps == 0)
        return in_order or (received >= NEAR and 4 * self._far <= received)

    def count(self) -> LinkCount:
        """The figures so far, as a value that later frames do not change."""
        seen = dict(self._seen)
        return LinkCount(
            self.received, self._lost, self._reordered, self._duplicated, self._restarts, seen, self.clashes
        )


class Senders:
    """All senders of one link, at most `SENDERS_MAX`, by system and component id.

    kept: keys (system id << 8 | component id) that never make room.
    ours: keys in whose name nobody else is heard.
    impostors: who used them all the same, by key.
    """

    def __init__(self, kept: Container[int] = (), ours: Container[int] = ()) -> None:
        self.kept, self.ours = kept, ours
        self.impostors: dict[int, Intruder] = {}
        self._trackers: dict[int, SequenceTracker] = {}

    def note(self, key: int, seq: int, msgid: int, host_ns: int, source: Source, checksum: int = -1) -> bool:
        """Count a frame of a sender. False if it is not heard, because the sender is alive at another source."""
        tracker = self._trackers.get(key)
        if tracker is None or tracker.source != source:
            if not self.admits(key, host_ns, source):
                return False
            if tracker is None:
                tracker = self._added(key, SequenceTracker(seq, source, host_ns))
            tracker.source = source
        tracker.heard_ns = host_ns
        tracker.step(seq, msgid, checksum)
        return True

    def admits(self, key: int, host_ns: int, source: Source) -> bool:
        """Whether a frame of a sender may come from there; if not, it is counted as an intruder's."""
        tracker = self._trackers.get(key)
        if tracker is None:
            if key not in self.ours:
                return True
            before = self.impostors.get(key)
            self.impostors[key] = Intruder(source, 1 if before is None else before.frames + 1)
            return False
        if tracker.source == source or host_ns - tracker.heard_ns >= PINNED_S * NS_PER_S:
            return True
        before = tracker.intruder
        tracker.intruder = Intruder(source, 1 if before is None else before.frames + 1)
        return False

    def note_all(self, keys: NDArray[np.uint16], seqs: NDArray[np.uint8], msgids: IntArray, host_ns: IntArray) -> None:
        """As `note` for each of these frames in turn, (n,) each, on a link that has one end only."""
        found = np.flatnonzero(np.bincount(keys)).tolist()
        if len(self._trackers.keys() | set(found)) > SENDERS_MAX:  # some must make room: the order matters
            for each in zip(keys.tolist(), seqs.tolist(), msgids.tolist(), host_ns.tolist(), strict=True):
                self.note(*each, source=None)
            return
        if len(found) == 1:
            self._note_run(found[0], seqs, msgids, host_ns)
            return
        rows = [(key, np.flatnonzero(keys == key)) for key in found]
        for key, own in sorted(rows, key=lambda one: int(one[1][0])):
            self._note_run(key, seqs[own], msgids[own], host_ns[own])

    def _note_run(self, key: int, seqs: NDArray[np.uint8], msgids: IntArray, host_ns: IntArray) -> None:
        tracker = self._trackers.get(key)
        if tracker is None:
            tracker = self._added(key, SequenceTracker(int(seqs[0])))
        tracker.heard_ns = int(host_ns[-1])
        tracker.run(seqs, msgids)

    def get(self, sysid: int, compid: int) -> SequenceTracker | None:
        """One sender; None if it is not followed."""
        return self._trackers.get(sysid << 8 | compid)

    def counts(self) -> dict[tuple[int, int], LinkCount]:
        """Figures of each sender, by (system id, component id)."""
        return {(key >> 8, key & 0xFF): tracker.count() for key, tracker in self._trackers.items()}

    def _added(self, key: int, tracker: SequenceTracker) -> SequenceTracker:
        if len(self._trackers) >= SENDERS_MAX:
            ranked = sorted(self._trackers.values(), key=attrgetter("received"), reverse=True)
            floor = ranked[SENDERS_MAX // 2].received
            self._trackers = {
                other: one for other, one in self._trackers.items() if other in self.kept or one.received > floor
            }
        self._trackers[key] = tracker
        return tracker
