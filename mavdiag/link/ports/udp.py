"""UDP endpoints: `udpin` listens and answers its senders, `udpout` exchanges datagrams with one peer.

A flood hides nobody that `udpin` trusts: a trusted peer gets a socket of its own, connected to it, and with it a buffer
of its own, for the kernel prefers a connected socket. The strangers share what is left: so many datagrams a second are
read, and the rest overflows in the kernel, unread.

Datagrams are read many at a time, by recvmmsg(2): a call for each one of them takes most of a receiver's time.
"""

import ctypes
import os
import socket
import sys
import time
from collections.abc import Collection, Iterable, Sequence
from itertools import repeat

import numpy as np

from mavdiag.link.ports.base import Chunk, Clock, Endpoint, SocketAddress, link_error

PEERS_MAX = 32  # peers that udpin answers; a further one is received but not answered while all of these are fresh
PEER_FRESH_S = 10.0  # a peer that was silent for so long is forgotten
TRUSTED_MAX = 128  # peers that get a socket of their own (our choice)
STRANGERS_HZ = 20_000.0  # datagrams that are read of all strangers while any peer is trusted (our choice)
STRANGERS_BURST = 1024.0
UNIT_BYTES = 64  # a large datagram counts as several: once for each so many bytes

_DATAGRAM_MAX = 65_535
_DRAIN_MAX = 1024  # datagrams per call, so that a flood cannot hold the caller
_BUFFER_BYTES = 8 << 20  # seconds of 2000 datagrams/s; Linux accounts for several hundred bytes each
_SO_RCVBUFFORCE = 33  # <asm-generic/socket.h>: beyond net.core.rmem_max, for the privileged
_SO_RXQ_OVFL = 40  # <asm-generic/socket.h>: datagrams dropped so far, given with the next one that is read
AT_ONCE = 64  # datagrams in one call
PEERS_KNOWN = 1024  # addresses that are kept taken apart
_NAME_BYTES, _CONTROL_BYTES = 28, socket.CMSG_SPACE(4)  # of a sockaddr_in6; of the overflow count
# <sys/socket.h>, struct mmsghdr: where a message goes, and how long it is.
_HEADER = np.dtype(
    [
        *(("name", "P"), ("name_bytes", "u4"), ("places", "P"), ("place_count", "P"), ("control", "P")),
        *(("control_bytes", "P"), ("flags", "P"), ("size", "u4")),
    ],
    align=True,
)
_receive_many = ctypes.CDLL(None, use_errno=True).recvmmsg


class _Mailbag:
    """Room for the datagrams of one call."""

    def __init__(self) -> None:
        self._data = np.empty((AT_ONCE, _DATAGRAM_MAX + 1), np.uint8)  # what is not touched costs nothing
        self._names, self._control = np.zeros((AT_ONCE, _NAME_BYTES), np.uint8), np.zeros(_CONTROL_BYTES, np.uint8)
        self._places = np.array([(row.ctypes.data, _DATAGRAM_MAX) for row in self._data], np.uintp)
        self._headers = np.zeros(AT_ONCE, _HEADER)
        self._headers["name"] = [row.ctypes.data for row in self._names]
        self._headers["places"] = [row.ctypes.data for row in self._places]
        self._headers["place_count"] = 1
        self._headers["control"][0] = self._control.ctypes.data
        self._peers: dict[bytes, SocketAddress] = {}

    def take(self, fileno: int, most: int) -> tuple[list[bytes], list[SocketAddress]]:
        """What is there, at most so many, and the sender of each. Raises OSError."""
        headers = self._headers
        headers["name_bytes"], headers["control_bytes"][0] = _NAME_BYTES, _CONTROL_BYTES
        place, flags = ctypes.c_void_p(headers.ctypes.data), socket.MSG_DONTWAIT
        count = _receive_many(fileno, place, min(most, AT_ONCE), flags, None)
        if count < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        sizes = headers["size"][:count].tolist()
        longest = max(1, *sizes)
        data, names = self._data[:count, :longest].tobytes(), self._names[:count].tobytes()
        places = range(0, count * longest, longest)
        pieces = [data[at : at + size] for at, size in zip(places, sizes, strict=True)]
        own = names[:_NAME_BYTES]
        if names == own * count:
            return pieces, [self._peer(own)] * count
        return pieces, [self._peer(names[at : at + _NAME_BYTES]) for at in range(0, len(names), _NAME_BYTES)]

    @property
    def overflowed(self) -> int | None:
        """How many datagrams the system has thrown away at the socket of the latest call; None if it did not say."""
        told = int(self._headers["control_bytes"][0]) >= socket.CMSG_LEN(4)
        kind = self._control[8:16].view("i4").tolist()
        return int(self._control[16:20].view("u4")[0]) if told and kind == [socket.SOL_SOCKET, _SO_RXQ_OVFL] else None

    def _peer(self, name: bytes) -> SocketAddress:
        """An address as the socket module has it."""
        found = self._peers.get(name)
        if found is None:
            if len(self._peers) >= PEERS_KNOWN:
                self._peers.clear()
            family, port = int.from_bytes(name[:2], sys.byteorder), int.from_bytes(name[2:4], "big")
            if family == socket.AF_INET:
                found = (socket.inet_ntop(socket.AF_INET, name[4:8]), port)
            else:
                flow, scope = int.from_bytes(name[4:8], "big"), int.from_bytes(name[24:28], sys.byteorder)
                found = (socket.inet_ntop(socket.AF_INET6, name[8:24]), port, flow, scope)
            self._peers[name] = found
        return found


