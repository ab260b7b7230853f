"""What a TCP client and a serial device share: one byte stream that is opened again after it has ended."""

import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable

from mavdiag.link.ports.base import RETRY_MAX_S, RETRY_S, Chunk, Clock, Endpoint

_READ_BYTES = 65_536
_DRAIN_READS = 16  # reads per call, so that a flood cannot hold the caller


class Stream:
    """One connected, non-blocking byte stream over a descriptor. Messages go out whole or not at all."""

    def __init__(self, fileno: int, close: Callable[[], None]) -> None:
        self.fileno, self.close = fileno, close
        self._tail = b""  # the rest of a message that the system took only in part

    def read(self, most_bytes: int = _READ_BYTES) -> bytes | None:
        """What is there; b"" if nothing; None if the stream has ended."""
        try:
            return os.read(self.fileno, most_bytes) or None
        except BlockingIOError:
            return b""
        except OSError:
            return None

    def write(self, data: bytes) -> bool:
        """Whether the message was taken. If only part of it fits, the rest goes before the next message."""
        try:
            if self._tail:
                self._tail = self._tail[os.write(self.fileno, self._tail) :]
            if self._tail:
                return False
            self._tail = data[os.write(self.fileno, data) :]
            return True
        except OSError:  # full, or ended: the next read shows which
            return False


class Reconnecting(Endpoint, ABC):
    """One stream that is opened again, while it is polled, after it has ended: see `RETRY_S`."""

    def __init__(self, address: str, clock: Clock) -> None:
        super().__init__(address, clock)
        self._stream: Stream | None = None
        self._retry_at = 0.0  # monotonic clock [s]; infinite once closed
        self._opened_at, self._pause_s = 0.0, RETRY_S

    @abstractmethod
    def _open(self) -> Stream:
        """Open the stream. Raises OSError."""

    @property
    def connected(self) -> bool:
        """Whether the stream is open."""
        return self._stream is not None

    def filenos(self) -> tuple[int, ...]:
        """The stream's descriptor, while there is one."""
        return () if self._stream is None else (self._stream.fileno,)

    def send(self, data: bytes) -> None:
        """Send one message whole, or drop and count it."""
        if self._stream is not None and self._stream.write(data):
            self._count.sent += 1
        else:
            self._count.dropped += 1

    def close(self) -> None:
        """Close the stream for good."""
        self._hang_up()
        self._retry_at = float("inf")

    def _begin(self) -> None:
        self._stream, self._opened_at = self._open(), time.monotonic()

    def _hang_up(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._wait()
        self._stream = None

    def _wait(self) -> None:
        """Set the time of the next try."""
        now = time.monotonic()
        if self._stream is not None and now - self._opened_at > RETRY_MAX_S:
            self._pause_s = RETRY_S
        self._retry_at = now + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, RETRY_MAX_S)

    def _drain(self) -> list[Chunk]:
        if self._stream is None and time.monotonic() >= self._retry_at:
            try:
                self._begin()
            except OSError:  # still absent: the next retry may find it
                self._wait()
                return []
        chunks: list[Chunk] = []
        while self._stream is not None and len(chunks) < _DRAIN_READS:
            data = self._stream.read()
            if data is None:
                self._hang_up()
            elif data:
                chunks.append((data, self._clock()))
            else:
                break
        return chunks
