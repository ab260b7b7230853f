"""What every endpoint promises, whatever it is made of: memory, UDP, TCP, and a serial device (a pseudo-terminal)."""

import os
import time
import tty
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
import pytest
from memory_port import memory_pair

from mavdiag.link.ports import Chunk, Endpoint, open_endpoint, wait

PATIENCE_S = 5.0
FRAME = bytes.fromhex("fd01000007010100000005abcd")  # a MAVLink 2 frame's outline: 1 byte of payload, 13 in all


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

    def _drain(self) -> list[Chunk]:
        try:
            return [(os.read(self._fileno, 65_536), 0)]
        except OSError:
            return []


@dataclass(frozen=True, slots=True)
class Link:
    near: Endpoint
    far: Endpoint


def open_link(kind: str, stack: ExitStack) -> Link:
    if kind == "memory":
        one, other = memory_pair(capacity=1000)
        return Link(stack.enter_context(one), stack.enter_context(other))
    if kind == "serial":
        master, slave = os.openpty()
        stack.callback(os.close, slave)
        distant = stack.enter_context(PtyMaster(master))
        device = stack.enter_context(open_endpoint(f"{os.ttyname(slave)},115200"))
        return Link(device, distant)
    listen, talk = kind.split("/")
    server = stack.enter_context(open_endpoint(f"{listen}:127.0.0.1:0"))
    client = stack.enter_context(open_endpoint(server.address.replace(listen, talk)))
    return Link(server, client)


def reversed_link(link: Link) -> Link:
    return Link(link.far, link.near)


@pytest.fixture(params=["memory", "udpin/udpout", "udpout/udpin", "tcpin/tcp", "tcp/tcpin", "serial"])
def link(request: pytest.FixtureRequest) -> Iterator[Link]:
    """A link whose two ends have heard each other; `near` is the end under test."""
    near = str(request.param).partition("/")[0]
    with ExitStack() as stack:
        link = open_link({"udpout": "udpin/udpout", "tcp": "tcpin/tcp"}.get(near, request.param), stack)
        first, second = (link.near, link.far)
        second.receive(0.0)
        first.receive(0.0)
        second.send(FRAME)
        assert collect(first, len(FRAME)) == FRAME
        first.send(FRAME)
        assert collect(second, len(FRAME)) == FRAME
        yield reversed_link(link) if near in ("udpout", "tcp") else link


def collect(endpoint: Endpoint, n_bytes: int) -> bytes:
    data = b""
    while len(data) < n_bytes:
        chunks = endpoint.receive(PATIENCE_S)
        assert chunks, f"only {len(data)} of {n_bytes} bytes arrived"
        data += b"".join(chunk for chunk, _ in chunks)
    return data


@pytest.mark.parametrize("seed", [1, 2])
def test_messages_arrive_whole_and_in_order_in_both_directions(link: Link, seed: int) -> None:
    rng = np.random.default_rng(seed)
    messages = [FRAME[:1] + bytes([n, *FRAME[2:10]]) + rng.bytes(n + 2) for n in rng.integers(0, 255, 12)]
    for sender, receiver in ((link.near, link.far), (link.far, link.near)):
        for message in messages:
            sender.send(message)
        assert collect(receiver, sum(map(len, messages))) == b"".join(messages)


def test_each_chunk_carries_the_host_clock(link: Link) -> None:
    stamps = [time.monotonic_ns()]
    for _ in range(3):
        link.far.send(FRAME)
        stamps += [host_ns for _, host_ns in link.near.receive(PATIENCE_S)]
    assert len(stamps) >= 4
    assert stamps == sorted(set(stamps))
    assert stamps[-1] <= time.monotonic_ns()


def test_what_was_sent_and_what_was_dropped_add_up_even_if_nobody_reads(link: Link) -> None:
    before = link.near.traffic
    for _ in range(30_000):
        link.near.send(FRAME * 20)
    after = link.near.traffic
    assert after.sent + after.dropped - before.sent - before.dropped == 30_000
    link.far.receive(PATIENCE_S)


def test_a_peer_that_is_gone_is_no_error(link: Link) -> None:
    link.far.close()
    for _ in range(5):
        link.near.receive(0.01)
        link.near.send(FRAME)
    assert link.near.traffic.sent + link.near.traffic.dropped == 6


def test_a_closed_endpoint_does_nothing_and_raises_nothing(link: Link) -> None:
    link.near.close()
    link.near.close()
    link.near.send(FRAME)
    assert link.near.receive(0.0) == []
    assert link.near.receive(0.01) == []
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