class _Udp(Endpoint):
    """What both directions share: one non-blocking socket, its large buffer and its overflow count."""

    datagrams = True

    def __init__(self, address: str, family: socket.AddressFamily, clock: Clock) -> None:
        super().__init__(address, clock)
        self._socket, self._mail = _udp_socket(family), _Mailbag()
        self._lost: dict[int, int] = {}  # datagrams that the system threw away, by descriptor of an open socket
        self._lost_before = 0  # by closed ones

    def filenos(self) -> tuple[int, ...]:
        """The socket's descriptor."""
        return (self._socket.fileno(),) if self._socket.fileno() >= 0 else ()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _drain(self) -> list[Chunk]:
        chunks: list[Chunk] = []
        if self._socket.fileno() >= 0:
            self._read(self._socket, chunks, [], _DRAIN_MAX)
        return chunks

    def _read(self, link: socket.socket, chunks: list[Chunk], sources: list[SocketAddress], units: float) -> float:
        """Take what is there, as far as so many units allow; returns how many are left."""
        try:
            while units >= 1.0:
                taken, peers = self._mail.take(link.fileno(), int(units))
                now_ns = self._clock()
                if (lost := self._mail.overflowed) is not None:
                    self._lost[link.fileno()] = lost
                    self._count.overflowed = self._lost_before + sum(self._lost.values())
                self._note_senders(dict.fromkeys(peers))
                chunks += zip(taken, repeat(now_ns))
                sources += peers
                units -= len(taken) + sum(map(len, taken)) // UNIT_BYTES
                if len(taken) < AT_ONCE:
                    break
        except BlockingIOError:
            pass
        except OSError:  # an earlier datagram came back refused, or the network is down: nothing was received
            self._refused()
        return units

    def _note_senders(self, peers: Iterable[SocketAddress]) -> None:
        """Note the senders of datagrams."""

    def _refused(self) -> None:
        """Note that the peer's host sent a datagram back."""


