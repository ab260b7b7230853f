"""The detector as a MAVLink component, 191 of the vehicle's system: what it sends, its version and its parameters.

Parameters follow the MAVLink parameter protocol (PARAM_...), all REAL32; the answer is always the value in force. They
are not kept over a restart: the settings are in force again. No clock, no socket.
"""

from detector.session import Session
from detector.states import State
from detector.values import AskParameters, Effect, Note, SendCommand, SendFloat, SendText
from mavdiag import __version__
from mavdiag.link.clock import TimesyncMessage
from mavdiag.link.codec import Frame
from mavdiag.link.messages import MavResult, MessageId
from mavdiag.link.parameters import Parameter, Parameters
from mavdiag.link.vehicles import Command
from mavdiag.link.wants import Companion
from mavdiag.units import NS_PER_MS

# MAV_PROTOCOL_CAPABILITY: MAVLINK2, PARAM_FLOAT, PARAM_ENCODE_C_CAST
CAPABILITIES = 1 << 13 | 1 << 1 | 1 << 17
VENDOR, MODEL = "mavdiag", "propeller fault detector"
SCALE, TEXTS, ACK = PARAMETERS = "PROP_SCALE", "PROP_TEXTS", "PROP_ACK"
_MS_TURN = 1 << 32

# MAV_STATE in the heartbeat: 2 calibrating, 3 standby, 4 active; a faulted session has none, because it sends none.
HEALTH = {State.WAITING: 3, State.LEARNING: 2, State.FITTING: 2, State.MONITORING: 4, State.LOST: 3}


class Sender(Companion):
    """Encodes for one vehicle, with its own sequence numbers."""

    def beat(self, state: State) -> bytes:
        """HEARTBEAT of a session that works. Raises KeyError for a faulted one: it must send none."""
        return self.heartbeat(HEALTH[state])

    def answer(self, command: Command, result: MavResult) -> bytes:
        """COMMAND_ACK to who sent a command."""
        return self.encode(MessageId.COMMAND_ACK, command.command, result, 0, 0, command.sysid, command.compid)

    def version(self, msgid: int) -> bytes | None:
        """AUTOPILOT_VERSION or COMPONENT_INFORMATION_BASIC; None for another message."""
        if msgid == MessageId.AUTOPILOT_VERSION:
            major, minor, patch = (int(part) for part in __version__.split(".")[:3])
            number, none = major << 24 | minor << 16 | patch << 8, (0,) * 8
            return self.encode(msgid, CAPABILITIES, number, number, 0, 0, none, none, none, 0, 0, 0)
        if msgid == MessageId.COMPONENT_INFORMATION_BASIC:
            return self.encode(msgid, CAPABILITIES, 0, 0, VENDOR, MODEL, __version__, "", "")
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
        return "the vehicle is armed" if session.armed else session.tune(threshold_scale=value)
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
