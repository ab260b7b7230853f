"""Addresses: what is understood, one line for what is wrong, and how often a lost peer is looked for."""

import itertools
import socket

import pytest

from mavdiag.errors import LinkError, UsageError
from mavdiag.link.ports import open_endpoint
from mavdiag.link.ports.base import RETRY_MAX_S, RETRY_S
from mavdiag.link.ports.serial import Serial


@pytest.mark.parametrize(
    "text",
    [
        *("", "udpin", "udpin:", "udpin::14550", "udpin:127.0.0.1", "udpin:127.0.0.1:", "udp:127.0.0.1:14550"),
        *("udpin:127.0.0.1:65536", "udpin:127.0.0.1:-1", "udpin:::1:14550", "udpin:127.0.0.1:14550 ", "tcp:[::1:5760"),
        *("udpout:127.0.0.1:0", "tcp:127.0.0.1:0", "/dev/ttyUSB0", "/dev/ttyUSB0,", "/dev/ttyUSB0,0", "ttyUSB0,57600"),
    ],
)
def test_a_malformed_address_is_a_usage_error_of_one_line(text: str) -> None:
    with pytest.raises(UsageError, match="malformed address") as caught:
        open_endpoint(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_a_busy_port_says_so(kind: str) -> None:
    with (
        open_endpoint(f"{kind}:127.0.0.1:0") as holder,
        pytest.raises(LinkError, match="port is busy: stop the program"),
    ):
        open_endpoint(holder.address)


@pytest.mark.parametrize(
    ("address", "advice"),
    [
        ("udpin:192.0.2.1:0", "no such address: use 127.0.0.1"),  # TEST-NET-1 (RFC 5737) is nobody's address
        ("udpout:no-such-host.invalid:14550", "unknown host 'no-such-host.invalid'"),
        ("/dev/no-such-tty,57600", "no such device: plug it in"),
        ("/dev/null,57600", "/dev/null,57600: "),
    ],
)
def test_what_cannot_be_opened_is_a_link_error_of_one_line(address: str, advice: str) -> None:
    with pytest.raises(LinkError, match=advice) as caught:
        open_endpoint(address)
    assert "\n" not in str(caught.value)


class Clock:
    """Stands for the monotonic clock of the ports."""

    s = 1000.0

    def __call__(self) -> float:
        return self.s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    one = Clock()
    monkeypatch.setattr("mavdiag.link.ports.base.time.monotonic", one)
    return one


def test_a_device_that_is_absent_is_looked_for_ever_more_seldom(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = list[float]()

    def absent(port: Serial) -> None:
        opened.append(clock.s)
        raise FileNotFoundError(2, "No such file")

    monkeypatch.setattr(Serial, "_open", absent)
    with open_endpoint("/dev/absent,57600", absent_ok=True) as port:
        for _ in range(600):
            clock.s += 0.05
            port.receive(0.0)
    pauses = [after - before for before, after in itertools.pairwise(opened)]
    assert pauses[:4] == pytest.approx([RETRY_S, 2 * RETRY_S, 4 * RETRY_S, 8 * RETRY_S], abs=0.06)
    assert pauses[4:] == pytest.approx([RETRY_MAX_S] * len(pauses[4:]), abs=0.06)
    assert len(pauses) > 8


def test_a_server_that_comes_back_is_found_and_a_long_connection_counts_as_good(clock: Clock) -> None:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        with open_endpoint(f"tcp:127.0.0.1:{server.getsockname()[1]}") as client:
            for _ in range(200):  # refused, and waited for, up to the longest pause
                client.receive(0.0)
                clock.s += 0.1
            server.listen()
            clock.s += RETRY_MAX_S
            client.receive(0.0)
            peer, _ = server.accept()
            assert client.connected
            clock.s += 2 * RETRY_MAX_S
            peer.close()
            client.receive(0.0)
            assert not client.connected
            clock.s += RETRY_S
            client.receive(0.0)
            assert client.connected
        clock.s += 1000.0
        client.receive(0.0)
        assert not client.connected  # what was closed stays closed
