"""UDP endpoints: `udpin` listens and answers its senders, `udpout` exchanges datagrams with one peer."""

import socket
import time

from mavdiag.link.ports.base import Chunk, Clock, Endpoint, SocketAddress, link_error

__all__ = ["PEERS_MAX", "PEER_FRESH_S", "UdpIn", "UdpOut"]

PEERS_MAX = 32  # peers that udpin answers; a further one is received but not answered while all of these are fresh
PEER_FRESH_S = 10.0  # a peer that was silent for so long is forgotten

_DATAGRAM_MAX = 65_535
_DRAIN_MAX = 1024  # datagrams per call, so that a flood cannot hold the caller
_BUFFER_BYTES = 8 << 20  # seconds of 2000 datagrams/s; Linux accounts for several hundred bytes each
_SO_RCVBUFFORCE = 33  # <asm-generic/socket.h>: beyond net.core.rmem_max, for the privileged
_SO_RXQ_OVFL = 40  # <asm-generic/socket.h>: datagrams dropped so far, given with the next one that is read
_OVFL_SPACE = socket.CMSG_SPACE(4)


class _Udp(Endpoint):
    """What both directions share: one non-blocking socket, its large buffer and its overflow count."""

    datagrams = True

    def __init__(self, address: str, family: socket.AddressFamily, clock: Clock) -> None:
        super().__init__(address, clock)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER_BYTES)
        except PermissionError:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)

    def filenos(self) -> tuple[int, ...]:
        """The socket's descriptor."""
        return () if self._socket.fileno() < 0 else (self._socket.fileno(),)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _drain(self) -> list[Chunk]:
        chunks: list[Chunk] = []
        if self._socket.fileno() < 0:
            return chunks
        try:
            # The first read asks for the overflow count, which costs more; the others only for the data.
            data, ancillary, _, peer = self._socket.recvmsg(_DATAGRAM_MAX, _OVFL_SPACE)
            for level, kind, value in ancillary:
                if (level, kind) == (socket.SOL_SOCKET, _SO_RXQ_OVFL):
                    self._overflowed = int.from_bytes(value, "little")
            while True:
                now_ns = self._clock()
                self._note_sender(peer)
                chunks.append((data, now_ns))
                if len(chunks) == _DRAIN_MAX:
                    break
                data, peer = self._socket.recvfrom(_DATAGRAM_MAX)
        except BlockingIOError:
            pass
        except OSError:  # an earlier datagram came back refused, or the network is down: nothing was received
            self._refused()
        return chunks

    def _note_sender(self, peer: SocketAddress) -> None:
        """Note the sender of a datagram."""

    def _refused(self) -> None:
        """Note that the peer's host sent a datagram back."""

    def _send_to(self, data: bytes, peer: SocketAddress) -> None:
        try:
            self._socket.sendto(data, peer)
            self._sent += 1
        except OSError:  # a full buffer, no route, too long, closed: the datagram is gone either way
            self._dropped += 1


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

    def send(self, data: bytes) -> None:
        """Send to every fresh peer; with none, the message is dropped and counted."""
        peers = self._fresh_peers()
        if not peers:
            self._dropped += 1
        for peer in peers:
            self._send_to(data, peer)

    def _note_sender(self, peer: SocketAddress) -> None:
        if peer in self._peers or len(self._peers) < PEERS_MAX or len(self._fresh_peers()) < PEERS_MAX:
            self._peers[peer] = time.monotonic()

    def _fresh_peers(self) -> list[SocketAddress]:
        horizon = time.monotonic() - self._fresh_s
        for peer in [peer for peer, sent in self._peers.items() if sent < horizon]:
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
                self._sent += 1
                return
            except ConnectionRefusedError:
                self._refused()
            except OSError:  # a full buffer, no route, too long, closed
                break
        self._dropped += 1

    def _note_sender(self, peer: SocketAddress) -> None:
        self._answered = True

    def _refused(self) -> None:
        self._answered = False
        if self._sent:
            self._sent -= 1
            self._dropped += 1
