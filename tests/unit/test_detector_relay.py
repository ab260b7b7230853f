"""What passes between the vehicle's link and those behind it, and what is kept back."""

from types import SimpleNamespace
from typing import Any

import pytest
from memory_port import memory_pair

from detector.component import Sender
from detector.relay import DATAGRAM_BYTES, Relay
from detector.requests import Handled, Requests
from mavdiag.link.codec import Decoder, Encoder, Frame, field_index
from mavdiag.link.datagrams import as_columns
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId
from mavdiag.link.profiles import PROFILES
from mavdiag.link.vehicles import LinkDecoder
from mavdiag.telemetry import Instant


def frames(count: int, sysid: int = 1) -> list[bytes]:
    encoder = Encoder(sysid, 1)
    return [encoder.encode(MessageId.RAW_IMU, 1000 * k, 1, 2, -1000, 3, 4, 5) for k in range(count)]


def decoded(messages: list[bytes]) -> int:
    decoder = Decoder()
    return sum(len(decoder.feed_datagram(message, 0)) for message in messages)


def relayed(chunks: list[bytes], datagrams: bool) -> list[bytes]:
    """What a link behind gets of what the vehicle's link brought."""
    near, _ = memory_pair(clock=lambda: 0)
    behind, far = memory_pair(clock=lambda: 0)
    passed: list[tuple[bytes, int]] = []
    link = LinkDecoder(datagrams=datagrams, passed=passed)
    link.feed(as_columns([(chunk, 0) for chunk in chunks]), 0)
    Relay(near, [behind]).pass_on(passed)
    return [data for data, _ in far.receive(0.0)]


def test_l7_what_a_byte_stream_brought_at_once_goes_on_in_packets_of_whole_frames() -> None:
    """Datagrams of up to 4.4 kB went out: a client lost 46 % of the messages behind them."""
    stream = b"".join(frames(200))
    messages = relayed([stream[:4401], stream[4401:]], datagrams=False)
    assert max(map(len, messages)) <= DATAGRAM_BYTES
    assert decoded(messages) == 200


def test_a_byte_stream_is_put_together_wherever_it_was_cut() -> None:
    near, vehicle = memory_pair(clock=lambda: 0)
    behind, far = memory_pair(clock=lambda: 0)
    behind.datagrams = False
    stream, relay = b"".join(frames(20)), Relay(near, [behind])
    for k in range(0, len(stream), 7):
        far.send(stream[k : k + 7])
        relay.pass_on([])
    assert [data for data, _ in vehicle.receive(0.0)] == frames(20)


STATION = Encoder(255, Component.MISSIONPLANNER)


def handled(message: bytes, *vehicles: int) -> Handled:
    streams = {sysid: SimpleNamespace(profile=PROFILES["ardupilot"]) for sysid in vehicles}
    fleet: Any = SimpleNamespace(vehicles=dict.fromkeys(vehicles), link=SimpleNamespace(vehicles=streams))
    requests = Requests(fleet, True, Sender)
    return requests.from_behind([message], Instant(0))


def framed(data: bytes) -> Frame:
    [frame] = Decoder().feed_datagram(data, 0)
    return frame


def interval(target: tuple[int, int], msgid: int, command: int = MavCmd.SET_MESSAGE_INTERVAL) -> bytes:
    return STATION.encode(MessageId.COMMAND_LONG, *target, command, 0, msgid, 250_000)


def group(number: int, target: tuple[int, int] = (1, 1)) -> bytes:
    return STATION.encode(MessageId.REQUEST_DATA_STREAM, *target, number, 4, 1)


BY_INT = STATION.encode(MessageId.COMMAND_INT, 1, 1, 0, MavCmd.SET_MESSAGE_INTERVAL, 0, 0, MessageId.RAW_IMU, 250_000)


@pytest.mark.parametrize("message", [interval((1, 1), MessageId.RAW_IMU), BY_INT])
def test_an_interval_of_a_message_that_is_needed_is_denied_in_the_autopilots_name(message: bytes) -> None:
    found = handled(message, 1)
    assert found.passed == ()
    ack = framed(found.answers[0])
    names = ("command", "result", "target_system", "target_component")
    assert (ack.sysid, ack.compid, ack.msgid) == (1, 1, MessageId.COMMAND_ACK)
    assert [ack.fields[field_index(MessageId.COMMAND_ACK, name)] for name in names] == [
        MavCmd.SET_MESSAGE_INTERVAL,
        MavResult.DENIED,
        255,
        Component.MISSIONPLANNER,
    ]


@pytest.mark.parametrize(
    ("message", "vehicles"),
    [
        (interval((1, 1), MessageId.SYS_STATUS), (1,)),
        (interval((2, 1), MessageId.RAW_IMU), (1,)),  # another vehicle
        (interval((1, 100), MessageId.RAW_IMU), (1,)),  # a camera
        (interval((1, 1), MessageId.RAW_IMU, MavCmd.REQUEST_MESSAGE), (1,)),
        (group(6), (1,)),
        (group(1, (2, 1)), (1,)),
        (group(1, (1, 100)), (1,)),
        (group(1, (0, 0)), (1, 2)),
        (STATION.encode(MessageId.PARAM_REQUEST_LIST, 1, 1), (1,)),
        (group(0, (0, 0)), ()),
        (interval((0, 0), MessageId.RAW_IMU), ()),
    ],
)
def test_everything_else_passes(message: bytes, vehicles: tuple[int, ...]) -> None:
    assert handled(message, *vehicles) == Handled((message,))


@pytest.mark.parametrize("target", [(1, 1), (1, 0), (0, 0)])
def test_a_group_that_holds_what_is_needed_is_kept_back_and_noted(target: tuple[int, int]) -> None:
    for number in (1, 12):
        found = handled(group(number, target), 1)
        assert (found.passed, found.answers, len(found.turns)) == ((), (), 1)
