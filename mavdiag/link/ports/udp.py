"""UDP endpoints: `udpin` listens and answers its senders, `udpout` exchanges datagrams with one peer.

A flood hides nobody that `udpin` trusts: a trusted peer gets a socket of its own, connected to it, and with it a buffer
of its own, for the kernel prefers a connected socket. The strangers share what is left: so many datagrams a second are
read, and the rest overflows in the kernel, unread.

Datagrams are read many at a time, by recvmmsg(2): a call for each one of them takes most of a receiver's time. The
kernel says when each arrived: a reader that was held up for seconds does not take them for a burst.
"""

import contextlib
import ctypes
import os
import socket
import struct
import sys
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from mavdiag.link.datagrams import Datagrams, end_to_end, joined_datagrams
from mavdiag.link.ports.base import Endpoint, SocketAddress, link_error
from mavdiag.units import NS_PER_S

PEERS_MAX = 32  # peers that udpin answers; a further one is received but not answered while all of these are fresh
PEER_FRESH_S = 10.0  # a peer that was silent for so long is forgotten
TRUSTED_MAX = 128  # peers that get a socket of their own (our choice)
STRANGERS_HZ = 20_000.0  # datagrams that are read of all strangers while any peer is trusted (our choice)
STRANGERS_BURST = 1024.0
UNIT_BYTES = 64  # a large datagram counts as several: once for each so many bytes

_ROOM = 65_536  # of a datagram
_DRAIN_MAX = 1024  # datagrams per call, so that a flood cannot hold the caller
_BUFFER_BYTES = 8 << 20  # seconds of 2000 datagrams/s; Linux accounts for several hundred bytes each
_SO_RCVBUFFORCE = 33  # <asm-generic/socket.h>: beyond net.core.rmem_max, for the privileged
# <asm-generic/socket.h>, <linux/sock_diag.h>: nine numbers, of which these are the bytes that wait and what was dropped
_SO_MEMINFO, _WAITING, _DROPS = 55, 0, 8
_OVERHEAD = 576  # bytes that the kernel accounts for a datagram beside its own, at least (<linux/skbuff.h>)
AT_ONCE = 256  # datagrams in one call
_NAME_BYTES = 28  # of a sockaddr_in6
# <sys/socket.h>, struct mmsghdr: where a message goes, and how long it is.
_HEADER = np.dtype(
    [
        *(("name", "P"), ("name_bytes", "u4"), ("places", "P"), ("place_count", "P"), ("control", "P")),
        *(("control_bytes", "P"), ("flags", "P"), ("size", "u4")),
    ],
    align=True,
)
# <linux/socket.h>, struct cmsghdr, with the timespec of a time stamp behind it.
_STAMP = np.dtype([("size", "P"), ("level", "i4"), ("kind", "i4"), ("s", "i8"), ("ns", "i8")])
_SO_TIMESTAMPNS_NEW = 64  # <asm-generic/socket.h>, since Linux 5.1
_STALL_NS = 60 * NS_PER_S  # no reader is held up for longer; the wall clock was set (our choice)
_receive_many = ctypes.CDLL(None, use_errno=True).recvmmsg


class _Mailbag:
    def __init__(self) -> None:
        self._data = np.empty((AT_ONCE, _ROOM), np.uint8)  # what is not touched costs nothing
        self._names = np.zeros((AT_ONCE, _NAME_BYTES), np.uint8)
        self._places = np.array([(row.ctypes.data, _ROOM) for row in self._data], np.uintp)
        self._stamps, self._headers = np.zeros(AT_ONCE, _STAMP), np.zeros(AT_ONCE, _HEADER)
        self._headers["name"] = [row.ctypes.data for row in self._names]
        self._headers["places"] = [row.ctypes.data for row in self._places]
        self._headers["place_count"] = 1
        self._headers["control"] = self._stamps.ctypes.data + _STAMP.itemsize * np.arange(AT_ONCE)
        end_to_end(self._data[:1], np.zeros(1, np.int64))  # it is loaded, or compiled, before anything comes

    def take(self, fileno: int, most: int) -> Datagrams:
        self._headers["name_bytes"], self._headers["control_bytes"] = _NAME_BYTES, _STAMP.itemsize
        place = ctypes.c_void_p(self._headers.ctypes.data)
        count = _receive_many(fileno, place, min(most, AT_ONCE), socket.MSG_DONTWAIT, None)
        if count < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        sizes = self._headers["size"][:count].astype(np.int64)
        now_ns, stamps = time.monotonic_ns(), self._stamps[:count]
        clocks_ns = max(time.monotonic_ns() - time.time_ns() for _ in range(3))  # held up in between, it is less
        arrived_ns = NS_PER_S * stamps["s"] + stamps["ns"] + clocks_ns
        arrived_ns[self._headers["control_bytes"][:count] < _STAMP.itemsize] = now_ns  # an older kernel
        arrived_ns[arrived_ns < now_ns - _STALL_NS] = now_ns
        names, whose = self._names[:count], np.zeros(count, np.int64)
        places = {name.tobytes(): 0 for name in names[:1]}
        if not (names == names[:1]).all():  # as on few links
            whose[:] = [places.setdefault(name.tobytes(), len(places)) for name in names]
        peers = tuple(map(_peer, places))
        return Datagrams(end_to_end(self._data, sizes), sizes, np.minimum(arrived_ns, now_ns), whose, peers)


