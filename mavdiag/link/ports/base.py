"""What every endpoint is (edge): bytes in with the host's time, bytes out, honest counts, and one way to wait."""

import errno
import os
import select
import time
from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TypeAlias

from mavdiag.errors import LinkError
from mavdiag.link.datagrams import Chunk, Datagrams, as_columns

SocketAddress: TypeAlias = tuple[str | int | bytes, ...]  # as the socket module resolves it

# An endpoint that lost its peer or device looks for it, while it is polled: after the first time, then after twice as
# long each time, up to the second (our choices). It begins anew when a connection has lasted longer than that.
RETRY_S, RETRY_MAX_S = 0.25, 4.0
_READ_BYTES = 65_536
_DRAIN_READS = 16  # reads per call, so that a flood cannot hold the caller

_NO_DEVICE = "no such device: plug it in, or look for its name with `ls /dev/tty*`"
_ADVICE = {
    errno.EADDRINUSE: "the port is busy: stop the program that holds it, or name another port",
    errno.EADDRNOTAVAIL: "this machine has no such address: use 127.0.0.1, or 0.0.0.0 for every network",
    errno.EACCES: "permission denied: use a port above 1023, or add yourself to the device's group (dialout)",
    errno.EPERM: "permission denied: a firewall or a sandbox forbids it",
    errno.ENETUNREACH: "no route to that network: check the host and this machine's network",
    errno.ECONNREFUSED: "the connection is refused: nobody listens there; start the other end, or check host and port",
    errno.EMFILE: "too many open files: close some, or raise `ulimit -n`",
    **dict.fromkeys((errno.ENOENT, errno.ENXIO, errno.ENODEV), _NO_DEVICE),
    **dict.fromkeys((errno.EBUSY, errno.EAGAIN), "the device is busy: stop the program that holds it"),
}


def link_error(address: str, error: OSError) -> LinkError:
    """The one-line error for an address that could not be opened: what happened and what to do."""
    advice = _ADVICE.get(error.errno or 0, error.strerror or str(error).splitlines()[0])
    return LinkError(f"{address}: {advice}")


@dataclass(slots=True)
class Traffic:
    """What an endpoint did since it was opened."""

    received: int = 0  # chunks handed to the caller: datagrams, or reads of a byte stream
    sent: int = 0  # messages handed to the system, one count per peer
    dropped: int = 0  # those that did not get that far, or that the peer's host refused
    overflowed: int = 0  # datagrams that the system threw away, or its reader, because they were too many
    turned_away: int = 0  # clients of a server that were too many, idle, or sent nothing but garbage


class Endpoint(AbstractContextManager["Endpoint"]):
    """One end of a link. Once it is open, nothing that the peer or the wire does raises.

    address: in the notation of `open_endpoint`, with the port that was really bound.
    datagrams: whether a chunk is a datagram, so that what it leaves unfinished must not be joined to the next one.
    absent: why the other end could not be reached the last time that it was tried, in one line. traffic: so far.
    """

    datagrams = False
    absent = ""

    def __init__(self, address: str) -> None:
        self.address, self.traffic = address, Traffic()
        self._trust: Sequence[SocketAddress] = ()
        self._alone = False

    @property
    @abstractmethod
    def connected(self) -> bool:
        """Whether a message sent now has somebody to go to, as far as this side can know."""

    @abstractmethod
    def filenos(self) -> tuple[int, ...]:
        """The descriptors that become readable when there is something to receive; none while disconnected."""

    def receive(self, timeout_s: float) -> Datagrams:
        """Wait up to `timeout_s` for the first chunk, then take what is there (bounded). Empty if nothing came."""
        until = time.monotonic() + timeout_s
        while not (chunks := self._drain()) and (left := until - time.monotonic()) > 0:
            wait([self], min(left, RETRY_S))
        self.traffic.received += len(chunks)
        return chunks

    def trust(self, sources: Collection[SocketAddress], *, alone: bool) -> None:
        """Name the senders that a flood of strangers must not hide. alone: only they are answered."""
        self._trust, self._alone = tuple(sources), alone

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Send one message to every peer, now or never: what cannot go at once is dropped and counted."""

    def answer(self, data: bytes, source: object) -> None:
        """Send one message to the sender of a chunk only, if it is still there; or to the one other end there is."""
        self.send(data)

    @abstractmethod
    def close(self) -> None:
        """Let go of the port or device. Closing twice is harmless; a closed endpoint receives and sends nothing."""

    @abstractmethod
    def _drain(self) -> Datagrams:
        """Take what is there without waiting; reconnect if it is time to."""

    def __exit__(self, *_: object) -> None:
        self.close()


def wait(endpoints: Iterable[Endpoint], timeout_s: float) -> list[Endpoint]:
    """Wait until an endpoint has something to receive, at most `timeout_s`. Returns those that have (may be none).

    A disconnected endpoint has nothing to wait for: receive from it now and then, so that it can reconnect.
    """
    poll = select.poll()
    owner = {fileno: endpoint for endpoint in endpoints for fileno in endpoint.filenos()}
    for fileno in owner:
        poll.register(fileno, select.POLLIN)
    ready = poll.poll(max(0.0, timeout_s) * 1e3)
    return list({id(owner[fileno]): owner[fileno] for fileno, _ in ready}.values())


class Stream:
    """One connected, non-blocking byte stream over a descriptor. Messages go out whole or not at all."""

    def __init__(self, fileno: int, close: Callable[[], None]) -> None:
        self.fileno, self.close = fileno, close
        self._tail = b""  # the rest of a message that the system took only in part
        self.error: OSError | None = None  # that ended it

    def read(self, most_bytes: int = _READ_BYTES) -> bytes | None:
        """What is there; b"" if nothing; None if the stream has ended."""
        try:
            return os.read(self.fileno, most_bytes) or None
        except BlockingIOError:
            return b""
        except OSError as error:
            self.error = error
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
        except (BlockingIOError, BrokenPipeError):  # full, or ended: the next read shows which
            return False
        except OSError as error:  # the system says it once, to who asks first
            self.error = error
            return False


class Reconnecting(Endpoint):
    """One stream that is opened again, while it is polled, after it has ended: see `RETRY_S`."""

    def __init__(self, address: str) -> None:
        super().__init__(address)
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
        taken = self._stream is not None and self._stream.write(data)
        self.traffic.sent += taken
        self.traffic.dropped += not taken

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
        now = time.monotonic()
        if self._stream is not None and now - self._opened_at > RETRY_MAX_S:
            self._pause_s = RETRY_S
        self._retry_at = now + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, RETRY_MAX_S)

    def _drain(self) -> Datagrams:
        if self._stream is None and time.monotonic() >= self._retry_at:
            try:
                self._begin()
            except OSError as error:  # still absent: the next retry may find it
                self.absent = str(link_error(self.address, error))
                self._wait()
        chunks: list[Chunk] = []
        while self._stream is not None and len(chunks) < _DRAIN_READS:
            data = self._stream.read()
            if data is None:
                self.absent = str(link_error(self.address, self._stream.error)) if self._stream.error else ""
                self._hang_up()
            elif data:
                self.absent = ""
                chunks.append((data, time.monotonic_ns()))
            else:
                break
        return as_columns(chunks)
