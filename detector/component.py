"""What the detector is to a ground station: a component with a version and a few parameters. No clock, no socket.

Parameters follow the MAVLink parameter protocol (PARAM_...), all REAL32; the answer is always the value in force. They
are not kept over a restart: the settings are in force again.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from detector.sender import MavlinkSender
from detector.session import Session
from detector.values import Effect, Note
from mavdiag import __version__
from mavdiag.link.codec import Frame, field_index
from mavdiag.link.messages import MessageId

REAL32 = 9  # MAV_PARAM_TYPE
# MAV_PROTOCOL_CAPABILITY: MAVLINK2, PARAM_FLOAT, PARAM_ENCODE_C_CAST
CAPABILITIES = 1 << 13 | 1 << 1 | 1 << 17
VENDOR, MODEL = "mavdiag", "propeller fault detector"


@dataclass(frozen=True, slots=True)
class Parameter:
    """One of them. change: what is done with a value within its limits, and who sets it; why not, if it is refused."""

    least: float
    most: float
    value: Callable[[Session], float]
    change: Callable[[Session, float, str], tuple[Effect, ...] | str]


def _acknowledge(session: Session, value: float, whose: str) -> tuple[Effect, ...] | str:
    return session.acknowledge(whose) if value >= 0.5 and session.acknowledgeable else "nothing is to be acknowledged"


#: Scale of all thresholds; STATUSTEXTs a minute; 1 acknowledges, as MAV_CMD_USER_1 does, and reads as 0.
PARAMETERS: Mapping[str, Parameter] = {
    "PROP_SCALE": Parameter(
        *(0.5, 4.0, lambda session: session.settings.threshold_scale),
        lambda session, value, _: "the vehicle is armed" if session.armed else session.tune(threshold_scale=value),
    ),
    "PROP_TEXTS": Parameter(
        *(4.0, 120.0, lambda session: session.settings.texts_per_minute),
        lambda session, value, _: session.tune(texts_per_minute=round(value)),
    ),
    "PROP_ACK": Parameter(0.0, 1.0, lambda session: 0.0, _acknowledge),
}


def version_frame(sender: MavlinkSender, msgid: int) -> bytes | None:
    """AUTOPILOT_VERSION or COMPONENT_INFORMATION_BASIC; None for another message."""
    if msgid == MessageId.AUTOPILOT_VERSION:
        major, minor, patch = (int(part) for part in __version__.split(".")[:3])
        number, none = major << 24 | minor << 16 | patch << 8, (0,) * 8
        return sender.frame(msgid, CAPABILITIES, number, number, 0, 0, none, none, none, 0, 0, 0)
    if msgid == MessageId.COMPONENT_INFORMATION_BASIC:
        return sender.frame(msgid, CAPABILITIES, 0, 0, VENDOR, MODEL, __version__, "", "")
    return None


def read(frame: Frame, session: Session, sender: MavlinkSender) -> list[bytes]:
    """The answer to PARAM_REQUEST_LIST and PARAM_REQUEST_READ, by index or by name; nothing for an unknown one.

    To a PARAM_SET of somebody who is not trusted it is the same: the value in force.
    """
    if frame.msgid == MessageId.PARAM_REQUEST_LIST:
        return [_told(name, session, sender) for name in PARAMETERS]
    index = int(_field(frame, "param_index")) if frame.msgid == MessageId.PARAM_REQUEST_READ else -1
    names = [frame.text("param_id")] if index < 0 else list(PARAMETERS)[index : index + 1]
    return [_told(name, session, sender) for name in names if name in PARAMETERS]


def change(frame: Frame, session: Session, sender: MavlinkSender) -> tuple[list[bytes], tuple[Effect, ...]]:
    """The answer to PARAM_SET of somebody who is trusted, and what comes of it; nothing for an unknown name."""
    name, value, whose = frame.text("param_id"), float(_field(frame, "param_value")), f"{frame.sysid}/{frame.compid}"
    if name not in PARAMETERS:
        return [], ()
    parameter = PARAMETERS[name]
    done: tuple[Effect, ...] | str = f"it must be {parameter.least:g} to {parameter.most:g}"
    if int(_field(frame, "param_type")) != REAL32:
        done = "it is no REAL32"
    elif math.isfinite(value) and parameter.least <= value <= parameter.most:
        done = parameter.change(session, value, whose)
    if isinstance(done, str):
        return [_told(name, session, sender)], (Note(f"{name} = {value:g} of {whose}: refused, {done}"),)
    taken = value if name == "PROP_ACK" else None
    return [_told(name, session, sender, taken)], (Note(f"{name} = {value:g} by {whose}"), *done)


def _told(name: str, session: Session, sender: MavlinkSender, value: float | None = None) -> bytes:
    value = PARAMETERS[name].value(session) if value is None else value
    place = list(PARAMETERS).index(name)
    return sender.frame(MessageId.PARAM_VALUE, name, value, REAL32, len(PARAMETERS), place)


def _field(frame: Frame, name: str) -> float:
    value = frame.fields[field_index(frame.msgid, name)]
    return value if isinstance(value, int | float) else math.nan
