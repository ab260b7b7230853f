"""Endpoints: what each promises, addresses, peers that come and go, garbage, and what is never torn."""

import errno
import itertools
import os
import socket
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from memory_port import memory_pair

from mavdiag.errors import LinkError, UsageError
from mavdiag.link.codec import Encoder
from mavdiag.link.datagrams import Datagrams, as_columns
from mavdiag.link.messages import MessageId
from mavdiag.link.ports import Endpoint, SocketAddress, open_endpoint, wait
from mavdiag.link.ports.base import RETRY_MAX_S, RETRY_S, Stream
from mavdiag.link.ports.serial import Serial
from mavdiag.link.ports.tcp import CLIENTS_MAX
from mavdiag.link.ports.udp import PEERS_MAX

PATIENCE_S = 5.0
V1 = bytes.fromhex("fe09000101000000000002035104037ddd")
V2 = Encoder(1, 1).encode(MessageId.HEARTBEAT, 2, 3, 81, 0, 4, 3)
GARBAGE = {
    "random": np.random.default_rng(3).bytes(200_000),
    "markers": b"\xfd" * 200_000,
    "short markers": b"\xfe\x00" * 100_000,
    "no marker": b"GET / HTTP/1.1\r\n\r\n" * 10_000,
}
MALFORMED = (
    *("", "udpin", "udpin:", "udpin::14550", "udpin:127.0.0.1", "udpin:127.0.0.1:", "udp:127.0.0.1:14550"),
    *("udpin:127.0.0.1:65536", "udpin:127.0.0.1:-1", "udpin:::1:14550", "udpin:127.0.0.1:14550 ", "tcp:[::1:5760"),
    *("udpout:127.0.0.1:0", "tcp:127.0.0.1:0", "/dev/ttyUSB0", "/dev/ttyUSB0,", "/dev/ttyUSB0,0", "ttyUSB0,57600"),
)
FRAME = bytes.fromhex("fd01000007010100000005abcd")  # a MAVLink 2 frame's outline: 1 byte of payload, 13 in all


def receive_all(endpoint: Endpoint, n_bytes: int) -> bytes:
    return receive_from(endpoint, n_bytes)[0]


def receive_from(endpoint: Endpoint, n_bytes: int, patience_s: float = PATIENCE_S) -> tuple[bytes, SocketAddress]:
    """The bytes, and who sent the first of the latest chunks, where that is told."""
    until, data, sources = time.monotonic() + patience_s, b"", list[SocketAddress]()
    while len(data) < n_bytes and time.monotonic() < until:
        received = endpoint.receive(0.1)
        data += b"".join(chunk for chunk, _ in received)
        sources = received.sources or sources
    return data, next(iter(sources), ("", 0))


@pytest.mark.parametrize(("kind", "host"), [("udpin", "127.0.0.1"), ("udpin", "[::1]"), ("tcpin", "127.0.0.1")])
def test_an_answer_goes_to_the_one_that_asked(kind: str, host: str) -> None:
    if host == "[::1]" and not Path("/proc/net/if_inet6").exists():
        pytest.skip("no IPv6 here")
    with open_endpoint(f"{kind}:{host}:0") as server, ExitStack() as stack:
        far = server.address.replace(kind, {"udpin": "udpout", "tcpin": "tcp"}[kind])
        clients = [stack.enter_context(open_endpoint(far)) for _ in range(3)]
        for client in clients:
            while not client.connected:
                client.receive(0.001)
            client.send(V2)
            received, source = receive_from(server, len(V2))
            assert received == V2
        server.answer(V1, source)
        assert receive_all(clients[2], len(V1)) == V1
        assert [len(client.receive(0.02)) for client in clients[:2]] == [0, 0]
        server.answer(V1, ("127.0.0.1", 1))
        assert server.traffic.sent == server.traffic.dropped == 1


def test_udpin_answers_those_that_it_heard_and_strangers_that_flood_take_no_ones_place() -> None:
    with open_endpoint("udpin:127.0.0.1:0") as server, ExitStack() as stack:
        far = server.address.replace("udpin", "udpout")
        clients = [stack.enter_context(open_endpoint(far)) for _ in range(PEERS_MAX + 5)]
        server.send(V2)
        assert (server.traffic.sent, server.traffic.dropped) == (0, 1)
        for client in clients:
            client.send(V1)
        assert len(receive_all(server, len(clients) * len(V1))) == len(clients) * len(V1)
        server.send(V2)
        assert (server.traffic.sent, receive_all(clients[0], len(V2))) == (PEERS_MAX, V2)
        assert not len(clients[-1].receive(0.01))


