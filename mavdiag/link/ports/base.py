"""What every endpoint is: bytes in with the host's time, bytes out, honest counts, and one way to wait.

Edge module: file descriptors and the host clock live here and in the modules beside it.
"""

import errno
import select
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Self, TypeAlias

from mavdiag.errors import LinkError

Chunk: TypeAlias = tuple[bytes, int]  # the bytes as they came, and the host clock [ns] when they were read
Clock: TypeAlias = Callable[[], int]  # the host clock [ns]
SocketAddress: TypeAlias = tuple[str | int | bytes, ...]  # as the socket module resolves it

# An endpoint that lost its peer or device looks for it, while it is polled: after the first time, then after twice as
# long each time, up to the second (our choices). It begins anew when a connection has lasted longer than that.
RETRY_S, RETRY_MAX_S = 0.25, 4.0

_NO_DEVICE = "no such device: plug it in, or look for its name with `ls /dev/tty*`"
_ADVICE = {
    errno.EADDRINUSE: "the port is busy: stop the program that holds it, or name another port",
    errno.EADDRNOTAVAIL: "this machine has no such address: use 127.0.0.1, or 0.0.0.0 for every network",
    errno.EACCES: "permission denied: use a port above 1023, or add yourself to the device's group (dialout)",
    errno.EPERM: "permission denied: a firewall or a sandbox forbids it",
    errno.ENETUNREACH: "no route to that network: check the host and this machine's network",
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
    """What an endpoint did since it was opened.

    received: chunks handed to the caller (datagrams, or reads of a byte stream). sent: messages handed to the system,
    one count per peer; dropped: those that did not get that far, or that the peer's host refused. overflowed: datagrams
    that the system threw away because nobody read them in time. turned_away: clients of a server that were turned away
    or hung up on: too many, idle, or nothing but garbage.
    """

    received: int = 0
    sent: int = 0
    dropped: int = 0
    overflowed: int = 0
    turned_away: int = 0


class Endpoint(ABC):
    """One end of a link. Once it is open, nothing that the peer or the wire does raises.

    datagrams: whether a chunk is a datagram, so that what it leaves unfinished must not be joined to the next one.
    sources: the sender of each chunk that the latest `receive` returned; empty where there is one other end.
    """

    datagrams = False
    sources: Sequence[SocketAddress] = ()

    def __init__(self, address: str, clock: Clock) -> None:
        self._address = address
        self._clock = clock
        self._count = Traffic()
        self._trust: Sequence[SocketAddress] = ()
        self._alone = False

    @property
    def address(self) -> str:
        """The address in the notation of `open_endpoint`, with the port that was really bound."""
        return self._address

    @property
    def traffic(self) -> Traffic:
        """The counts so far."""
        return replace(self._count)

    @property
    @abstractmethod
    def connected(self) -> bool:
        """Whether a message sent now has somebody to go to, as far as this side can know."""

    @abstractmethod
    def filenos(self) -> tuple[int, ...]:
        """The descriptors that become readable when there is something to receive; none while disconnected."""

    def receive(self, timeout_s: float) -> list[Chunk]:
        """Wait up to `timeout_s` for the first chunk, then take what is there (bounded). Empty if nothing came."""
        until = time.monotonic() + timeout_s
        while not (chunks := self._drain()) and (left := until - time.monotonic()) > 0:
            wait([self], min(left, RETRY_S))
        self._count.received += len(chunks)
        return chunks

    def trust(self, sources: Collection[SocketAddress], *, alone: bool) -> None:
        """Name the senders that matter. Where strangers can send too, a flood of theirs does not hide these.

        alone: only they are answered.
        """
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
    def _drain(self) -> list[Chunk]:
        """Take what is there without waiting; reconnect if it is time to."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
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
