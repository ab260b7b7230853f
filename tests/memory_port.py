"""An endpoint pair inside one process; messages keep their order, and none is lost while fewer than `capacity` wait."""

import os
import time
from collections import deque
from collections.abc import Callable

from mavdiag.link.datagrams import Datagrams, as_columns
from mavdiag.link.ports.base import Endpoint


class _Mailbox:
    """A bounded queue of messages with a descriptor that is readable while something waits in it."""

    def __init__(self, capacity: int) -> None:
        self.fileno = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self.open, self._capacity = True, capacity
        self._messages: deque[bytes] = deque()

    def put(self, data: bytes) -> bool:
        if not self.open or len(self._messages) >= self._capacity:
            return False
        if not self._messages:
            os.eventfd_write(self.fileno, 1)
        self._messages.append(data)
        return True

    def take(self) -> list[bytes]:
        if not self.open or not self._messages:
            return []
        os.eventfd_read(self.fileno)
        return [self._messages.popleft() for _ in range(len(self._messages))]

    def close(self) -> None:
        if self.open:
            self.open = False
            os.close(self.fileno)

    __del__ = close


class MemoryEndpoint(Endpoint):
    """One end of a `memory_pair`, which makes it."""

    datagrams = True

    def __init__(self, address: str, inbox: _Mailbox, outbox: _Mailbox, clock: Callable[[], int]) -> None:
        super().__init__(address)
        self._inbox, self._outbox, self._clock = inbox, outbox, clock

    @property
    def connected(self) -> bool:
        return self._inbox.open and self._outbox.open

    def filenos(self) -> tuple[int, ...]:
        return (self._inbox.fileno,) if self._inbox.open else ()

    def send(self, data: bytes) -> None:
        """Put one message into the peer's mailbox; dropped and counted if that is full, or either end is closed."""
        if self.connected and self._outbox.put(data):
            self.traffic.sent += 1
        else:
            self.traffic.dropped += 1

    def close(self) -> None:
        self._inbox.close()

    def _drain(self) -> Datagrams:
        return as_columns([(data, self._clock()) for data in self._inbox.take()])


def memory_pair(
    *, capacity: int = 65_536, clock: Callable[[], int] = time.monotonic_ns
) -> tuple[MemoryEndpoint, MemoryEndpoint]:
    """Two connected endpoints; what one sends the other receives. `capacity`: messages that may wait at each end.

    >>> near, far = memory_pair(clock=lambda: 7)
    >>> near.send(b"hello")
    >>> list(far.receive(timeout_s=0.0))
    [(b'hello', 7)]
    """
    one, other = _Mailbox(capacity), _Mailbox(capacity)
    return MemoryEndpoint("memory:near", one, other, clock), MemoryEndpoint("memory:far", other, one, clock)
