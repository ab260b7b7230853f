"""Byte-stream endpoints: a TCP client or a serial device that reconnects, and a TCP server for several clients."""

import os
import socket
import time
from abc import ABC, abstractmethod

import serial

from mavdiag.link.codec import Decoder, next_marker
from mavdiag.link.ports.base import RETRY_MAX_S, RETRY_S, Chunk, Clock, Endpoint, SocketAddress, link_error

CLIENTS_MAX = 16  # of a TCP server: for a further one an idle one makes room, else that one is turned away
IDLE_S = 5.0  # without a frame, before a client may have to make room (our choice)
GARBAGE_BYTES = 16_384  # of a client in a row, without a frame, before it is hung up on (our choice)

_READ_BYTES = 65_536
_DRAIN_READS = 16  # reads per call, so that a flood cannot hold the caller
_SHARED_BYTES = 131_072  # that a server reads per call, the same share of each client, for the same reason
_DEAD_MS = 10_000  # a TCP peer that acknowledges nothing for so long is gone


class _Stream:
    """One connected, non-blocking byte stream over a descriptor. Messages go out whole or not at all."""

    def __init__(self, handle: socket.socket | serial.Serial) -> None:
        self._handle = handle  # kept: closing it closes the descriptor
        self.fileno = handle.fileno()
        self._tail = b""  # the rest of a message that the system took only in part

    @property
    def established(self) -> bool:
        """Whether the other side is there; a serial line cannot know."""
        try:
            return isinstance(self._handle, serial.Serial) or bool(self._handle.getpeername())
        except OSError:
            return False

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

    def close(self) -> None:
        self._handle.close()


class _Reconnecting(Endpoint, ABC):
    """One stream that is opened again, while it is polled, after it has ended: see `RETRY_S`."""

    def __init__(self, address: str, clock: Clock) -> None:
        super().__init__(address, clock)
        self._stream: _Stream | None = None
        self._retry_at = 0.0  # monotonic clock [s]; infinite once closed
        self._opened_at, self._pause_s = 0.0, RETRY_S

    @abstractmethod
    def _open(self) -> _Stream:
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
                self._stream, self._opened_at = self._open(), time.monotonic()
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


class TcpClient(_Reconnecting):
    """Connects to one server, and again whenever the connection ends. An absent server is no error."""

    def __init__(self, address: str, family: socket.AddressFamily, remote: SocketAddress, clock: Clock) -> None:
        super().__init__(address, clock)
        self._family, self._remote = family, remote
        self._drain()

    @property
    def connected(self) -> bool:
        """Whether the server has accepted."""
        return self._stream is not None and self._stream.established

    def _open(self) -> _Stream:
        # A pending connection reads and writes as "nothing yet", and ends like an open one if it is refused.
        link = _tcp_socket(self._family)
        link.connect_ex(self._remote)
        return _Stream(link)


class Serial(_Reconnecting):
    """A serial device, 8N1, held exclusively; opened again when it comes back after having gone.

    absent_ok: whether it may come later. Raises LinkError if it cannot be opened at first and may not.
    """

    def __init__(self, address: str, device: str, baud: int, clock: Clock, *, absent_ok: bool = False) -> None:
        super().__init__(address, clock)
        self._device, self._baud = device, baud
        try:
            self._stream, self._opened_at = self._open(), time.monotonic()
        except OSError as error:
            if not absent_ok or not error.errno:
                raise link_error(address, error) from error
            self._wait()

    def _open(self) -> _Stream:
        # inter_byte_timeout=0 sets VMIN=1, VTIME=0 (termios): "nothing yet" then differs from "hung up".
        try:
            return _Stream(serial.Serial(self._device, self._baud, inter_byte_timeout=0, exclusive=True))
        except ValueError as error:
            raise OSError(0, f"{self._baud} baud is not a speed of this device: try 57600, 115200 or 921600") from error


