"""Honest loss figures from MAVLink's 8-bit sequence numbers, one tracker per sender.

A swapped pair is one reordered frame and no loss; a repeated frame is one duplicate; a sender that starts its count
again is a restart, not a loss of two hundred. In eight bits a gap of 256 n frames looks like none.
"""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["DecoderCount", "LinkCount", "SequenceTracker"]

WINDOW = (
    64  # frames: how late one may come and still be recognised as late (a choice: 25 ms of 2,500 messages a second)
)


@dataclass(frozen=True, slots=True)
class LinkCount:
    """What came from one sender so far.

    received: frames.
    lost: net of those that came late after all.
    reordered: frames that came late.
    duplicated: frames that came twice.
    restarts: how often it began its count again.
    by_message: frames of each message id.
    """

    received: int
    lost: int
    reordered: int
    duplicated: int
    restarts: int
    by_message: Mapping[int, int]


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


class SequenceTracker:
    """Follows one sender's sequence numbers. `step` is on the hot path: all but the next number is left to `_jump`."""

    __slots__ = ("_duplicated", "_lost", "_missing", "_next", "_reordered", "_restarts", "_seen")

    def __init__(self, first: int) -> None:
        self._next = first
        self._seen: defaultdict[int, int] = defaultdict(int)
        self._missing: dict[int, int] = {}  # number -> frames received when it was missed
        self._lost = self._reordered = self._duplicated = self._restarts = 0

    def step(self, seq: int, msgid: int) -> None:
        """Count a frame with this sequence number and message id."""
        if seq == self._next:
            self._next = (seq + 1) & 0xFF
        else:
            self._jump(seq)
        self._seen[msgid] += 1

    def _jump(self, seq: int) -> None:
        received = sum(self._seen.values())
        distance = (seq - self._next + 128) % 256 - 128  # signed, modulo 256
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

    def count(self) -> LinkCount:
        """The figures so far, as a value that later frames do not change."""
        seen = dict(self._seen)
        return LinkCount(sum(seen.values()), self._lost, self._reordered, self._duplicated, self._restarts, seen)
