"""Requests for rates from behind: those for what is needed are kept back and answered, all others pass."""

from types import SimpleNamespace
from typing import Any

import pytest

from detector.requests import Handled, Requests
from detector.sender import MavlinkSender
from mavdiag.link.codec import Decoder, Encoder, Frame, field_index
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId
from mavdiag.link.profiles import PROFILES
from mavdiag.telemetry import Instant

STATION = Encoder(255, Component.MISSIONPLANNER)


def handled(message: bytes, *vehicles: int) -> Handled:
    streams = {sysid: SimpleNamespace(profile=PROFILES["ardupilot"]) for sysid in vehicles}
    fleet: Any = SimpleNamespace(vehicles=dict.fromkeys(vehicles), link=SimpleNamespace(vehicles=streams))
    requests = Requests(fleet, True, MavlinkSender)
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