def test_a_peer_that_gets_a_socket_of_its_own_is_received_in_order() -> None:
    sent = [number.to_bytes(4, "big") for number in range(6000)]
    with open_endpoint("udpin:127.0.0.1:0") as server, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.connect(("127.0.0.1", int(server.address.rpartition(":")[2])))
        for data in sent[:5000]:  # more wait than one call takes
            peer.send(data)
        server.trust([peer.getsockname()], alone=False)
        for data in sent[5000:]:
            peer.send(data)
        received = receive_all(server, 4 * len(sent))
        assert [received[at : at + 4] for at in range(0, len(received), 4)] == sent


@pytest.mark.parametrize("kind", ["udpin", "udpout"])
def test_a_reader_that_was_held_up_knows_when_a_datagram_arrived(kind: str) -> None:
    with open_endpoint("udpin:127.0.0.1:0") as server, open_endpoint(f"udpout{server.address[5:]}") as client:
        client.send(V1)
        assert receive_all(server, len(V1)) == V1
        here, there = (server, client) if kind == "udpin" else (client, server)
        for _ in range(20):  # the kernel may not stamp the first ones
            before_ns = time.monotonic_ns()
            there.send(V2)
            latest_ns = time.monotonic_ns() + 100_000_000
            time.sleep(0.2)
            [(data, host_ns)] = here.receive(1.0)
            assert data == V2
            if host_ns <= latest_ns:
                break
        assert before_ns - 1_000_000 <= host_ns <= latest_ns


def test_every_datagram_is_received_or_counted_as_overflowed() -> None:
    n_sent = 40_000
    with open_endpoint("udpin:127.0.0.1:0") as server, open_endpoint(f"udpout{server.address[5:]}") as client:
        for _ in range(n_sent):
            client.send(V2)
        while server.receive(0.05):
            pass
        client.send(V2)  # the count is told with the next datagram
        assert server.receive(5.0)
        assert client.traffic.sent == n_sent + 1
        assert server.traffic.received + server.traffic.overflowed == n_sent + 1
        assert server.traffic.overflowed > 0


def test_a_tcp_server_cuts_its_clients_between_frames() -> None:
    with open_endpoint("tcpin:127.0.0.1:0") as server:
        far = server.address.replace("tcpin", "tcp")
        with open_endpoint(far) as one, open_endpoint(far) as other:
            while not (one.connected and other.connected):
                time.sleep(0.001)
            one.send(V1 + V2[:5])
            assert receive_all(server, len(V1)) == V1
            other.send(V1)
            assert receive_all(server, len(V1)) == V1
            one.send(V2[5:] + V1[:1])
            assert receive_all(server, len(V2)) == V2


@pytest.mark.parametrize("name", GARBAGE)
def test_a_client_that_sends_only_garbage_is_hung_up_on_and_hides_nobody(name: str) -> None:
    with open_endpoint("tcpin:127.0.0.1:0") as server, ExitStack() as stack:
        far = server.address.replace("tcpin", "tcp")
        vehicle = stack.enter_context(open_endpoint(far))
        vehicle.send(V2)
        received, vehicle_name = receive_from(server, len(V2))
        assert received == V2
        place = ("127.0.0.1", int(far.rpartition(":")[2]))
        strangers = [stack.enter_context(socket.create_connection(place)) for _ in range(CLIENTS_MAX - 1)]
        for stranger in strangers:
            stranger.setblocking(False)
            stranger.send(GARBAGE[name])
        found, calls = b"", 0
        for _ in range(100):
            vehicle.send(V2)
        while len(found) < 100 * len(V2) and calls < 200:
            received_now = server.receive(0.01)
            chunks = zip(received_now, received_now.sources, strict=True)
            found += b"".join(data for (data, _), source in chunks if source == vehicle_name)
            calls += 1
        assert found == 100 * V2
        until = time.monotonic() + 5.0
        while server.traffic.turned_away < len(strangers) and time.monotonic() < until:
            server.receive(0.01)
        assert server.traffic.turned_away == len(strangers)
        assert vehicle.connected


