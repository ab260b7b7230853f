"""What others address to a vehicle's on-board computer (component 191): commands, answers, parameter requests."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from mavdiag.link.codec import Frame, field_index
from mavdiag.link.messages import Component, MessageId

# Commands and parameter requests for one vehicle's computer that are handed out at a time, so that a flood is not
# answered (our choice).
REQUESTS_MAX = 16

#: Messages that carry a command.
COMMANDS = frozenset({MessageId.COMMAND_LONG, MessageId.COMMAND_INT})
#: Messages that ask for parameters, or set one.
PARAMETER_REQUESTS = frozenset({MessageId.PARAM_REQUEST_LIST, MessageId.PARAM_REQUEST_READ, MessageId.PARAM_SET})

_TARGETS = ("target_system", "target_component")
_ACK = tuple(field_index(MessageId.COMMAND_ACK, name) for name in ("command", "result", "target_component"))
_COMMAND: Mapping[int, tuple[int, ...]] = {
    msgid: tuple(field_index(msgid, name) for name in ("command", *_TARGETS)) for msgid in COMMANDS
}
_PARAMETER: Mapping[int, tuple[int, ...]] = {
    msgid: tuple(field_index(msgid, name) for name in _TARGETS) for msgid in PARAMETER_REQUESTS
}


@dataclass(frozen=True, slots=True)
class Ack:
    """What an autopilot answered to a command of ours.

    command: MAV_CMD.
    result: MAV_RESULT.
    """

    command: int
    result: int


@dataclass(frozen=True, slots=True)
class Command:
    """A command that was addressed to a vehicle's on-board computer.

    command: MAV_CMD.
    sysid, compid: who sent it.
    """

    command: int
    sysid: int
    compid: int


def acks_in(frames: Iterable[Frame]) -> tuple[Ack, ...]:
    """The autopilot's acknowledgements to us (or to nobody in particular, as MAVLink 1 has it)."""
    found: list[Ack] = []
    for frame in frames:
        if frame.msgid == MessageId.COMMAND_ACK and frame.compid == Component.AUTOPILOT1:
            command, result, component = (int(frame.fields[place]) for place in _ACK)
            if component in (Component.ALL, Component.ONBOARD_COMPUTER):
                found.append(Ack(command, result))
    return tuple(found)


def commands_in(frames: Iterable[Frame]) -> dict[int, list[Command]]:
    """Commands to on-board computers, by the vehicle's system id; at most `REQUESTS_MAX` for each."""
    found: dict[int, list[Command]] = {}
    for frame in frames:
        if frame.msgid in _COMMAND:
            command, system, component = (int(frame.fields[place]) for place in _COMMAND[frame.msgid])
            if component == Component.ONBOARD_COMPUTER:
                found.setdefault(system, []).append(Command(command, frame.sysid, frame.compid))
    return {system: some[:REQUESTS_MAX] for system, some in found.items()}


def parameters_asked(frame: Frame) -> int | None:
    """The vehicle about whose on-board computer's parameters a frame asks; None if it does not.

    PARAM_REQUEST_LIST may be addressed to all components.
    """
    if frame.msgid not in _PARAMETER:
        return None
    system, component = (int(frame.fields[place]) for place in _PARAMETER[frame.msgid])
    everybody = frame.msgid == MessageId.PARAM_REQUEST_LIST and component == Component.ALL
    return system if component == Component.ONBOARD_COMPUTER or everybody else None


def parameters_asked_in(frames: Iterable[Frame]) -> dict[int, list[Frame]]:
    """The frames that ask about parameters of on-board computers, by system id; at most `REQUESTS_MAX` for each."""
    found: dict[int, list[Frame]] = {}
    for frame in frames:
        system = parameters_asked(frame)
        if system is not None:
            found.setdefault(system, []).append(frame)
    return {system: some[:REQUESTS_MAX] for system, some in found.items()}
