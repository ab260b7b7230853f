"""A bad link in a box: what a radio, a router or a noisy cable does to messages, on a virtual clock and from a seed.

In this order: a message is lost, changed in one bit, sent twice, overtaken by the next ones, queued for a line of so
many bytes a second, and delayed with a jitter of its own, as the network emulator of Linux does.
"""

import heapq
import random
from dataclasses import dataclass

from mavdiag.units import NS_PER_MS, NS_PER_S

HOLD_NS = 250 * NS_PER_MS  # a message that waits to be overtaken waits no longer than this (our choice)
QUEUE_NS = NS_PER_S  # what would wait longer for the line is thrown away (our choice: a radio's buffer holds as much)


@dataclass(frozen=True, slots=True)
class Impairment:
    """What a link does to messages."""

    loss: float = 0.0  # probability, as of the next two
    jitter_s: float = 0.0  # a message takes delay_s give or take it, or from 0 to twice jitter_s if that is more
    reorder: int = 0  # by how many following messages one is overtaken at most; by each number equally often
    duplicate: float = 0.0
    corrupt: float = 0.0
    rate: float | None = None  # bytes a second; None for no limit
    delay_s: float = 0.0


@dataclass(slots=True)
class ShimCount:
    """What became of the messages so far."""

    offered: int = 0
    passed: int = 0  # second copies included
    lost: int = 0  # by chance
    overflowed: int = 0  # lost because the line was too slow
    duplicated: int = 0
    corrupted: int = 0  # changed in a bit
    reordered: int = 0  # went out after a later one


class Shim:
    """One direction of a bad link. `offer` messages as they come, send what is `due`. count: the figures so far."""

    def __init__(self, impairment: Impairment, seed: int = 0) -> None:
        self._does, self._random = impairment, random.Random(seed)
        self._delay_ns = max(impairment.delay_s, impairment.jitter_s) * NS_PER_S
        self._held: list[tuple[int, int, int, bytes]] = []  # overtaken at this message, or at this time; number, data
        self._waiting: list[tuple[int, int, int, bytes]] = []  # a heap: due [ns], how many went before, number, data
        self._free_ns = 0  # when the line is free
        self._copies = self._released = 0
        self._highest = -1  # number of the latest message that went out, in the order that they came in
        self.count = ShimCount()

    def offer(self, data: bytes, now_ns: int) -> None:
        """A message comes in. now_ns: never before that of an earlier call."""
        does, draw = self._does, self._random.random
        self.count.offered += 1
        lost, changed, twice = draw() < does.loss, draw() < does.corrupt, draw() < does.duplicate
        if lost:
            self.count.lost += 1
            return
        if changed and data:
            self.count.corrupted += 1
            bit = self._random.randrange(8 * len(data))
            data = data[: bit // 8] + bytes([data[bit // 8] ^ 1 << bit % 8]) + data[bit // 8 + 1 :]
        self.count.duplicated += twice
        for _ in range(1 + twice):
            self._hold(data, now_ns)

    def due(self, now_ns: int) -> list[bytes]:
        """The messages that go out by now, in their order."""
        self._release([message for message in self._held if message[1] <= now_ns])
        found = []
        while self._waiting and self._waiting[0][0] <= now_ns:
            _, _, number, data = heapq.heappop(self._waiting)
            self.count.passed += 1
            self.count.reordered += number < self._highest
            self._highest = max(self._highest, number)
            found.append(data)
        return found

    def _hold(self, data: bytes, now_ns: int) -> None:
        """Let a message wait for those that overtake it, and those go that waited for it."""
        number = self._copies
        self._copies += 1
        places = self._random.randint(0, self._does.reorder) if self._does.reorder else 0
        if places:
            self._held.append((number + places, now_ns + HOLD_NS, number, data))
        else:
            self._send(data, number, now_ns)
        self._release([message for message in self._held if message[0] <= number], now_ns)

    def _release(self, messages: list[tuple[int, int, int, bytes]], now_ns: int | None = None) -> None:
        for message in messages:
            self._held.remove(message)
            self._send(message[3], message[2], message[1] if now_ns is None else now_ns)

    def _send(self, data: bytes, number: int, now_ns: int) -> None:
        does = self._does
        if does.rate is not None:
            start_ns = max(now_ns, self._free_ns)
            if start_ns - now_ns > QUEUE_NS:
                self.count.overflowed += 1
                return
            now_ns = self._free_ns = start_ns + round(len(data) / does.rate * NS_PER_S)
        jitter_ns = (2.0 * self._random.random() - 1.0) * does.jitter_s * NS_PER_S if does.jitter_s else 0.0
        heapq.heappush(self._waiting, (now_ns + round(self._delay_ns + jitter_ns), self._released, number, data))
        self._released += 1
