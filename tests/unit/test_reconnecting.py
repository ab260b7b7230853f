"""How often an endpoint that lost its peer looks for it: less and less often, up to a bound; soon after a good time."""

import itertools
import socket

import pytest

from mavdiag.link.ports import open_endpoint
from mavdiag.link.ports.base import RETRY_MAX_S, RETRY_S
from mavdiag.link.ports.serial import Serial


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
