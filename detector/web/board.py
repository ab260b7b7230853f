"""What the server keeps for its pages: the numbered entries, and the latest of each vehicle. No socket, no clock.

A line of the daemon has one letter for its kind, and what follows it:

    J NUMBER ENTRY     an entry of the journal; numbers follow each other without a hole
    F FLEET            the vehicles and the links, about once a second
    A VEHICLE ABOUT    what does not change while a vehicle is judged: its monitors, its drawing
    N VEHICLE NOW      the vehicle at this moment, while somebody looks at it
    P PLAYING          of a replay: where it is
    C RUN              of a replay: it jumped, and all begins anew as another run
"""

import json
from collections import deque
from dataclasses import dataclass, field
from itertools import islice

KEPT = 10_000  # entries
FIRST = 500  # entries that a page gets which asks for none
STRIP_PARTS = 110  # snapshots of a vehicle that are kept: over 20 s of strips
BATCH = 1000  # entries that one answer holds at most: one page that catches up must not hold the others


class Board:
    """run: of the daemon; numbers of one run mean nothing in another one."""

    def __init__(self, run: str) -> None:
        self.run, self.entries = run, deque[tuple[int, str]](maxlen=KEPT)
        self.fleet = self.playing = ""
        self.about, self.now, self.readers = dict[int, str](), dict[int, deque[str]](), set[Reader]()

    @property
    def newest(self) -> int:
        """Number of the newest entry, 0 before the first."""
        return self.entries[-1][0] if self.entries else 0

    @property
    def watched(self) -> tuple[int, ...]:
        """The vehicles that somebody looks at."""
        return tuple(sorted({reader.vehicle for reader in self.readers if reader.vehicle is not None}))

    def take(self, line: str) -> None:
        """A line of the daemon; one that is none changes nothing."""
        kind, _, rest = line.partition(" ")
        head, _, content = rest.partition(" ")
        if kind == "F":
            self.fleet = rest
            self._give(None, "fleet", rest)
        elif kind == "P":
            self.playing = rest
            self._give(None, "playing", rest)
        elif kind == "C":
            self.run = rest
            for held in (self.entries, self.about, self.now):
                held.clear()
            for reader in self.readers:
                reader.waiting.clear()
                reader.begin(None)
        elif not head.isdecimal():
            return
        elif kind == "J" and int(head) > self.newest:
            if int(head) != self.newest + 1:  # the daemon kept no more: numbers that are kept have no hole
                self.entries.clear()
            self.entries.append((int(head), content))
        elif kind == "A":
            self.about[int(head)] = content
            self.now.pop(int(head), None)  # strips of another chain
            self._give(int(head), "about", content)
        elif kind == "N":
            self.now.setdefault(int(head), deque(maxlen=STRIP_PARTS)).append(content)
            self._give(int(head), "now", content)

    def _give(self, vehicle: int | None, kind: str, content: str) -> None:
        for reader in self.readers:
            if vehicle in (None, reader.vehicle):
                reader.waiting.append((kind, content))

    def enter(self, vehicle: int | None, last: int | None) -> "Reader":
        """A page begins to read. last: number of the last entry that it has; None for a page that is new."""
        reader = Reader(self, vehicle)
        reader.begin(last)
        state = (("playing", self.playing), ("fleet", self.fleet), ("about", self.about.get(vehicle or -1, "")))
        reader.waiting.extend((kind, content) for kind, content in state if content)
        reader.waiting.extend(("now", part) for part in self.now.get(vehicle or -1, ()))
        self.readers.add(reader)
        return reader


@dataclass(slots=True, eq=False)
class Reader:
    """One page's stream. A page that is too slow loses the oldest of what waits; entries are never left out."""

    board: Board
    vehicle: int | None  # that it looks at; None for none yet
    sent: int = 0  # number of the last entry that it was given
    waiting: deque[tuple[str, str]] = field(default_factory=lambda: deque(maxlen=2 * STRIP_PARTS))  # beside entries

    def begin(self, last: int | None) -> None:
        """Say which run it is. last: as in `Board.enter`."""
        board = self.board
        self.sent = max(0, board.newest - FIRST) if last is None else last
        hello = {"run": board.run, "newest": board.newest, "fresh": last is None}
        self.waiting.append(("hello", json.dumps(hello)))

    def next(self) -> bytes:
        """Server-sent events for what came since the last call; empty if nothing did."""
        parts = [f"event: {kind}\ndata: {content}\n\n" for kind, content in self.waiting]
        self.waiting.clear()
        entries = self.board.entries
        if entries and entries[-1][0] > self.sent:
            skip = max(0, self.sent + 1 - entries[0][0])
            for number, content in islice(entries, skip, skip + BATCH):
                parts.append(f"event: entry\nid: {self.board.run}-{number}\ndata: {content}\n\n")
                self.sent = number
        return "".join(parts).encode()


def is_vehicle(text: str) -> bool:
    """Whether a text is a number that may be a system id."""
    return text.isascii() and text.isdecimal() and len(text) < 4


def parse_last(text: str | None, run: str) -> int | None:
    """The number in a Last-Event-ID of this run; None if there is none.

    >>> parse_last("a1-17", "a1"), parse_last("b2-17", "a1"), parse_last("a1-x", "a1"), parse_last(None, "a1")
    (17, None, None, None)
    """
    of, _, number = (text or "").rpartition("-")
    return int(number) if of == run and number.isascii() and number.isdecimal() and len(number) < 16 else None
