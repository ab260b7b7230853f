"""A few settings of the detector as MAVLink parameters of its own component (191). No clock, no socket.

Two can be set; the others are figures to read. A value that is refused is answered with the value in force, as the
parameter protocol has it. Nothing here is ever sent to the autopilot.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import isfinite

from detector.config import SessionSettings
from detector.fleet import VehicleFigures
from detector.states import State
from mavdiag.decision.diagnosis import Stage
from mavdiag.link.codec import Frame, field_index
from mavdiag.link.messages import MessageId

__all__ = ["PARAMETERS", "REAL32", "Answer", "OwnParameter", "View", "answer"]

REAL32 = 9  # MAV_PARAM_TYPE_REAL32: all of them are floats

_READ_NAME, _READ_INDEX = (field_index(MessageId.PARAM_REQUEST_READ, name) for name in ("param_id", "param_index"))
_SET_NAME, _SET_VALUE = (field_index(MessageId.PARAM_SET, name) for name in ("param_id", "param_value"))


@dataclass(frozen=True, slots=True)
class View:
    """What the parameters of one vehicle's session show.

    settings: of the session.
    learning: whether it has no baseline yet.
    figures: where it stands.
    """

    settings: SessionSettings
    learning: bool
    figures: VehicleFigures


@dataclass(frozen=True, slots=True)
class OwnParameter:
    """One parameter.

    name: at most 16 bytes.
    value: what it is now.
    span: what it may be set to; None if it is only read.
    """

    name: str
    value: Callable[[View], float] = field(repr=False)
    span: tuple[float, float] | None = None

    def allows(self, value: float) -> bool:
        """Whether it may be set to a value."""
        return self.span is not None and isfinite(value) and self.span[0] <= value <= self.span[1]


PARAMETERS = (
    OwnParameter("MD_LEARN_S", lambda view: (view.settings.learn or 0.0) if view.learning else 0.0, (0.0, 3600.0)),
    OwnParameter("MD_THR_SCALE", lambda view: view.settings.threshold_scale, (0.5, 4.0)),
    OwnParameter("MD_STATE", lambda view: float(list(State).index(view.figures.state))),
    OwnParameter("MD_VERDICT", lambda view: float(list(Stage).index(view.figures.diagnosis.stage))),
    OwnParameter("MD_ROTOR", lambda view: float(view.figures.diagnosis.rotor or 0)),
    OwnParameter("MD_GYRO_HZ", lambda view: view.figures.gyro_hz),
    OwnParameter("MD_JUDGED_S", lambda view: view.figures.judged_s),
    OwnParameter("MD_ALARMS", lambda view: float(view.figures.events)),
    OwnParameter("MD_LOST", lambda view: float(view.figures.lost)),
)
_BY_NAME: Mapping[str, OwnParameter] = {one.name: one for one in PARAMETERS}


@dataclass(frozen=True, slots=True)
class Answer:
    """What a request leads to.

    show: the parameters to send, with their values as they are after the change.
    change: a parameter that is to be set, and its value; None for none.
    refused: why a change is refused, one line; empty if none was asked or it is granted.
    """

    show: tuple[OwnParameter, ...] = ()
    change: tuple[OwnParameter, float] | None = None
    refused: str = ""


def answer(frame: Frame) -> Answer:
    """What a request leads to (`mavdiag.link.vehicles`). One for a parameter that is not there gets no answer."""
    fields = frame.fields
    if frame.msgid == MessageId.PARAM_REQUEST_LIST:
        return Answer(PARAMETERS)
    if frame.msgid == MessageId.PARAM_REQUEST_READ:
        number = fields[_READ_INDEX]
        by_index = PARAMETERS[number] if isinstance(number, int) and 0 <= number < len(PARAMETERS) else None
        found = _BY_NAME.get(_text(fields[_READ_NAME])) if number == -1 else by_index
        return Answer((found,)) if found else Answer()
    found, value = _BY_NAME.get(_text(fields[_SET_NAME])), fields[_SET_VALUE]
    if found is None or not isinstance(value, float):
        return Answer()
    if found.allows(value):
        return Answer((found,), (found, value))
    limits = "it can only be read" if found.span is None else f"it may be {found.span[0]:g} to {found.span[1]:g}"
    return Answer((found,), refused=f"{found.name} {value:g} refused: {limits}")


def _text(raw: object) -> str:
    return raw.partition(b"\0")[0].decode("latin-1") if isinstance(raw, bytes) else ""
