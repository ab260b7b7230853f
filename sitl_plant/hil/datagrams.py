"""One UDP port on which every datagram is answered to its own sender (edge)."""

import socket
from types import TracebackType
from typing import Self

from mavdiag.errors import UsageError
from mavdiag.link.ports import Kind, parse_address
from mavdiag.link.ports.base import SocketAddress, link_error

LONGEST = 2048


class Datagrams:
    """A bound port. Raises UsageError for another address than `udpin:HOST:PORT`, LinkError if it cannot be bound."""

    def __init__(self, address: str) -> None:
        parsed = parse_address(address)
        if parsed.kind is not Kind.UDP_IN:
            raise UsageError(f"{address}: the autopilot sends to a UDP port: write udpin:HOST:PORT")
        self._socket = socket.socket(socket.AF_INET6 if ":" in parsed.place else socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((parsed.place, parsed.number))
        except OSError as error:
            self._socket.close()
            raise link_error(address, error) from error
        self.address = f"{address.rpartition(':')[0]}:{self._socket.getsockname()[1]}"

    def receive(self, timeout_s: float) -> tuple[bytes, SocketAddress] | None:
        """The next datagram and its sender; None if none came in time. Raises LinkError if the port is gone."""
        try:
            self._socket.settimeout(timeout_s)
            data, peer = self._socket.recvfrom(LONGEST)
        except (TimeoutError, BlockingIOError, ConnectionError):  # nothing came, or an earlier answer found nobody
            return None
        except OSError as error:
            raise link_error(self.address, error) from error
        return data, peer

    def send(self, data: bytes, peer: SocketAddress) -> None:
        """Send now or never: an autopilot that gets no answer asks again."""
        try:
            self._socket.sendto(data, peer)
        except OSError:
            return

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._socket.close()