class _Client(_Stream):
    """One client of a server. name: its address; heard_s: when its last frame came, or it did (monotonic clock)."""

    def __init__(self, link: socket.socket, name: SocketAddress) -> None:
        super().__init__(link)
        self.name, self.heard_s = name, time.monotonic()
        self._begun = b""  # of a frame that is not yet complete
        self._sound: list[tuple[bytes, int]] = []
        self._decoder = Decoder((), passed=self._sound)
        self._garbage = 0  # bytes since the last sound frame

    def take(self, most_bytes: int) -> bytes | None:
        """What has come, cut between frames; None if the stream has ended, or brings nothing but garbage."""
        read = self.read(most_bytes)
        if not read:
            return read
        self._decoder.feed(read, 0)
        if self._sound:
            self._garbage, self.heard_s = 0, time.monotonic()
            self._sound.clear()
        else:
            self._garbage += len(read)
        data = self._begun + read
        cut = whole_frames(data)
        self._begun = data[cut:]
        return None if self.stuffed else data[:cut]

    @property
    def stuffed(self) -> bool:
        """Whether it brings nothing but garbage."""
        return self._garbage >= GARBAGE_BYTES


class TcpServer(Endpoint):
    """Accepts up to `CLIENTS_MAX` clients; sends to all, and receives of all, cut between their frames.

    Raises LinkError if the port cannot be bound.
    """

    def __init__(self, address: str, family: socket.AddressFamily, local: SocketAddress, clock: Clock) -> None:
        super().__init__(address, clock)
        self._listener = _tcp_socket(family)
        self._clients: list[_Client] = []
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind(local)
            self._listener.listen(CLIENTS_MAX)
        except OSError as error:
            self._listener.close()
            raise link_error(address, error) from error
        self._address = f"{address.rpartition(':')[0]}:{self._listener.getsockname()[1]}"

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
        self._count.sent += taken.count(True)
        self._count.dropped += taken.count(False) if taken else 1

    def close(self) -> None:
        """Stop listening and hang up on every client."""
        self._listener.close()
        for client in self._clients:
            client.close()
        self._clients.clear()

    def _drain(self) -> list[Chunk]:
        self._accept()
        chunks: list[Chunk] = []
        sources: list[SocketAddress] = []
        for client in list(self._clients):
            data = client.take(_SHARED_BYTES // len(self._clients))
            if data is None:
                self._count.turned_away += client.stuffed
                self._hang_up(client)
            elif data:
                chunks.append((data, self._clock()))
                sources.append(client.name)
        self.sources = sources
        return chunks

    def _accept(self) -> None:
        for _ in range(CLIENTS_MAX):
            try:
                link, name = self._listener.accept()
            except OSError:  # nobody there, gone again, or closed
                return
            if len(self._clients) >= CLIENTS_MAX:
                idle = min(self._clients, key=lambda one: (one.name in self._trust, one.heard_s))
                self._count.turned_away += 1
                if idle.name in self._trust or time.monotonic() - idle.heard_s < IDLE_S:
                    link.close()
                    continue
                self._hang_up(idle)
            _tune(link)
            self._clients.append(_Client(link, name))

    def _hang_up(self, client: _Client) -> None:
        client.close()
        self._clients.remove(client)


def whole_frames(data: bytes) -> int:
    """How many leading bytes of one client's stream end between MAVLink frames, so that another's may follow.

    Only an incomplete last frame (at most 280 bytes) is left; bytes that belong to no frame count as whole.

    >>> v1 = bytes.fromhex("fe00000101000000")
    >>> whole_frames(v1 + v1[:5])
    8
    """
    start = next_marker(data, 0)
    while start < len(data):
        length = frame_length(data, start)
        if length is None or start + length > len(data):
            break
        start = next_marker(data, start + length)
    return start


def frame_length(data: bytes, start: int) -> int | None:
    """Bytes of the frame that starts here (1 for a byte that starts none), None if too few are there to say.

    MAVLink serialization: v1 is 0xFE with 8 bytes around the payload, v2 is 0xFD with 12, and 13 more if signed.
    """
    magic = data[start]
    if magic not in (0xFE, 0xFD):
        return 1
    if len(data) < start + 3:
        return None
    if magic == 0xFE:
        return data[start + 1] + 8
    return data[start + 1] + (25 if data[start + 2] & 1 else 12)


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