@lru_cache(maxsize=1024)
def _peer(name: bytes) -> SocketAddress:
    """A sockaddr as the socket module has it."""
    family, port = int.from_bytes(name[:2], sys.byteorder), int.from_bytes(name[2:4], "big")
    if family == socket.AF_INET:
        return socket.inet_ntop(socket.AF_INET, name[4:8]), port
    flow, scope = int.from_bytes(name[4:8], "big"), int.from_bytes(name[24:28], sys.byteorder)
    return socket.inet_ntop(socket.AF_INET6, name[8:24]), port, flow, scope


class _Udp(Endpoint):
    datagrams = True

    def __init__(self, address: str, family: socket.AddressFamily) -> None:
        super().__init__(address)
        self._socket, self._mail = _udp_socket(family), _Mailbag()
        self._lost: dict[int, int] = {}  # datagrams that the system threw away, by descriptor

    def _attach(self, place: Callable[[SocketAddress], None], to: SocketAddress) -> None:
        try:
            place(to)
        except OSError as error:
            self._socket.close()
            raise link_error(self.address, error) from error

    def filenos(self) -> tuple[int, ...]:
        return (self._socket.fileno(),) if self._socket.fileno() >= 0 else ()

    def close(self) -> None:
        self._socket.close()

    def _drain(self) -> Datagrams:
        pieces = list[Datagrams]()
        if self._socket.fileno() >= 0:
            self._read(self._socket, pieces, _DRAIN_MAX)
        alone = [replace(piece, whose=np.zeros_like(piece.whose), peers=(None,)) for piece in pieces]
        return joined_datagrams(alone)

    def _read(self, link: socket.socket, pieces: list[Datagrams], units: float) -> float:
        """Take what is there, as far as so many units allow; returns how many are left."""
        account, place = _account(link), link.fileno()
        self.traffic.overflowed += account[_DROPS] - self._lost.get(place, 0)
        self._lost[place] = account[_DROPS]
        if link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self._refused()
        try:
            while units >= 1.0 and account[_WAITING]:
                taken = self._mail.take(place, int(units))
                pieces.append(taken)
                self._note_senders(taken.peers)
                units -= len(taken) + len(taken.data) // UNIT_BYTES
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
    """Listens on one port and answers the peers that sent: at most `PEERS_MAX`, each for `PEER_FRESH_S` of silence."""

    def __init__(self, address: str, family: socket.AddressFamily, local: SocketAddress) -> None:
        super().__init__(address, family)
        self._peers: dict[SocketAddress, float] = {}  # when each sent last [s], monotonic clock
        self._trusted: dict[SocketAddress, socket.socket] = {}
        self._before = 0  # bytes that may wait in the common socket of a peer that has got its own since
        self._units, self._filled_s = STRANGERS_BURST, time.monotonic()
        self._attach(self._socket.bind, local)
        self.address = f"{address.rpartition(':')[0]}:{self._socket.getsockname()[1]}"

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
        self.traffic.dropped += not told
        for peer in told:
            try:
                self._socket.sendto(data, peer)
                self.traffic.sent += 1
            except OSError:  # a full buffer, no route, too long, closed: the datagram is gone either way
                self.traffic.dropped += 1

    def close(self) -> None:
        """Close the sockets."""
        self.trust((), alone=self._alone)
        super().close()

    def trust(self, sources: Collection[SocketAddress], *, alone: bool) -> None:
        """Give each of these a socket of its own (at most `TRUSTED_MAX`), and take it from all others."""
        super().trust(sources, alone=alone)
        for gone in [peer for peer in self._trusted if peer not in sources]:
            link = self._trusted.pop(gone)
            self._lost.pop(link.fileno(), None)
            link.close()
        for peer in sources:
            if peer not in self._trusted and len(self._trusted) < TRUSTED_MAX and self._socket.fileno() >= 0:
                own = _beside((self._socket, *self._trusted.values()), peer)
                if own is not None:
                    self._trusted[peer], self._before = own, _account(self._socket)[_WAITING]
                    self._peers.setdefault(peer, time.monotonic())

    def _drain(self) -> Datagrams:
        pieces = list[Datagrams]()
        if self._socket.fileno() >= 0 and (self._before > 0 or not self._trusted):
            left = self._read(self._socket, pieces, _DRAIN_MAX)
            taken = sum(_OVERHEAD * len(piece) + len(piece.data) for piece in pieces)
            self._before = self._before - taken if left < 1.0 else 0
        for link in () if self._before > 0 else self._trusted.values():  # a peer's datagrams in their order
            self._read(link, pieces, _DRAIN_MAX)
        now_s = time.monotonic()
        self._units = min(STRANGERS_BURST, self._units + STRANGERS_HZ * (now_s - self._filled_s))
        self._filled_s = now_s
        if self._trusted and self._units >= 1.0:
            self._units = self._read(self._socket, pieces, self._units)
        return joined_datagrams(pieces)

    def _note_senders(self, peers: Iterable[SocketAddress]) -> None:
        for peer in peers:
            others = len(self._peers) - len(self._trusted)
            if peer in self._peers or others < PEERS_MAX or len(self._fresh_peers()) - len(self._trusted) < PEERS_MAX:
                self._peers[peer] = time.monotonic()

    def _fresh_peers(self) -> list[SocketAddress]:
        horizon = time.monotonic() - PEER_FRESH_S
        for peer in [peer for peer, sent in self._peers.items() if sent < horizon and peer not in self._trusted]:
            del self._peers[peer]
        return list(self._peers)


