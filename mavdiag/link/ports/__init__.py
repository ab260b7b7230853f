"""Open one end of a link by its address: UDP, TCP or serial.

    udpin:HOST:PORT         listen; answer the peers that sent in the last 10 s (at most 32)
    udpout:HOST:PORT        talk to one peer
    tcp:HOST:PORT           connect to a server, and again when the connection ends
    tcpin:HOST:PORT         serve up to 16 clients
    /dev/ttyUSB0,921600     a serial device and its baud

HOST is always written: 127.0.0.1 is this machine only, 0.0.0.0 every network it is on. An IPv6 host stands in brackets.
Port 0 asks for a free port; `Endpoint.address` has it. A host name is looked up once, when the endpoint is opened.
"""

import errno
import os
import re
import socket
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import NamedTuple, TypeAlias

from mavdiag.errors import LinkError, UsageError
from mavdiag.link.ports.base import Endpoint, SocketAddress, Traffic, link_error, wait
from mavdiag.link.ports.serial import Serial
from mavdiag.link.ports.tcp import TcpClient, TcpServer
from mavdiag.link.ports.udp import PEER_FRESH_S, UdpIn, UdpOut

__all__ = ["PEER_FRESH_S", "Endpoint", "SocketAddress", "Traffic", "wait"]

_NetworkPort: TypeAlias = Callable[[str, socket.AddressFamily, SocketAddress], Endpoint]
_NETWORK = re.compile(r"(?P<kind>udpin|udpout|tcp|tcpin):(?P<host>\[[0-9A-Fa-f:.%\w]+\]|[^:\[\]\s]+):(?P<port>\d{1,5})")
_SERIAL = re.compile(r"(?P<device>/[^,\s]+),(?P<baud>[1-9]\d{0,7})")


class Kind(StrEnum):
    """What an address is of."""

    UDP_IN = "udpin"
    UDP_OUT = "udpout"
    TCP_CLIENT = "tcp"
    TCP_SERVER = "tcpin"
    SERIAL = "serial"


class Address(NamedTuple):
    """An address taken apart."""

    kind: Kind
    place: str  # host or device
    number: int  # port or baud


def parse_address(text: str) -> Address:
    """Take an address apart. Raises UsageError, showing the notation, if it is malformed.

    >>> parse_address("udpin:127.0.0.1:14550")
    Address(kind=<Kind.UDP_IN: 'udpin'>, place='127.0.0.1', number=14550)
    """
    if match := _SERIAL.fullmatch(text):
        return Address(Kind.SERIAL, match["device"], int(match["baud"]))
    match = _NETWORK.fullmatch(text)
    if match is None:
        raise UsageError(
            f"malformed address {text!r}: write udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT"
            " or /dev/ttyUSB0,921600"
        )
    kind, port = Kind(match["kind"]), int(match["port"])
    if port > 65_535:
        raise UsageError(f"malformed address {text!r}: a port is at most 65535")
    if port == 0 and kind in (Kind.UDP_OUT, Kind.TCP_CLIENT):
        raise UsageError(f"malformed address {text!r}: name the peer's port; only a port to listen on may be 0")
    return Address(kind, match["host"].strip("[]"), port)


def check_address(address: str) -> None:
    """Raise what `open_endpoint` would, as far as that shows without opening anything: host names and devices."""
    parsed = parse_address(address)
    if parsed.kind is not Kind.SERIAL:
        _resolve(address, parsed, socket.SOCK_STREAM)
    elif not os.access(parsed.place, os.R_OK | os.W_OK):
        there = os.path.lexists(parsed.place)
        raise link_error(address, OSError(errno.EACCES if there else errno.ENOENT, ""))


def open_endpoint(address: str, *, absent_ok: bool = False) -> Endpoint:
    """Open one end of a link.

    absent_ok: whether a serial device may come later.
    Raises UsageError for a malformed address; LinkError for a busy port, an unknown host, a missing device or a missing
    right. An absent peer is no error.
    """
    parsed = parse_address(address)
    if parsed.kind is Kind.SERIAL:
        return Serial(address, parsed.place, parsed.number, absent_ok=absent_ok)
    port, kind = _PORTS[parsed.kind]
    return port(address, *_resolve(address, parsed, kind))


_PORTS: Mapping[Kind, tuple[_NetworkPort, socket.SocketKind]] = {
    Kind.UDP_IN: (UdpIn, socket.SOCK_DGRAM),
    Kind.UDP_OUT: (UdpOut, socket.SOCK_DGRAM),
    Kind.TCP_CLIENT: (TcpClient, socket.SOCK_STREAM),
    Kind.TCP_SERVER: (TcpServer, socket.SOCK_STREAM),
}


def _resolve(address: str, parsed: Address, kind: socket.SocketKind) -> tuple[socket.AddressFamily, SocketAddress]:
    try:
        found = socket.getaddrinfo(parsed.place, parsed.number, type=kind)
    except (socket.gaierror, UnicodeError) as error:
        raise LinkError(f"{address}: unknown host {parsed.place!r}: check its name or write its IP address") from error
    family, _, _, _, place = min(found, key=lambda entry: entry[0] != socket.AF_INET)  # IPv4 first, as MAVLink tools do
    return family, place
