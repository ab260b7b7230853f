"""The run loop over in-memory links, as fast as it goes: what is said, answered and passed on."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from memory_port import MemoryEndpoint, memory_pair

from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.messages import MessageId, Severity
from sitl_plant.autopilot.dialect import DIALECTS
from sitl_plant.emulator import FlightReport, Link, fly
from sitl_plant.plant import Plant, PlantConfig, PlantSamples

DIALECT = DIALECTS["qdrone2"]


class Client:
    """The far end of one of the plant's links."""

    def __init__(self, endpoint: MemoryEndpoint, sysid: int, compid: int) -> None:
        self.endpoint = endpoint
        self.encoder = Encoder(sysid, compid)
        self.decoder = Decoder()
        self.frames: list[Frame] = []

    def say(self, *frame: bytes) -> None:
        for one in frame:
            self.endpoint.send(one)

    def heartbeat(self) -> None:
        self.say(self.encoder.encode(MessageId.HEARTBEAT, 6, 8, 0, 0, 4, 3))

    def hear(self) -> list[Frame]:
        for data, host_ns in self.endpoint.receive(0.0):
            self.frames += self.decoder.feed(data, host_ns)
        return self.frames


@pytest.fixture
def table() -> Iterator[tuple[list[Link], list[Client]]]:
    """Two links with a client at the far end of each: a ground station and a companion computer."""
    with ExitStack() as stack:
        pairs = [memory_pair() for _ in range(2)]
        for near, far in pairs:
            stack.enter_context(near)
            stack.enter_context(far)
        links = [Link(near, DIALECT, 200.0) for near, _ in pairs]
        yield links, [Client(pairs[0][1], 255, 190), Client(pairs[1][1], 1, 191)]


def flown(
    links: list[Link],
    duration_s: float | None,
    watch: Callable[[PlantSamples], None] = lambda samples: None,
    stop: Callable[[], bool] = lambda: False,
) -> FlightReport:
    plant = Plant(PlantConfig(seed=11))
    return fly(plant, DIALECT, links, duration_s=duration_s, speed=None, stop=stop, watch=watch)


def test_both_links_hear_the_whole_flight_without_a_gap(table: tuple[list[Link], list[Client]]) -> None:
    links, clients = table
    report = flown(links, 2.0)
    for client in clients:
        counts = Counter(frame.msgid for frame in client.hear())
        assert counts[MessageId.RAW_IMU] == counts[MessageId.ATTITUDE_TARGET] == 400
        assert counts[MessageId.HEARTBEAT] == 2
        assert client.decoder.senders[1, 1].lost == 0
    assert report.messages == sum(len(client.frames) for client in clients)
    assert (report.flown_s, report.dropped, report.received) == (2.0, 0, 0)


def test_an_alert_is_passed_on_in_its_senders_name(table: tuple[list[Link], list[Client]]) -> None:
    links, (station, companion) = table
    station.heartbeat()
    companion.say(*(companion.encoder.statustext(Severity.CRITICAL, f"PROP FAULT r{rotor}") for rotor in (1, 2)))
    flown(links, 0.5)
    passed = [frame for frame in station.hear() if frame.compid == 191]
    assert [frame.text("text") for frame in passed] == ["PROP FAULT r1", "PROP FAULT r2"]
    assert station.decoder.senders[1, 191].lost == 0
    assert not [frame for frame in companion.hear() if frame.compid == 191]
    assert [frame.sysid for frame in companion.frames if frame.sysid == 255] == []  # heard before the companion was


def test_b28_a_cut_off_datagram_of_one_peer_does_not_spoil_the_next_ones() -> None:
    with ExitStack() as stack:
        near, far = (stack.enter_context(end) for end in memory_pair())
        near.datagrams = True  # as a udpin endpoint has several peers
        link, encoder = Link(near, DIALECT, None), Encoder(255, 190)
        whole = encoder.encode(MessageId.HEARTBEAT, 6, 8, 0, 0, 4, 3)
        far.send(whole[:-5])
        far.send(encoder.encode(MessageId.HEARTBEAT, 6, 8, 0, 0, 4, 3))
        assert [frame.seq for frame in link.receive()] == [1]