def test_a_serial_device_that_is_unplugged_is_found_again(tmp_path: Path) -> None:
    plug = tmp_path / "tty"
    master, slave = os.openpty()
    plug.symlink_to(os.ttyname(slave))
    with open_endpoint(f"{plug},115200") as endpoint:
        os.write(master, V2)
        assert receive_all(endpoint, len(V2)) == V2
        os.close(slave)
        os.close(master)
        assert not len(endpoint.receive(0.01))
        assert not endpoint.connected
        endpoint.send(V2)
        assert endpoint.traffic.dropped == 1
        plug.unlink()
        assert not len(endpoint.receive(0.3))
        master, slave = os.openpty()
        plug.symlink_to(os.ttyname(slave))
        with patch("termios.tcflush", side_effect=termios.error(errno.EIO, "it went again")) as tcflush:
            endpoint.receive(2 * RETRY_S)
        assert tcflush.called
        assert not endpoint.connected
        try:
            until = time.monotonic() + 5.0
            while not endpoint.connected and time.monotonic() < until:
                endpoint.receive(0.05)
            os.write(master, V1)
            assert receive_all(endpoint, len(V1)) == V1
        finally:
            os.close(master)
            os.close(slave)


def test_a_serial_device_is_held_alone() -> None:
    master, slave = os.openpty()
    address = f"{os.ttyname(slave)},57600"
    try:
        with open_endpoint(address), pytest.raises(LinkError, match="device is busy"):
            open_endpoint(address)
    finally:
        os.close(master)
        os.close(slave)


def test_a_message_that_fits_only_in_part_is_never_torn() -> None:
    frame = Encoder(1, 1).encode(110, 0, 1, 1, list(range(1, 252)))
    with open_endpoint("tcpin:127.0.0.1:0") as server, open_endpoint(server.address.replace("tcpin", "tcp")) as client:
        while not client.connected:
            time.sleep(0.001)
        while client.traffic.dropped < 100:
            client.send(frame)
        arrived = b""
        for _ in range(3):
            while chunks := server.receive(0.05):
                arrived += b"".join(data for data, _ in chunks)
            client.send(frame)
        arrived += receive_all(server, len(frame) * client.traffic.sent - len(arrived))
        assert arrived == frame * client.traffic.sent


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_a_busy_port_says_so(kind: str) -> None:
    with open_endpoint(f"{kind}:127.0.0.1:0") as one, pytest.raises(LinkError, match="port is busy: stop the program"):
        open_endpoint(one.address)


@pytest.mark.parametrize(
    ("address", "kind", "advice"),
    [
        *((text, UsageError, "malformed address") for text in MALFORMED),
        ("udpin:192.0.2.1:0", LinkError, "no such address: use 127.0.0.1"),  # TEST-NET-1 (RFC 5737) is nobody's
        ("udpout:no-such-host.invalid:14550", LinkError, "unknown host 'no-such-host.invalid'"),
        ("/dev/no-such-tty,57600", LinkError, "no such device: plug it in"),
        ("/dev/null,57600", LinkError, "/dev/null,57600: "),
    ],
)
def test_what_cannot_be_opened_is_an_error_of_one_line(address: str, kind: type[Exception], advice: str) -> None:
    with pytest.raises(kind, match=advice) as caught:
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
            assert client.absent.startswith(f"{client.address}: the connection is refused: nobody listens there")
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


class PtyMaster(Endpoint):
    """The far side of a serial line: the controlling end of a pseudo-terminal."""

    def __init__(self, fileno: int) -> None:
        super().__init__("pty")
        tty.setraw(fileno)
        os.set_blocking(fileno, False)
        self._fileno = fileno

    @property
    def connected(self) -> bool:
        return self._fileno >= 0

    def filenos(self) -> tuple[int, ...]:
        return (self._fileno,) if self._fileno >= 0 else ()

    def send(self, data: bytes) -> None:
        os.write(self._fileno, data)

    def close(self) -> None:
        if self._fileno >= 0:
            os.close(self._fileno)
        self._fileno = -1

    def _drain(self) -> Datagrams:
        try:
            return as_columns([(os.read(self._fileno, 65_536), 0)])
        except OSError:
            return as_columns(())


@dataclass(frozen=True, slots=True)
class Link:
    near: Endpoint
    far: Endpoint


