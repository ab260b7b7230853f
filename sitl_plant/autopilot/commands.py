"""What the emulated autopilot does with the frames it receives: answer what is meant for it, pass on the rest.

Sans-I/O: frames in, replies and forwards out. Routing follows ArduPilot's rules (developer documentation, "MAVLink
Routing in ArduPilot"): a broadcast goes to every other link that is in use; a message with an address goes to the
link over which that component sends; nothing goes back where it came from, and nothing that claims to come from the
autopilot itself is believed. The emulated autopilot flies its own path: it takes no command but those about messages.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import TypeAlias

from mavdiag.errors import UsageError
from mavdiag.link.codec import Frame, field_index
from mavdiag.link.layout import Argument
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId
from sitl_plant.autopilot.schedule import Schedule

__all__ = ["Autopilot", "Forward", "Parameter", "Reply"]

ROUTES_MAX = 64  # components remembered; further ones are answered but nothing is routed to them
MAVLINK2 = 1 << 13  # MAV_PROTOCOL_CAPABILITY_MAVLINK2
PARAM_FLOAT = 1 << 1  # MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
MESSAGE_INTERVAL = 244  # its interval 0 means that the message is not carried
REAL32 = 9  # MAV_PARAM_TYPE_REAL32
ALL_STREAMS = 0  # MAV_DATA_STREAM_ALL
VERSION = 4 << 24 | 255  # AUTOPILOT_VERSION.flight_sw_version: 4.0.0, FIRMWARE_VERSION_TYPE_OFFICIAL

Parameter: TypeAlias = tuple[str, float]


@dataclass(frozen=True, slots=True)
class Reply:
    """A message of the autopilot's own, for one link; fields as declared."""

    link: int
    msgid: int
    fields: tuple[Argument, ...]


@dataclass(frozen=True, slots=True)
class Forward:
    """A frame that goes on to another link as its sender's."""

    link: int
    frame: Frame


Action: TypeAlias = Reply | Forward