class UdpIn(_Udp):
    """Listens on one port and answers the peers that sent: at most `PEERS_MAX`, each for `PEER_FRESH_S` of silence.

    Raises LinkError if the port cannot be bound.
    """

    def __init__(
        self, address: str, family: socket.AddressFamily, local: SocketAddress, clock: Clock, fresh_s: float
    ) -> None:
        super().__init__(address, family, clock)
        self._fresh_s = fresh_s
        self._peers: dict[SocketAddress, float] = {}  # when each sent last [s], monotonic clock
        self._trusted: dict[SocketAddress, socket.socket] = {}
        self._newly = False  # a peer has got its own socket, and what it sent before may wait in the common one
        self._units, self._filled_s = STRANGERS_BURST, time.monotonic()
        try:
            self._socket.bind(local)
        except OSError as error:
            self._socket.close()
            raise link_error(address, error) from error
        self._address = f"{address.rpartition(':')[0]}:{self._socket.getsockname()[1]}"

    @property
    def connected(self) -> bool:
        """Whether a peer sent something lately."""
        return self._socket.fileno() >= 0 and bool(self._fresh_peers())

    def filenos(self) -> tuple[int, ...]:
        """The descriptors of all sockets."""
        return (*super().filenos(), *(link.fileno() for link in self._trusted.values()))

    def send(self, data: bytes) -> None:
        """Send to every fresh peer; with none, the message is dropped and counted."""
        self._send_to(data, self._fresh_peers())

    def answer(self, data: bytes, source: object) -> None:
        """Send to one fresh peer; without it, the message is dropped and counted."""
        self._send_to(data, [peer for peer in self._fresh_peers() if peer == source])

    def _send_to(self, data: bytes, peers: list[SocketAddress]) -> None:
        told = [peer for peer in peers if peer in self._trusted or not self._alone]
        self._count.dropped += not told
        for peer in told:
            try:
                self._socket.sendto(data, peer)
                self._count.sent += 1
            except OSError:  # a full buffer, no route, too long, closed: the datagram is gone either way
                self._count.dropped += 1

    def close(self) -> None:
        """Close the sockets."""
        self.trust((), alone=self._alone)
        super().close()

    def trust(self, sources: Collection[SocketAddress], *, alone: bool) -> None:
        """Give each of these a socket of its own (at most `TRUSTED_MAX`), and take it from all others."""
        super().trust(sources, alone=alone)
        for gone in [peer for peer in self._trusted if peer not in sources]:
            link = self._trusted.pop(gone)
            self._lost_before += self._lost.pop(link.fileno(), 0)
            link.close()
        for peer in sources:
            if peer not in self._trusted and len(self._trusted) < TRUSTED_MAX and self._socket.fileno() >= 0:
                own = _beside((self._socket, *self._trusted.values()), peer)
                if own is not None:
                    self._trusted[peer], self._newly = own, True
                    self._peers.setdefault(peer, time.monotonic())

    def _drain(self) -> list[Chunk]:
        chunks: list[Chunk] = []
        sources: list[SocketAddress] = []
        if self._socket.fileno() >= 0 and (self._newly or not self._trusted):
            self._read(self._socket, chunks, sources, _DRAIN_MAX)
            self._newly = False
        for link in self._trusted.values():
            self._read(link, chunks, sources, _DRAIN_MAX)
        if self._trusted and self._refilled() >= 1.0:
            self._units = self._read(self._socket, chunks, sources, self._units)
        self.sources = sources
        return chunks

    def _refilled(self) -> float:
        """How many datagrams of strangers may be read now."""
        now_s = time.monotonic()
        self._units = min(STRANGERS_BURST, self._units + STRANGERS_HZ * (now_s - self._filled_s))
        self._filled_s = now_s
        return self._units

    def _note_senders(self, peers: Iterable[SocketAddress]) -> None:
        for peer in peers:
            others = len(self._peers) - len(self._trusted)
            if peer in self._peers or others < PEERS_MAX or len(self._fresh_peers()) - len(self._trusted) < PEERS_MAX:
                self._peers[peer] = time.monotonic()

    def _fresh_peers(self) -> list[SocketAddress]:
        horizon = time.monotonic() - self._fresh_s
        for peer in [peer for peer, sent in self._peers.items() if sent < horizon and peer not in self._trusted]:
            del self._peers[peer]
        return list(self._peers)


class UdpOut(_Udp):
    """Talks to one peer. An absent peer is no error: what its host refuses is counted as dropped."""

    def __init__(self, address: str, family: socket.AddressFamily, remote: SocketAddress, clock: Clock) -> None:
        super().__init__(address, family, clock)
        self._answered = True
        try:
            self._socket.connect(remote)
        except OSError as error:
            self._socket.close()
            raise link_error(address, error) from error

    @property
    def connected(self) -> bool:
        """Whether the peer's host has not refused the latest datagrams."""
        return self._answered and self._socket.fileno() >= 0

    def send(self, data: bytes) -> None:
        """Send to the peer. A refusal belongs to an earlier datagram, so this one is tried once more."""
        for _ in range(2):
            try:
                self._socket.send(data)
                self._count.sent += 1
                return
            except ConnectionRefusedError:
                self._refused()
            except OSError:  # a full buffer, no route, too long, closed
                break
        self._count.dropped += 1

    def _note_senders(self, peers: Iterable[SocketAddress]) -> None:
        self._answered = True

    def _refused(self) -> None:
        self._answered = False
        if self._count.sent:
            self._count.sent -= 1
            self._count.dropped += 1


def _udp_socket(family: socket.AddressFamily) -> socket.socket:
    """A socket that never waits, with a large buffer and an overflow count."""
    link = socket.socket(family, socket.SOCK_DGRAM)
    link.setblocking(False)
    link.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
    try:
        link.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER_BYTES)
    except PermissionError:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    return link


def _beside(bound: Sequence[socket.socket], peer: SocketAddress) -> socket.socket | None:
    """A socket on the same port that gets what this peer sends; None if the system has none left.

    bound: all that have the port, the listening one first. All must allow it to be shared as another one is bound;
    afterwards it is theirs alone again.
    """
    link = _udp_socket(bound[0].family)
    try:
        for one in (*bound, link):
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        link.bind(bound[0].getsockname())
        link.connect(peer)
    except OSError:
        link.close()
        return None
    finally:
        for one in (*bound, link):
            if one.fileno() >= 0:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
    return link
