"""Requests for rates from behind: those for what is needed are kept back and answered, all others pass."""

import pytest

from detector.rate_guard import GROUPS, GroupRequest, RateGuard, Verdict
from mavdiag.link.codec import Decoder, Encoder, Frame, field_index
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId

NEEDED = {1: frozenset({MessageId.RAW_IMU, MessageId.ATTITUDE_TARGET, MessageId.VIBRATION})}
STATION = Encoder(255, Component.MISSIONPLANNER)


def framed(data: bytes) -> Frame:
    [frame] = Decoder().feed_datagram(data, 0)
    return frame


def interval(target: tuple[int, int], msgid: int, command: int = MavCmd.SET_MESSAGE_INTERVAL) -> Frame:
    return framed(STATION.encode(MessageId.COMMAND_LONG, *target, command, 0, msgid, 250_000))


def group(number: int, target: tuple[int, int] = (1, 1)) -> Frame:
    return framed(STATION.encode(MessageId.REQUEST_DATA_STREAM, *target, number, 4, 1))


def test_an_interval_of_a_message_that_is_needed_is_denied_in_the_autopilots_name() -> None:
    verdict = RateGuard().verdict(interval((1, 1), MessageId.RAW_IMU), NEEDED)
    assert verdict is not None
    assert verdict.answer is not None
    ack = framed(verdict.answer)
    names = ("command", "result", "target_system", "target_component")
    assert (ack.sysid, ack.compid, ack.msgid) == (1, 1, MessageId.COMMAND_ACK)
    assert [ack.fields[field_index(MessageId.COMMAND_ACK, name)] for name in names] == [
        MavCmd.SET_MESSAGE_INTERVAL,
        MavResult.DENIED,
        255,
        Component.MISSIONPLANNER,
    ]


def test_command_int_counts_as_well() -> None:
    data = STATION.encode(MessageId.COMMAND_INT, 1, 1, 0, MavCmd.SET_MESSAGE_INTERVAL, 0, 0, MessageId.RAW_IMU, 250_000)
    assert RateGuard().verdict(framed(data), NEEDED) is not None


@pytest.mark.parametrize(
    "frame",
    [
        interval((1, 1), MessageId.SYS_STATUS),
        interval((2, 1), MessageId.RAW_IMU),  # another vehicle
        interval((1, 100), MessageId.RAW_IMU),  # a camera
        interval((1, 1), MessageId.RAW_IMU, MavCmd.REQUEST_MESSAGE),
        group(6),
        group(1, (2, 1)),
        group(1, (1, 100)),
        framed(STATION.encode(MessageId.PARAM_REQUEST_LIST, 1, 1)),
    ],
)
def test_everything_else_passes(frame: Frame) -> None:
    assert RateGuard().verdict(frame, NEEDED) is None


@pytest.mark.parametrize("target", [(1, 1), (1, 0), (0, 0)])
def test_a_group_that_holds_what_is_needed_is_kept_back(target: tuple[int, int]) -> None:
    assert RateGuard().verdict(group(1, target), NEEDED) == Verdict()
    assert RateGuard().verdict(group(12, target), NEEDED) == Verdict()


def test_a_request_for_all_groups_becomes_requests_for_the_others() -> None:
    verdict = RateGuard().verdict(group(0), NEEDED)
    assert verdict is not None
    assert verdict.answer is None
    assert verdict.instead == tuple(GroupRequest(1, number, 4, 1) for number in (2, 3, 6, 11))
    assert {one.group for one in verdict.instead} | {1, 10, 12} == set(GROUPS)


def test_without_a_vehicle_everything_passes() -> None:
    assert RateGuard().verdict(group(0, (0, 0)), {}) is None
    assert RateGuard().verdict(interval((0, 0), MessageId.RAW_IMU), {}) is None