class Autopilot:
    """The receiving half of the emulated autopilot, for all its links.

    schedules: one for each link.
    parameters: read-only, as name and value.
    streams: the messages that each MAV_DATA_STREAM sets.
    """

    def __init__(
        self,
        sysid: int,
        schedules: Sequence[Schedule],
        parameters: Sequence[Parameter],
        streams: Mapping[int, tuple[int, ...]] = MappingProxyType({}),
    ) -> None:
        self._identity = (sysid, int(Component.AUTOPILOT1))
        self._streams = streams
        self._schedules = schedules
        self._parameters = tuple(parameters)
        self._routes: dict[tuple[int, int], int] = {}
        self._handlers: Mapping[int, Callable[[int, Frame, int], list[Action]]] = {
            MessageId.COMMAND_LONG: self._command,
            MessageId.COMMAND_INT: self._command,
            MessageId.PARAM_REQUEST_LIST: self._list_parameters,
            MessageId.PARAM_REQUEST_READ: self._read_parameter,
            MessageId.PARAM_SET: self._read_parameter,
            MessageId.MISSION_REQUEST_LIST: self._count_mission,
            MessageId.TIMESYNC: self._tell_time,
            MessageId.REQUEST_DATA_STREAM: self._set_stream,
        }

    def step(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        """Answer and route one frame that came in on `link` at vehicle time `now_ns`."""
        source = (frame.sysid, frame.compid)
        if source == self._identity:
            return []
        if source in self._routes or len(self._routes) < ROUTES_MAX:
            self._routes[source] = link
        target = _target(frame)
        actions: list[Action] = [Forward(to, frame) for to in self._links_towards(target) if to != link]
        if target[0] in (0, self._identity[0]) and target[1] in (Component.ALL, self._identity[1]):
            actions += self._handlers.get(frame.msgid, _ignore)(link, frame, now_ns)
        return actions

    def _links_towards(self, target: tuple[int, int]) -> list[int]:
        """The links over which the components of an address send; 0 means any."""
        if target == self._identity:
            return []
        return sorted(
            {
                link
                for (sysid, compid), link in self._routes.items()
                if target[0] in (0, sysid) and target[1] in (Component.ALL, compid)
            }
        )

    def _command(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        command, first, second = (int(_value(frame, name)) for name in ("command", "param1", "param2"))
        replies: list[Action] = []
        match command:
            case MavCmd.SET_MESSAGE_INTERVAL:
                result = self._schedules[link].set_interval(first, second)
            case MavCmd.REQUEST_MESSAGE if first == MessageId.AUTOPILOT_VERSION:
                result = MavResult.ACCEPTED
                replies.append(Reply(link, MessageId.AUTOPILOT_VERSION, (MAVLINK2 | PARAM_FLOAT, VERSION)))
            case MavCmd.REQUEST_MESSAGE if first == MESSAGE_INTERVAL:
                result = MavResult.ACCEPTED
                replies.append(Reply(link, MESSAGE_INTERVAL, (second, self._schedules[link].interval_us(second))))
            case MavCmd.REQUEST_MESSAGE:
                result = self._schedules[link].ask_once(first)
            case _:
                result = MavResult.UNSUPPORTED
        # COMMAND_ACK: command, result, progress, result_param2, target_system, target_component
        ack = Reply(link, MessageId.COMMAND_ACK, (command, result, 0, 0, frame.sysid, frame.compid))
        return [ack, *replies]

    def _list_parameters(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        return [self._parameter(link, index) for index in range(len(self._parameters))]

    def _read_parameter(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        """The parameter as it is, after PARAM_SET too: none can be changed. An unknown one is not answered."""
        index = -1 if frame.msgid == MessageId.PARAM_SET else int(_value(frame, "param_index"))
        if index < 0:
            wanted = _text(frame, "param_id")
            index = next((i for i, (name, _) in enumerate(self._parameters) if name == wanted), -1)
        return [self._parameter(link, index)] if 0 <= index < len(self._parameters) else []

    def _parameter(self, link: int, index: int) -> Reply:
        name, value = self._parameters[index]
        return Reply(link, MessageId.PARAM_VALUE, (name, value, REAL32, len(self._parameters), index))

    def _count_mission(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        """Ground stations wait for an answer: there is no mission."""
        return [Reply(link, MessageId.MISSION_COUNT, (frame.sysid, frame.compid, 0))]

    def _set_stream(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        """REQUEST_DATA_STREAM, which has no answer; start_stop 0 is silence, whatever the rate."""
        stream, rate_hz, start = (_value(frame, name) for name in ("req_stream_id", "req_message_rate", "start_stop"))
        every = [msgid for messages in self._streams.values() for msgid in messages]
        messages = every if stream == ALL_STREAMS else self._streams.get(int(stream), ())
        if start in (0, 1):
            self._schedules[link].set_stream(messages, rate_hz * start)
        return []

    def _tell_time(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        """TIMESYNC: a request has tc1 = 0 and gets its ts1 back beside the vehicle's time."""
        if _value(frame, "tc1"):
            return []
        return [Reply(link, MessageId.TIMESYNC, (now_ns, int(_value(frame, "ts1"))))]


def _ignore(link: int, frame: Frame, now_ns: int) -> list[Action]:
    return []


@cache
def _place(msgid: int, name: str) -> int | None:
    """Where a field lies in `Frame.fields`; None if the message has none of that name."""
    try:
        return field_index(msgid, name)
    except UsageError:
        return None


def _value(frame: Frame, name: str) -> float:
    """A number from a frame; 0 for a field that its message has not, and for what is no finite number."""
    place = _place(frame.msgid, name)
    value = frame.fields[place] if place is not None else 0
    return value if isinstance(value, int | float) and abs(value) < float("inf") else 0


def _text(frame: Frame, name: str) -> str:
    place = _place(frame.msgid, name)
    value = frame.fields[place] if place is not None else b""
    return value.partition(b"\0")[0].decode(errors="replace") if isinstance(value, bytes) else ""


def _target(frame: Frame) -> tuple[int, int]:
    """System and component that a frame is meant for; 0 is everyone."""
    return int(_value(frame, "target_system")), int(_value(frame, "target_component"))