@pytest.fixture(params=["memory", "udpin/udpout", "udpout/udpin", "tcpin/tcp", "tcp/tcpin", "serial"])
def link(request: pytest.FixtureRequest) -> Iterator[Link]:
    """A link whose two ends have heard each other; `near` is the end under test."""
    near, _, far = str(request.param).partition("/")
    with ExitStack() as stack:
        if near == "memory":
            ends: list[Endpoint] = [stack.enter_context(end) for end in memory_pair(capacity=1000)]
        elif near == "serial":
            master, slave = os.openpty()
            stack.callback(os.close, slave)
            ends = [stack.enter_context(open_endpoint(f"{os.ttyname(slave)},115200"))]
            ends.append(stack.enter_context(PtyMaster(master)))
        else:
            listen, talk = sorted((near, far), key=lambda kind: not kind.endswith("in"))
            ends = [stack.enter_context(open_endpoint(f"{listen}:127.0.0.1:0"))]
            ends.append(stack.enter_context(open_endpoint(ends[0].address.replace(listen, talk))))
        first, second = ends
        second.receive(0.0)
        first.receive(0.0)
        for sender, receiver in ((second, first), (first, second)):
            sender.send(FRAME)
            assert receive_all(receiver, len(FRAME)) == FRAME
        yield Link(*ends[:: -1 if near in ("udpout", "tcp") else 1])


@pytest.mark.parametrize("seed", [1, 2])
def test_messages_arrive_whole_and_in_order_in_both_directions(link: Link, seed: int) -> None:
    rng = np.random.default_rng(seed)
    messages = [FRAME[:1] + bytes([n, *FRAME[2:10]]) + rng.bytes(n + 2) for n in rng.integers(0, 255, 12)]
    for sender, receiver in ((link.near, link.far), (link.far, link.near)):
        for message in messages:
            sender.send(message)
        assert receive_all(receiver, sum(map(len, messages))) == b"".join(messages)


def test_each_chunk_carries_the_host_clock(link: Link) -> None:
    stamps = [time.monotonic_ns()]
    for _ in range(3):
        link.far.send(FRAME)
        stamps += [host_ns for _, host_ns in link.near.receive(PATIENCE_S)]
    assert len(stamps) >= 4
    assert stamps == sorted(set(stamps))
    assert stamps[-1] <= time.monotonic_ns()


def test_what_was_sent_and_what_was_dropped_add_up_even_if_nobody_reads(link: Link) -> None:
    before = replace(link.near.traffic)
    for _ in range(30_000):
        link.near.send(FRAME * 20)
    after = link.near.traffic
    assert after.sent + after.dropped - before.sent - before.dropped == 30_000
    link.far.receive(0.1)


def test_a_peer_that_is_gone_is_no_error(link: Link) -> None:
    link.far.close()
    for _ in range(5):
        link.near.receive(0.01)
        link.near.send(FRAME)
    assert link.near.traffic.sent + link.near.traffic.dropped == 6


def test_why_a_stream_ended_is_known_though_a_message_was_sent_first() -> None:
    """Nobody was told that a link behind was refused, where the machine had much to do."""
    with socket.socket() as closed, socket.socket() as link:
        closed.bind(("127.0.0.1", 0))
        link.setblocking(False)
        link.connect_ex(closed.getsockname())
        stream = Stream(link.fileno(), link.close)
        assert (stream.write(FRAME), stream.read()) == (False, None)
        assert isinstance(stream.error, ConnectionRefusedError)


def test_a_closed_endpoint_does_nothing_and_raises_nothing(link: Link) -> None:
    link.near.close()
    link.near.close()
    link.near.send(FRAME)
    assert not len(link.near.receive(0.0))
    assert not len(link.near.receive(0.01))
    assert link.near.filenos() == ()
    assert link.near.traffic.dropped == 1
    assert not link.near.connected


def test_waiting_tells_which_of_several_can_be_read(link: Link) -> None:
    quiet, other = memory_pair()
    with quiet, other:
        assert wait([quiet, link.near], 0.01) == []
        link.far.send(FRAME)
        assert wait([quiet, link.near], PATIENCE_S) == [link.near]
        other.send(b"now")
        assert set(wait([quiet, link.near], PATIENCE_S)) == {quiet, link.near}
