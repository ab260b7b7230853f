"""What ground stations ask of the detector: commands, parameters, and rates that it keeps. No clock, no socket.

Kept back (`keep_rates`) are two requests, addressed to the autopilot or to everybody. SET_MESSAGE_INTERVAL of a message
that is needed here is answered with COMMAND_ACK "denied", in the autopilot's name: a ground station takes an answer
only from the component that it asked. REQUEST_DATA_STREAM of a group that holds such a message has no answer; one for
all groups becomes requests for those that hold none.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from detector.component import Sender, answer
from detector.fleet import Fleet, Turn
from detector.values import Effect, Note
from mavdiag.link.codec import Decoder, Encoder, Frame, message_name
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId
from mavdiag.link.signing import Signing
from mavdiag.link.vehicles import ASKING, COMMANDS, STICKS, Command, asked_of, command_in, sticks_in
from mavdiag.link.wants import messages_of
from mavdiag.telemetry import Instant

NOTED_MOST = 64  # requests that were kept back are named once each, as long as they are so few (our choice)

#: Messages that carry a request for a rate.
GUARDED = COMMANDS | {MessageId.REQUEST_DATA_STREAM}
_STICKS_TO: Mapping[int, str] = {MessageId.MANUAL_CONTROL: "target", MessageId.RC_CHANNELS_OVERRIDE: "target_system"}
ALL_GROUPS = 0
#: MAV_DATA_STREAM, and what of the messages that a detector may need each group holds: ArduPilot's groups
#: (GCS_MAVLink_Copter.cpp, `STREAM_...`), with the messages of other autopilots beside those of the same kind.
GROUPS: Mapping[int, frozenset[int]] = {
    1: frozenset(  # RAW_SENSORS
        (MessageId.RAW_IMU, MessageId.SCALED_IMU, MessageId.SCALED_IMU2, MessageId.SCALED_IMU3, MessageId.HIGHRES_IMU)
    ),
    2: frozenset(),  # EXTENDED_STATUS
    3: frozenset((MessageId.SERVO_OUTPUT_RAW, MessageId.ACTUATOR_OUTPUT_STATUS)),  # RC_CHANNELS
    6: frozenset(),  # POSITION
    10: frozenset((MessageId.ATTITUDE, MessageId.ATTITUDE_QUATERNION, MessageId.ATTITUDE_TARGET)),  # EXTRA1
    11: frozenset(),  # EXTRA2
    12: frozenset((MessageId.VIBRATION, MessageId.ESC_TELEMETRY_1_TO_4, MessageId.ESC_STATUS)),  # EXTRA3
}


@dataclass(frozen=True, slots=True)
class Handled:
    """What became of frames."""

    passed: tuple[bytes, ...] = ()  # what goes to the vehicle
    answers: tuple[bytes, ...] = ()  # what goes back to who sent them
    turns: tuple[Turn, ...] = ()  # effects for the daemon

    def __add__(self, other: "Handled") -> "Handled":
        return Handled(self.passed + other.passed, self.answers + other.answers, self.turns + other.turns)


class Requests:
    """Answers for all vehicles of a fleet. sender: encodes for a vehicle's detector, by system id.

    signing: of the vehicle's link, None without; frames from behind are trusted as they are.
    """

    def __init__(
        self, fleet: Fleet, keep_rates: bool, sender: Callable[[int], Sender], signing: Signing | None = None
    ) -> None:
        self._fleet, self._keep_rates, self._sender, self._signing = fleet, keep_rates, sender, signing
        self._decoder = Decoder(GUARDED | ASKING | STICKS.keys())
        self._noted: set[tuple[int, ...]] = set()
        self._autopilots: dict[int, Encoder] = {}  # of the answers in an autopilot's name

    def from_behind(self, messages: Iterable[bytes], now: Instant) -> Handled:
        """Frames of a link behind, one in each message; all pass but requests for rates that are kept."""
        handled = Handled()
        for message in messages:
            frames = self._decoder.feed_datagram(message, now.ns)
            kept = self._kept(frames[0]) if frames and self._keep_rates else None
            vehicle = asked_of(frames[0]) if frames else None
            self._note_sticks(frames)
            if kept is not None:
                handled += kept
            elif vehicle is not None:
                handled += Handled((message,)) + self.asked(frames[0], vehicle)
            else:
                handled += Handled((message,))
        return handled

    def _note_sticks(self, frames: Sequence[Frame]) -> None:
        for frame in frames:
            to = _STICKS_TO.get(frame.msgid)
            if to is not None and (vehicle := self._fleet.vehicles.get(frame.value(to))) is not None:
                vehicle.sticks |= sticks_in((frame,), None)

    def asked(self, frame: Frame, sysid: int, *, trusted: bool = True) -> Handled:
        """What is asked of a vehicle's detector: parameters, messages, and the command that acknowledges.

        That one closes an inspection, or calls off what is about to be done.
        trusted: it comes from a link behind, or it is signed; any other sender may be forged, and changes nothing.
        """
        if sysid not in self._fleet.vehicles:
            return Handled()
        session, sender = self._fleet.vehicles[sysid].session, self._sender(sysid)
        command, effects, more = command_in(frame), tuple[Effect, ...](), list[bytes]()
        changes = frame.msgid == MessageId.PARAM_SET or (command is not None and command.command == MavCmd.USER_1)
        if changes and not trusted and self._is_new(sysid, frame.sysid, frame.compid):
            what = "acknowledged" if command else "a parameter was set"
            whose = f"{frame.sysid}/{frame.compid}"
            effects = (Note(f"{what} by {whose} on a link that is not signed: refused, it may be forged"),)
        if command is not None:
            result = MavResult.UNSUPPORTED
            if changes:
                result = MavResult.ACCEPTED if session.acknowledgeable else MavResult.FAILED
                result = result if trusted else MavResult.DENIED
                effects = session.acknowledge(f"{frame.sysid}/{frame.compid}") if trusted else effects
            elif (version := sender.version(_requested(command))) is not None:
                result, more = MavResult.ACCEPTED, [version]
            more = [sender.answer(command, result), *more]
        else:
            more, told = answer(frame, session, sender, trusted=trusted)
            effects += told
        return Handled((), tuple(more), (Turn(sysid, effects),) if effects else ())

    def _kept(self, frame: Frame) -> Handled | None:
        """What becomes of a request for a rate that is needed here; None if it is passed on."""
        needed = {
            sysid: frozenset(messages_of(self._fleet.link.vehicles[sysid].profile).values())
            for sysid in self._fleet.vehicles
        }
        vehicle = _addressed(frame, needed)
        if vehicle is None:
            return None
        passed, answers = list[bytes](), list[bytes]()
        if frame.msgid == MessageId.REQUEST_DATA_STREAM:
            group = frame.value("req_stream_id")
            held = [number for number, messages in GROUPS.items() if messages & needed[vehicle]]
            if not held or group not in (ALL_GROUPS, *held):
                return None
            if group == ALL_GROUPS:
                to, rate = (
                    (vehicle, Component.AUTOPILOT1),
                    (frame.value("req_message_rate"), frame.value("start_stop")),
                )
                others = (group for group in GROUPS if group not in held)
                passed += [self._sender(vehicle).encode(frame.msgid, *to, group, *rate) for group in others]
        elif frame.value("command") != MavCmd.SET_MESSAGE_INTERVAL or frame.value("param1") not in needed[vehicle]:
            return None
        else:
            encoder = self._autopilots.setdefault(vehicle, Encoder(vehicle, Component.AUTOPILOT1, self._signing))
            denied = (MavCmd.SET_MESSAGE_INTERVAL, MavResult.DENIED, 0, 0, frame.sysid, frame.compid)
            answers.append(encoder.encode(MessageId.COMMAND_ACK, *denied))
        turns: tuple[Turn, ...] = ()
        if self._is_new(frame.sysid, frame.compid, frame.msgid):
            who = f"{message_name(frame.msgid)} of {frame.sysid}/{frame.compid}"
            turns = (Turn(vehicle, (Note(f"{who} would change rates that are needed; kept back"),)),)
        return Handled(tuple(passed), tuple(answers), turns)

    def _is_new(self, *kind: int) -> bool:
        new = kind not in self._noted and len(self._noted) < NOTED_MOST
        self._noted |= {kind} if new else set()
        return new


def _requested(command: Command) -> int:
    """The message that a command asks for; -1 if it asks for none."""
    if command.command == MavCmd.REQUEST_AUTOPILOT_CAPABILITIES:
        return MessageId.AUTOPILOT_VERSION
    asks = command.command == MavCmd.REQUEST_MESSAGE and 0 <= command.parameter < 1 << 24
    return int(command.parameter) if asks else -1


def _addressed(frame: Frame, needed: Mapping[int, Collection[int]]) -> int | None:
    """The watched vehicle whose autopilot a request for a rate is addressed to; None if none is.

    A request to all systems (0) counts as one to the only vehicle; on a link of several it passes.
    """
    if frame.msgid not in GUARDED:
        return None
    system, component = frame.value("target_system"), frame.value("target_component")
    if component not in (Component.ALL, Component.AUTOPILOT1):
        return None
    if system == 0 and len(needed) == 1:
        return next(iter(needed))
    return system if isinstance(system, int) and system in needed else None
