"""What ground stations ask of the detector: its own parameters, commands, and rates that it keeps. No clock, no socket.

Frames go in with `now`; what is passed on, what is answered and what the daemon has to do come out.

Kept back (`keep_rates`) are two requests, addressed to the autopilot or to everybody. SET_MESSAGE_INTERVAL of a message
that is needed here is answered with COMMAND_ACK "denied", in the autopilot's name: a ground station takes an answer
only from the component that it asked. REQUEST_DATA_STREAM of a group that holds such a message has no answer; one for
all groups becomes requests for those that hold none.

The parameters are those of component 191, by the MAVLink parameter protocol. Two can be set; the others are figures to
read. A value that is refused is answered with the value in force. Nothing here is sent to the autopilot.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import isfinite

from detector.config import Settings
from detector.figures import VehicleFigures
from detector.fleet import Fleet, Turn
from detector.sender import MavlinkSender
from detector.session import Session
from detector.states import State
from detector.values import Effect, Note
from mavdiag.baseline import Baseline
from mavdiag.decision.diagnosis import Stage
from mavdiag.link.codec import Decoder, Encoder, Frame, field_index, message_name
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId
from mavdiag.link.signing import Signing
from mavdiag.link.vehicles import COMMANDS, PARAMETER_REQUESTS, Command, command_in, parameters_asked
from mavdiag.link.wants import messages_of
from mavdiag.telemetry import Instant

NOTED_MOST = 64  # requests that were kept back are named once each, as long as they are so few (our choice)
NOTHING_TO_JUDGE_BY = "there is no baseline to go back to"
WHILE_LEARNING = "it can be set when learning is over"
REAL32 = 9  # MAV_PARAM_TYPE_REAL32: all of our parameters are floats

#: Messages that carry a request for a rate.
GUARDED = COMMANDS | {MessageId.REQUEST_DATA_STREAM}
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
_TARGETS = ("target_system", "target_component")


@dataclass(frozen=True, slots=True)
class Handled:
    """What became of frames."""

    passed: tuple[bytes, ...] = ()  # what goes to the vehicle
    answers: tuple[bytes, ...] = ()  # what goes back to who sent them
    turns: tuple[Turn, ...] = ()  # effects for the daemon

    def __add__(self, other: "Handled") -> "Handled":
        return Handled(self.passed + other.passed, self.answers + other.answers, self.turns + other.turns)


@dataclass(frozen=True, slots=True)
class OwnParameter:
    """One parameter of ours."""

    name: str  # at most 16 bytes
    value: Callable[[Session, VehicleFigures], float] = field(repr=False)  # what it is now
    span: tuple[float, float] | None = None  # what it may be set to; None if it is only read


def _learn_s(session: Session, figures: VehicleFigures) -> float:
    return session.spec.settings.learn or 0.0 if session.baseline is None else 0.0


PARAMETERS = (
    OwnParameter("MD_LEARN_S", _learn_s, (0.0, 3600.0)),
    OwnParameter("MD_THR_SCALE", lambda session, figures: session.spec.settings.threshold_scale, (0.5, 4.0)),
    OwnParameter("MD_STATE", lambda session, figures: float(list(State).index(session.state))),
    OwnParameter("MD_VERDICT", lambda session, figures: float(list(Stage).index(session.diagnosis.stage))),
    OwnParameter("MD_ROTOR", lambda session, figures: float(session.diagnosis.rotor or 0)),
    OwnParameter("MD_GYRO_HZ", lambda session, figures: figures.gyro_hz),
    OwnParameter("MD_JUDGED_S", lambda session, figures: figures.judged_s),
    OwnParameter("MD_ALARMS", lambda session, figures: float(figures.events)),
    OwnParameter("MD_LOST", lambda session, figures: float(figures.lost)),
)
_BY_NAME: Mapping[object, OwnParameter] = {parameter.name: parameter for parameter in PARAMETERS}


class Requests:
    """Answers for all vehicles of a fleet. sender: encodes for a vehicle's detector, by system id.

    signing: of the vehicle's link, None without; frames from behind are trusted as they are.
    """

    def __init__(
        self, fleet: Fleet, settings: Settings, sender: Callable[[int], MavlinkSender], signing: Signing | None = None
    ) -> None:
        self._fleet, self._settings, self._sender, self._signing = fleet, settings, sender, signing
        self._decoder = Decoder(GUARDED | PARAMETER_REQUESTS)
        self._noted: set[tuple[int, ...]] = set()
        self._before: dict[int, Baseline] = {}  # what was judged by before learning anew
        self._autopilots: dict[int, Encoder] = {}  # of the answers in an autopilot's name

    def from_behind(self, messages: Iterable[bytes], now: Instant) -> Handled:
        """Frames of a link behind, one in each message; all pass but requests for rates that are kept."""
        handled = Handled()
        for message in messages:
            frames = self._decoder.feed_datagram(message, now.ns)
            handled += self._from_behind(frames[0], message, now) if frames else Handled((message,))
        return handled

    def _from_behind(self, frame: Frame, message: bytes, now: Instant) -> Handled:
        asked = parameters_asked(frame)
        if asked is not None:
            return Handled((message,)) + self.parameters(asked, (frame,), now)
        kept = self._kept(frame) if self._settings.keep_rates else None
        if kept is not None:
            return kept + Handled(turns=self._kept_back(frame))
        command = command_in(frame)
        answer = Handled() if command is None else self.command(command[1], command[0])
        return Handled((message,)) + answer

    def command(self, command: Command, sysid: int, *, trusted: bool = True) -> Handled:
        """A command for a vehicle's detector. It takes one: an inspection is acknowledged.

        trusted: it comes from a link behind, or it is signed; any other sender may be forged.
        """
        if sysid not in self._fleet.vehicles:
            return Handled()
        whose, effects, result = f"{command.sysid}/{command.compid}", tuple[Effect, ...](), MavResult.UNSUPPORTED
        if command.command == MavCmd.USER_1 and trusted:
            session = self._fleet.vehicles[sysid].session
            was_open = session.diagnosis.stage is Stage.INSPECT
            effects, result = session.acknowledge(whose), MavResult.ACCEPTED if was_open else MavResult.FAILED
        elif command.command == MavCmd.USER_1:
            result = MavResult.DENIED
            if self._note_once(sysid, command.sysid, command.compid):
                effects = (Note(f"acknowledged by {whose} on a link that is not signed: refused, it may be forged"),)
        turns = (Turn(sysid, effects),) if effects else ()
        return Handled((), (self._sender(sysid).answer(command, result),), turns)

    def parameters(self, sysid: int, frames: Iterable[Frame], now: Instant) -> Handled:
        """Requests about a vehicle's detector's parameters. One for a parameter that is not there gets no answer."""
        if not self._settings.parameters or sysid not in self._fleet.vehicles:
            return Handled()
        answers, effects = list[bytes](), list[Effect]()
        for frame in frames:
            shown = PARAMETERS if frame.msgid == MessageId.PARAM_REQUEST_LIST else self._named(frame)
            if shown and frame.msgid == MessageId.PARAM_SET:
                effects += self._set(sysid, shown[0], _field(frame, "param_value"), now)
            for parameter in shown:
                fields = (self._value(sysid, parameter), REAL32, len(PARAMETERS), PARAMETERS.index(parameter))
                answers.append(self._sender(sysid).frame(MessageId.PARAM_VALUE, parameter.name, *fields))
        return Handled((), tuple(answers), (Turn(sysid, tuple(effects)),) if effects else ())

    def _named(self, frame: Frame) -> tuple[OwnParameter, ...]:
        number = -1 if frame.msgid == MessageId.PARAM_SET else _field(frame, "param_index")
        if isinstance(number, int) and 0 <= number < len(PARAMETERS):
            return (PARAMETERS[number],)
        found = _BY_NAME.get(_field(frame, "param_id")) if number == -1 else None
        return () if found is None else (found,)

    def _value(self, sysid: int, parameter: OwnParameter) -> float:
        return parameter.value(self._fleet.vehicles[sysid].session, self._fleet.figures_of(sysid))

    def _set(self, sysid: int, parameter: OwnParameter, value: object, now: Instant) -> tuple[Effect, ...]:
        """Set a parameter: the session begins anew with what is left of the old one. A refusal is recorded."""
        name, span, before = parameter.name, parameter.span, self._value(sysid, parameter)
        if not isinstance(value, float) or value == before:
            return ()
        vehicle = self._fleet.vehicles[sysid]
        spec, present, refused, changed = vehicle.session.spec, vehicle.session.baseline, "", {}
        baseline = present
        if span is None:
            refused = "it can only be read"
        elif not (isfinite(value) and span[0] <= value <= span[1]):
            refused = f"it may be {span[0]:g} to {span[1]:g}"
        elif name == "MD_THR_SCALE":
            changed, refused = {"threshold_scale": value}, WHILE_LEARNING if present is None else ""
        elif value > 0:
            changed, baseline = {"learn": value}, None
        else:
            baseline = self._before.get(sysid)
            refused = "" if baseline else NOTHING_TO_JUDGE_BY
        if refused:
            return (Note(f"{name} {value:g} refused: {refused}"),)
        if present is not None:
            self._before[sysid] = present
        settings = spec.settings.model_copy(update=changed)
        left = vehicle.restart(replace(spec, baseline=baseline, settings=settings), now)
        return (*left, Note(f"{name} set from {before:g} to {value:g}"))

    def _kept(self, frame: Frame) -> Handled | None:
        """What becomes of a request for a rate that is needed here; None if it is passed on."""
        needed = {
            sysid: frozenset(messages_of(self._fleet.link.vehicles[sysid].profile).values())
            for sysid in self._fleet.vehicles
        }
        vehicle = _addressed(frame, needed)
        if vehicle is None:
            return None
        if frame.msgid == MessageId.REQUEST_DATA_STREAM:
            group = _field(frame, "req_stream_id")
            held = [number for number, messages in GROUPS.items() if messages & needed[vehicle]]
            if group == ALL_GROUPS and held:
                to, how = (vehicle, Component.AUTOPILOT1), ("req_message_rate", "start_stop")
                rate = [int(frame.fields[field_index(frame.msgid, name)]) for name in how]
                others = (group for group in GROUPS if group not in held)
                return Handled(tuple(self._sender(vehicle).frame(frame.msgid, *to, group, *rate) for group in others))
            return Handled() if group in held else None
        command, msgid = _field(frame, "command"), _field(frame, "param1")
        if command != MavCmd.SET_MESSAGE_INTERVAL or msgid not in needed[vehicle]:
            return None
        encoder = self._autopilots.setdefault(vehicle, Encoder(vehicle, Component.AUTOPILOT1, self._signing))
        denied = (MavCmd.SET_MESSAGE_INTERVAL, MavResult.DENIED, 0, 0, frame.sysid, frame.compid)
        return Handled(answers=(encoder.encode(MessageId.COMMAND_ACK, *denied),))

    def _kept_back(self, frame: Frame) -> tuple[Turn, ...]:
        """What is recorded of a request that was kept back: the first of a kind from each sender."""
        if not self._note_once(frame.sysid, frame.compid, frame.msgid):
            return ()
        who = f"{message_name(frame.msgid)} of {frame.sysid}/{frame.compid}"
        note = Note(f"{who} would change rates that are needed; kept back")
        return tuple(Turn(sysid, (note,)) for sysid in list(self._fleet.vehicles)[:1])

    def _note_once(self, *kind: int) -> bool:
        if kind in self._noted or len(self._noted) >= NOTED_MOST:
            return False
        self._noted.add(kind)
        return True


def _addressed(frame: Frame, needed: Mapping[int, Collection[int]]) -> int | None:
    """The vehicle whose autopilot a request for a rate is addressed to; None if none that is watched is.

    A request to all systems (0) counts as one to the only vehicle; on a link of several it passes.
    """
    if frame.msgid not in GUARDED:
        return None
    system, component = (_field(frame, name) for name in _TARGETS)
    if component not in (Component.ALL, Component.AUTOPILOT1):
        return None
    if system == 0 and len(needed) == 1:
        return next(iter(needed))
    return system if isinstance(system, int) and system in needed else None


def _field(frame: Frame, name: str) -> object:
    """A field of a message; a text without its padding."""
    value = frame.fields[field_index(frame.msgid, name)]
    return value.partition(b"\0")[0].decode("latin-1") if isinstance(value, bytes) else value
