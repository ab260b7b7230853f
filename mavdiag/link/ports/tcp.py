"""A TCP client that reconnects, and a TCP server for several clients."""

import socket
import time

from mavdiag.link.codec import Decoder, split_frames
from mavdiag.link.datagrams import Chunk, Datagrams, as_columns
from mavdiag.link.ports.base import Endpoint, Reconnecting, SocketAddress, Stream, link_error

CLIENTS_MAX = 16  # of a server: for a further one an idle one makes room, else that one is turned away
IDLE_S = 5.0  # without a frame, before a client may have to make room (our choice)
GARBAGE_BYTES = 16_384  # of a client in a row, without a frame, before it is hung up on (our choice)
_SHARED_BYTES = 131_072  # that a server reads per call, the same share of each client, so that none holds the caller
_DEAD_MS = 10_000  # a peer that acknowledges nothing for so long is gone


class TcpClient(Reconnecting):
    """Connects to one server, and again whenever the connection ends. An absent server is no error."""

    def __init__(self, address: str, family: socket.AddressFamily, remote: SocketAddress) -> None:
        super().__init__(address)
        self._family, self._remote = family, remote
        self._link: socket.socket | None = None
        self._drain()

    @property
    def connected(self) -> bool:
        """Whether the server has accepted."""
        try:
            return self._stream is not None and self._link is not None and bool(self._link.getpeername())
        except OSError:
            return False

    def _open(self) -> Stream:
        # A pending connection reads and writes as "nothing yet", and ends like an open one if it is refused later on.
        self._link = link = _tcp_socket(self._family)
        try:
            link.connect(self._remote)
        except BlockingIOError:
            pass
        except OSError:
            link.close()
            raise
        return Stream(link.fileno(), link.close)


class _Client(Stream):
    def __init__(self, link: socket.socket, name: SocketAddress) -> None:
        super().__init__(link.fileno(), link.close)
        self.name, self.heard_s = name, time.monotonic()  # its address; when its last frame came, or it did
        self._begun = b""  # of a frame that is not yet complete
        self._decoder = Decoder(())
        self._garbage_from = 0  # bytes up to its last sound frame

    @property
    def stuffed(self) -> bool:
        return self._decoder.size - self._garbage_from >= GARBAGE_BYTES

    def take(self, most_bytes: int) -> bytes | None:
        """What has come, cut between frames; None if the stream has ended, or brings nothing but garbage."""
        read = self.read(most_bytes)
        if not read:
            return read
        frames = self._decoder.records
        self._decoder.feed(read)
        if self._decoder.records > frames:
            self._garbage_from, self.heard_s = self._decoder.size, time.monotonic()
        data = self._begun + read
        _, self._begun = split_frames(data)
        return None if self.stuffed else data.removesuffix(self._begun)


class TcpServer(Endpoint):
    """Accepts up to `CLIENTS_MAX` clients; sends to all, and receives of all, cut between their frames."""

    def __init__(self, address: str, family: socket.AddressFamily, local: SocketAddress) -> None:
        super().__init__(address)
        self._listener = _tcp_socket(family)
        self._clients: list[_Client] = []
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind(local)
            self._listener.listen(CLIENTS_MAX)
        except OSError as error:
            self._listener.close()
            raise link_error(address, error) from error
        self.address = f"{address.rpartition(':')[0]}:{self._listener.getsockname()[1]}"

    @property
    def connected(self) -> bool:
        """Whether a client is there."""
        return bool(self._clients)

    def filenos(self) -> tuple[int, ...]:
        """The listener's descriptor and each client's."""
        if self._listener.fileno() < 0:
            return ()
        return (self._listener.fileno(), *(client.fileno for client in self._clients))

    def send(self, data: bytes) -> None:
        """Send to every client; with none, the message is dropped and counted."""
        self._write(data, self._clients)

    def answer(self, data: bytes, source: object) -> None:
        """Send to one client; without it, the message is dropped and counted."""
        self._write(data, [client for client in self._clients if client.name == source])

    def _write(self, data: bytes, clients: list[_Client]) -> None:
        taken = [client.write(data) for client in clients]
        self.traffic.sent += taken.count(True)
        self.traffic.dropped += taken.count(False) if taken else 1

    def close(self) -> None:
        """Stop listening and hang up on every client."""
        self._listener.close()
        for client in self._clients:
            client.close()
        self._clients.clear()

    def _drain(self) -> Datagrams:
        self._accept()
        chunks: list[Chunk] = []
        sources: list[SocketAddress] = []
        for client in list(self._clients):
            data = client.take(_SHARED_BYTES // len(self._clients))
            if data is None:
                self.traffic.turned_away += client.stuffed
                self._hang_up(client)
            elif data:
                chunks.append((data, time.monotonic_ns()))
                sources.append(client.name)
        return as_columns(chunks, sources)

    def _accept(self) -> None:
        for _ in range(CLIENTS_MAX):
            try:
                link, name = self._listener.accept()
            except OSError:  # nobody there, gone again, or closed
                return
            if len(self._clients) >= CLIENTS_MAX:
                idle = min(self._clients, key=lambda one: (one.name in self._trust, one.heard_s))
                self.traffic.turned_away += 1
                if idle.name in self._trust or time.monotonic() - idle.heard_s < IDLE_S:
                    link.close()
                    continue
                self._hang_up(idle)
            _tune(link)
            self._clients.append(_Client(link, name))

    def _hang_up(self, client: _Client) -> None:
        client.close()
        self._clients.remove(client)


def _tcp_socket(family: socket.AddressFamily) -> socket.socket:
    link = socket.socket(family, socket.SOCK_STREAM)
    _tune(link)
    return link


def _tune(link: socket.socket) -> None:
    """Never wait, never hold small frames back, and notice a peer that is gone."""
    link.setblocking(False)
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    link.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _DEAD_MS)
