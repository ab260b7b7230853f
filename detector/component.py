"""The detector as a MAVLink component, 191 of the vehicle's system: what it sends, and what is asked of it.

It answers commands, requests for its version, and the MAVLink parameter protocol (PARAM_...), all REAL32; the answer is
always the value in force. Parameters are not kept over a restart: the settings are in force again. No clock, no socket.

Kept back (`keep_rates`) are two requests of ground stations, addressed to the autopilot or to everybody.
SET_MESSAGE_INTERVAL of a message that is needed here is answered with COMMAND_ACK "denied", in the autopilot's name: a
ground station takes an answer only from the component that it asked. REQUEST_DATA_STREAM of a group that holds such a
message has no answer; one for all groups becomes requests for those that hold none.
"""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain

import numpy as np

from detector.fleet import Fleet, Turn
from detector.session import Session
from detector.states import State
from detector.values import AskParameters, Effect, Note, SendCommand, SendFloat, SendText
from mavdiag import __version__
from mavdiag.errors import BaselineError
from mavdiag.link.clock import TimesyncMessage
from mavdiag.link.codec import Decoder, Encoder, Frame, message_name
from mavdiag.link.datagrams import as_columns
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId
from mavdiag.link.parameters import Parameter, Parameters
from mavdiag.link.signing import Signing
from mavdiag.link.vehicles import ASKING, COMMANDS, REQUESTS_MAX, STICKS, Command, asked_of, command_in, sticks_in
from mavdiag.link.wants import Companion, messages_of
from mavdiag.telemetry import Instant
from mavdiag.units import NS_PER_MS

# MAV_PROTOCOL_CAPABILITY: MAVLINK2, PARAM_FLOAT, PARAM_ENCODE_C_CAST
CAPABILITIES = 1 << 13 | 1 << 1 | 1 << 17
VENDOR, MODEL = "mavdiag", "propeller fault detector"
SCALE, TEXTS, ACK = PARAMETERS = "PROP_SCALE", "PROP_TEXTS", "PROP_ACK"
_MS_TURN = 1 << 32

# MAV_STATE in the heartbeat: 2 calibrating, 3 standby, 4 active; a faulted session has none, because it sends none.
HEALTH = {State.WAITING: 3, State.LEARNING: 2, State.FITTING: 2, State.MONITORING: 4, State.LOST: 3}

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


class Sender(Companion):
    """Encodes for one vehicle, with its own sequence numbers."""

    def answer(self, command: Command, result: MavResult) -> bytes:
        """COMMAND_ACK to who sent a command."""
        return self.encode(MessageId.COMMAND_ACK, command.command, result, 0, 0, command.sysid, command.compid)

    def version(self, command: Command) -> bytes | None:
        """AUTOPILOT_VERSION or COMPONENT_INFORMATION_BASIC, if a command asks for one of them, else None."""
        msgid = command.parameter if command.command == MavCmd.REQUEST_MESSAGE else None
        if command.command == MavCmd.REQUEST_AUTOPILOT_CAPABILITIES or msgid == MessageId.AUTOPILOT_VERSION:
            major, minor, patch = (int(part) for part in __version__.split(".")[:3])
            number, none = major << 24 | minor << 16 | patch << 8, (0,) * 8
            told = (CAPABILITIES, number, number, 0, 0, none, none, none, 0, 0, 0)
            return self.encode(MessageId.AUTOPILOT_VERSION, *told)
        if msgid == MessageId.COMPONENT_INFORMATION_BASIC:
            return self.encode(int(msgid), CAPABILITIES, 0, 0, VENDOR, MODEL, __version__, "", "")
        return None

    def frames(self, effect: Effect) -> tuple[list[bytes], bool]:
        """What an effect sends, and whether everybody may read it: else it is for the vehicle's autopilot alone."""
        match effect:
            case SendText(severity, text):
                return [self.statustext(severity, text)], True
            case SendFloat(name, value, vehicle_ns):
                boot_ms = vehicle_ns // NS_PER_MS % _MS_TURN  # the vehicle's own
                return [self.encode(MessageId.NAMED_VALUE_FLOAT, boot_ms, name.encode(), value)], True
            case SendCommand(number, parameters, confirmation):
                return [self.command(number, *parameters, confirmation=confirmation)], False
            case AskParameters(names):
                return [self.read(name) for name in names], False
            case TimesyncMessage(tc1_ns, ts1_ns):
                return [self.encode(MessageId.TIMESYNC, tc1_ns, ts1_ns)], False
        return [], False