class UdpOut(_Udp):
    """Talks to one peer. An absent peer is no error: what its host refuses is counted as dropped."""

    def __init__(self, address: str, family: socket.AddressFamily, remote: SocketAddress) -> None:
        super().__init__(address, family)
        self._answered = True
        self._attach(self._socket.connect, remote)

    @property
    def connected(self) -> bool:
        """Whether the peer's host has not refused the latest datagrams."""
        return self._answered and self._socket.fileno() >= 0

    def send(self, data: bytes) -> None:
        """Send to the peer. A refusal belongs to an earlier datagram, so this one is tried once more."""
        for _ in range(2):
            try:
                self._socket.send(data)
                self.traffic.sent += 1
                return
            except ConnectionRefusedError:
                self._refused()
            except OSError:  # a full buffer, no route, too long, closed
                break
        self.traffic.dropped += 1

    def _note_senders(self, peers: Iterable[SocketAddress]) -> None:
        self._answered = True

    def _refused(self) -> None:
        self._answered = False
        if self.traffic.sent:
            self.traffic.sent -= 1
            self.traffic.dropped += 1


def _account(link: socket.socket) -> tuple[int, ...]:
    """What the kernel holds for a socket (`_SO_MEMINFO`)."""
    return struct.unpack("9I", link.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 36))


def _udp_socket(family: socket.AddressFamily) -> socket.socket:
    link = socket.socket(family, socket.SOCK_DGRAM)
    link.setblocking(False)
    with contextlib.suppress(OSError):
        link.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS_NEW, 1)
    try:
        link.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER_BYTES)
    except PermissionError:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    return link


def _beside(bound: Sequence[socket.socket], peer: SocketAddress) -> socket.socket | None:
    """A socket on the port of these that gets what this peer sends; None if the system has none left.

    All must allow the port to be shared as another one is bound; afterwards it is theirs alone again.
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
