"""What the detector is to a ground station: a component with a version and a few parameters. No clock, no socket.

Parameters follow the MAVLink parameter protocol (PARAM_...), all REAL32; the answer is always the value in force. They
are not kept over a restart: the settings are in force again.
"""

from collections.abc import Callable, Mapping

from detector.sender import MavlinkSender
from detector.session import Session
from detector.values import Effect, Note
from mavdiag import __version__
from mavdiag.link.codec import Frame
from mavdiag.link.messages import MessageId
from mavdiag.link.parameters import Parameter, Parameters

# MAV_PROTOCOL_CAPABILITY: MAVLINK2, PARAM_FLOAT, PARAM_ENCODE_C_CAST
CAPABILITIES = 1 << 13 | 1 << 1 | 1 << 17
VENDOR, MODEL = "mavdiag", "propeller fault detector"


SCALE, TEXTS, ACK = "PROP_SCALE", "PROP_TEXTS", "PROP_ACK"


def _scale(session: Session, value: float, whose: str) -> tuple[Effect, ...] | str:
    return "the vehicle is armed" if session.armed else session.tune(threshold_scale=value)


def _acknowledge(session: Session, value: float, whose: str) -> tuple[Effect, ...] | str:
    return session.acknowledge(whose) if value >= 0.5 and session.acknowledgeable else "nothing is to be acknowledged"


#: What is done with a value within its limits, and who sets it; why not, if it is refused.
CHANGES: Mapping[str, Callable[[Session, float, str], tuple[Effect, ...] | str]] = {
    SCALE: _scale,
    TEXTS: lambda session, value, whose: session.tune(texts_per_minute=round(value)),
    ACK: _acknowledge,
}


def parameters(session: Session) -> Parameters:
    """Scale of all thresholds; STATUSTEXTs a minute; 1 acknowledges, as MAV_CMD_USER_1 does, and reads as 0."""
    scale = Parameter(SCALE, session.settings.threshold_scale, span=(0.5, 4.0))
    texts = Parameter(TEXTS, session.settings.texts_per_minute, span=(4.0, 120.0))
    return Parameters((scale, texts, Parameter(ACK, 0.0, span=(0.0, 1.0))))


def version_frame(sender: MavlinkSender, msgid: int) -> bytes | None:
    """AUTOPILOT_VERSION or COMPONENT_INFORMATION_BASIC; None for another message."""
    if msgid == MessageId.AUTOPILOT_VERSION:
        major, minor, patch = (int(part) for part in __version__.split(".")[:3])
        number, none = major << 24 | minor << 16 | patch << 8, (0,) * 8
        return sender.frame(msgid, CAPABILITIES, number, number, 0, 0, none, none, none, 0, 0, 0)
    if msgid == MessageId.COMPONENT_INFORMATION_BASIC:
        return sender.frame(msgid, CAPABILITIES, 0, 0, VENDOR, MODEL, __version__, "", "")
    return None


def answer(
    frame: Frame, session: Session, sender: MavlinkSender, *, trusted: bool
) -> tuple[list[bytes], tuple[Effect, ...]]:
    """The answer to a message of the parameter protocol, and what comes of it: who is not trusted changes nothing."""
    table, effects = parameters(session), tuple[Effect, ...]()
    if trusted and frame.msgid == MessageId.PARAM_SET:
        (name, value), whose = table.wanted(frame), f"{frame.sysid}/{frame.compid}"
        if name not in CHANGES:
            return [], ()
        done: tuple[Effect, ...] | str = "it is beyond its limits"
        if table.change(name, value):
            done = CHANGES[name](session, value, whose)
        if isinstance(done, str):
            effects = (Note(f"{name} = {value:g} of {whose}: refused, {done}"),)
        else:
            effects = (Note(f"{name} = {value:g} by {whose}"), *done)
        if isinstance(done, str) or name != ACK:
            table = parameters(session)
    return [sender.frame(MessageId.PARAM_VALUE, *fields) for fields in table.told(frame)], effects