def parameters(session: Session) -> Parameters:
    """Scale of all thresholds; STATUSTEXTs a minute; 1 acknowledges, as MAV_CMD_USER_1 does, and reads as 0."""
    scale = Parameter(SCALE, session.settings.threshold_scale, span=(0.5, 4.0))
    texts = Parameter(TEXTS, session.settings.texts_per_minute, span=(4.0, 120.0))
    return Parameters((scale, texts, Parameter(ACK, 0.0, span=(0.0, 1.0))))


def _changed(session: Session, name: str, value: float, whose: str) -> tuple[Effect, ...] | str:
    """What comes of a value within its limits; why not, if it is refused. whose: who sets it."""
    if name == SCALE:
        try:
            return "the vehicle is armed" if session.armed else session.tune(threshold_scale=value)
        except BaselineError as error:
            return str(error)
    if name == TEXTS:
        return session.tune(texts_per_minute=round(value))
    acknowledges = value >= 0.5 and session.acknowledgeable
    return session.acknowledge(whose) if acknowledges else "nothing is to be acknowledged"


def answer(frame: Frame, session: Session, sender: Sender, *, trusted: bool) -> tuple[list[bytes], tuple[Effect, ...]]:
    """The answer to a message of the parameter protocol, and what comes of it: who is not trusted changes nothing."""
    table, effects = parameters(session), tuple[Effect, ...]()
    if trusted and frame.msgid == MessageId.PARAM_SET:
        (name, value), whose = table.wanted(frame), f"{frame.sysid}/{frame.compid}"
        if name not in PARAMETERS:
            return [], ()
        within = table.change(name, value)
        done = _changed(session, name, value, whose) if within else "it is beyond its limits"
        if isinstance(done, str):
            effects = (Note(f"{name} = {value:g} of {whose}: refused, {done}"),)
        else:
            effects = (Note(f"{name} = {value:g} by {whose}"), *done)
        if isinstance(done, str) or name != ACK:
            table = parameters(session)
    return [sender.encode(MessageId.PARAM_VALUE, *fields) for fields in table.told(frame)], effects


