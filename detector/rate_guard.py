"""Keeping a ground station behind the detector from changing the rates that the detector needs. No clock, no socket.

It is about two requests, addressed to the autopilot or to everybody. SET_MESSAGE_INTERVAL of a message that is needed
here is answered with COMMAND_ACK "denied", in the autopilot's name: a ground station takes an answer only from the
component that it asked. REQUEST_DATA_STREAM of a group that holds such a message has no answer. Neither is passed on.
A request for all groups becomes requests for those that hold none. Everything else passes.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from mavdiag.link.codec import Encoder, Frame, field_index
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId
from mavdiag.link.signing import Signing
from mavdiag.link.vehicles import COMMANDS

__all__ = ["GUARDED", "GroupRequest", "RateGuard", "Verdict"]

#: Messages that carry such a request.
GUARDED = COMMANDS | {MessageId.REQUEST_DATA_STREAM}

ALL_GROUPS = 0
#: MAV_DATA_STREAM, and what of the messages that a detector may need each group holds: ArduPilot's groups
#: (GCS_MAVLink_Copter.cpp, `STREAM_...`), with the messages of other autopilots beside those of the same kind.
GROUPS: Mapping[int, frozenset[int]] = {
    1: frozenset(  # RAW_SENSORS
        (
            MessageId.RAW_IMU,
            MessageId.SCALED_IMU,
            MessageId.SCALED_IMU2,
            MessageId.SCALED_IMU3,
            MessageId.HIGHRES_IMU,
        )
    ),
    2: frozenset(),  # EXTENDED_STATUS
    3: frozenset((MessageId.SERVO_OUTPUT_RAW, MessageId.ACTUATOR_OUTPUT_STATUS)),  # RC_CHANNELS
    6: frozenset(),  # POSITION
    10: frozenset((MessageId.ATTITUDE, MessageId.ATTITUDE_QUATERNION, MessageId.ATTITUDE_TARGET)),  # EXTRA1
    11: frozenset(),  # EXTRA2
    12: frozenset((MessageId.VIBRATION, MessageId.ESC_TELEMETRY_1_TO_4, MessageId.ESC_STATUS)),  # EXTRA3
}

_COMMAND: Mapping[int, tuple[int, ...]] = {
    msgid: tuple(field_index(msgid, name) for name in ("target_system", "target_component", "command", "param1"))
    for msgid in COMMANDS
}
_GROUP = tuple(
    field_index(MessageId.REQUEST_DATA_STREAM, name)
    for name in ("target_system", "target_component", "req_stream_id", "req_message_rate", "start_stop")
)


@dataclass(frozen=True, slots=True)
class GroupRequest:
    """REQUEST_DATA_STREAM to a vehicle's autopilot. rate_hz: messages a second; start: 1 to start, 0 to stop."""

    vehicle: int
    group: int
    rate_hz: int
    start: int


@dataclass(frozen=True, slots=True)
class Verdict:
    """What becomes of a frame that is not passed on.

    answer: a frame for who sent it; None for none.
    instead: what is asked of the vehicle in its place.
    """

    answer: bytes | None = None
    instead: tuple[GroupRequest, ...] = ()


class RateGuard:
    """Decides on frames from behind; it holds only the sequence numbers of its answers. signing: signs these."""

    def __init__(self, signing: Signing | None = None) -> None:
        self._signing = signing
        self._encoders: dict[tuple[int, int], Encoder] = {}

    def verdict(self, frame: Frame, needed: Mapping[int, Collection[int]]) -> Verdict | None:
        """What becomes of one frame; None if it is to be passed on.

        needed: the messages that are needed of each vehicle, by system id.
        """
        if frame.msgid in _COMMAND:
            return self._command(frame, needed)
        if frame.msgid == MessageId.REQUEST_DATA_STREAM:
            return _group(frame, needed)
        return None

    def _command(self, frame: Frame, needed: Mapping[int, Collection[int]]) -> Verdict | None:
        fields = frame.fields
        system, component, command, msgid = (fields[place] for place in _COMMAND[frame.msgid])
        vehicle = _addressed(system, component, needed)
        if command != MavCmd.SET_MESSAGE_INTERVAL or vehicle is None or msgid not in needed[vehicle]:
            return None
        who = (vehicle, Component.AUTOPILOT1)
        encoder = self._encoders.setdefault(who, Encoder(*who, self._signing))
        to = (frame.sysid, frame.compid)
        return Verdict(encoder.encode(MessageId.COMMAND_ACK, int(command), MavResult.DENIED, 0, 0, *to))


def _group(frame: Frame, needed: Mapping[int, Collection[int]]) -> Verdict | None:
    fields = frame.fields
    system, component, group, rate_hz, start = (int(fields[place]) for place in _GROUP)
    vehicle = _addressed(system, component, needed)
    if vehicle is None:
        return None
    held = {number for number, messages in GROUPS.items() if messages.intersection(needed[vehicle])}
    if group == ALL_GROUPS and held:
        others = (number for number in GROUPS if number not in held)
        return Verdict(instead=tuple(GroupRequest(vehicle, number, rate_hz, start) for number in others))
    return Verdict() if group in held else None


def _addressed(system: object, component: object, needed: Mapping[int, Collection[int]]) -> int | None:
    """The vehicle whose autopilot is addressed; None if none that is watched is.

    A request to all systems (0) counts as one to the only vehicle; on a link of several it passes.
    """
    if component not in (Component.ALL, Component.AUTOPILOT1):
        return None
    if system == 0 and len(needed) == 1:
        return next(iter(needed))
    return system if isinstance(system, int) and system in needed else None