@dataclass(slots=True)
class Handled:
    """What becomes of frames."""

    passed: list[bytes] = field(default_factory=list)  # what goes to the vehicle
    answers: list[bytes] = field(default_factory=list)  # what goes back to who sent them
    turns: list[Turn] = field(default_factory=list)  # effects for the daemon


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
        self._acknowledged: dict[int, str] = {}  # whose command was the last that did, by vehicle

    def from_behind(self, messages: Sequence[bytes], now: Instant) -> Handled:
        """Frames of a link behind, one in each message; all pass but requests for rates that are kept.

        Of what is asked of a vehicle's detector `REQUESTS_MAX` at most are answered.
        """
        some, asked, done = as_columns([(message, now.ns) for message in messages]), Counter[int](), Handled()
        frames, passed = self._decoder.take(some), [[message] for message in messages]
        places = np.searchsorted(np.cumsum(some.sizes), frames.rows["begin"], "right")
        for place, frame in zip(places.tolist(), frames, strict=True):
            to = _STICKS_TO.get(frame.msgid)
            if to is not None and (vehicle := self._fleet.vehicles.get(frame.value(to))) is not None:
                vehicle.sticks |= sticks_in((frame,), None)
            if self._keep_rates and (instead := self._kept(frame, done)) is not None:
                passed[place] = instead
            elif (sysid := asked_of(frame)) is not None and asked[sysid] < REQUESTS_MAX:
                asked[sysid] += 1
                self.ask(frame, sysid, done)
        done.passed += chain.from_iterable(passed)
        return done

    def ask(self, frame: Frame, sysid: int, done: Handled, *, trusted: bool = True) -> None:
        """What is asked of a vehicle's detector: parameters, messages, and the command that acknowledges.

        That one closes an inspection, or calls off what is about to be done.
        trusted: it comes from a link behind, or it is signed; any other sender may be forged, and changes nothing.
        """
        if sysid not in self._fleet.vehicles:
            return
        session, sender = self._fleet.vehicles[sysid].session, self._sender(sysid)
        command, whose, effects = command_in(frame), f"{frame.sysid}/{frame.compid}", tuple[Effect, ...]()
        changes = frame.msgid == MessageId.PARAM_SET or (command is not None and command.command == MavCmd.USER_1)
        if changes and not trusted and self._is_new(sysid, frame.sysid, frame.compid):
            what = "acknowledged" if command else "a parameter was set"
            effects = (Note(f"{what} by {whose} on a link that is not signed: refused, it may be forged"),)
        if command is None:
            answers, told = answer(frame, session, sender, trusted=trusted)
            done.answers += answers
            effects += told
        else:
            version = None if changes else sender.version(command)
            result = MavResult.DENIED if changes else MavResult.UNSUPPORTED if version is None else MavResult.ACCEPTED
            if changes and trusted:
                closes = session.acknowledgeable
                again = command.confirmation > 0 and self._acknowledged.get(sysid) == whose  # the answer was lost
                result = MavResult.ACCEPTED if closes or again else MavResult.FAILED
                effects = () if again and not closes else session.acknowledge(whose)
                self._acknowledged |= {sysid: whose} if closes else {}
            done.answers += [sender.answer(command, result), *([] if version is None else [version])]
        done.turns += [Turn(sysid, effects)] if effects else []

    def _kept(self, frame: Frame, done: Handled) -> list[bytes] | None:
        """What goes to the vehicle in place of a request for a rate that is needed here; None for any other frame."""
        vehicle = _addressed(frame, self._fleet.vehicles)
        if vehicle is None:
            return None
        needed = frozenset(messages_of(self._fleet.link.vehicles[vehicle].profile).values())
        instead = list[bytes]()
        if frame.msgid == MessageId.REQUEST_DATA_STREAM:
            group = frame.value("req_stream_id")
            held = [number for number, messages in GROUPS.items() if messages & needed]
            if not held or group not in (ALL_GROUPS, *held):
                return None
            if group == ALL_GROUPS:
                rate = frame.value("req_message_rate"), frame.value("start_stop")
                encode = partial(self._sender(vehicle).encode, frame.msgid, vehicle, Component.AUTOPILOT1)
                instead = [encode(group, *rate) for group in GROUPS if group not in held]
        elif frame.value("command") != MavCmd.SET_MESSAGE_INTERVAL or frame.value("param1") not in needed:
            return None
        else:
            encoder = self._autopilots.setdefault(vehicle, Encoder(vehicle, Component.AUTOPILOT1, self._signing))
            denied = (MavCmd.SET_MESSAGE_INTERVAL, MavResult.DENIED, 0, 0, frame.sysid, frame.compid)
            done.answers.append(encoder.encode(MessageId.COMMAND_ACK, *denied))
        if self._is_new(frame.sysid, frame.compid, frame.msgid):
            who = f"{message_name(frame.msgid)} of {frame.sysid}/{frame.compid}"
            done.turns.append(Turn(vehicle, (Note(f"{who} would change rates that are needed; kept back"),)))
        return instead

    def _is_new(self, *kind: int) -> bool:
        new = kind not in self._noted and len(self._noted) < NOTED_MOST
        self._noted |= {kind} if new else set()
        return new


def _addressed(frame: Frame, watched: Collection[int]) -> int | None:
    """The watched vehicle whose autopilot a request for a rate is addressed to; None if none is.

    A request to all systems (0) counts as one to the only vehicle; on a link of several it passes.
    """
    if frame.msgid not in GUARDED:
        return None
    system, component = frame.value("target_system"), frame.value("target_component")
    if component not in (Component.ALL, Component.AUTOPILOT1):
        return None
    if system == 0 and len(watched) == 1:
        return next(iter(watched))
    return system if isinstance(system, int) and system in watched else None
