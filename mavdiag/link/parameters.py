"""The MAVLink parameter protocol (https://mavlink.io/en/services/parameter.html): telling own ones, reading others'.

PARAM_VALUE and PARAM_SET carry every value in a float field. PX4 puts the bytes of an integer there; all others cast
the integer to a float ("parameter encoding").
"""

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum, StrEnum
from typing import NamedTuple

from mavdiag.link.codec import AUTOPILOT, Argument, Frame
from mavdiag.link.messages import Autopilot, MessageId

ASKING = frozenset((MessageId.PARAM_REQUEST_READ, MessageId.PARAM_REQUEST_LIST, MessageId.PARAM_SET))
_FORMS = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}  # MAV_PARAM_TYPE, in the bytes of the float

_MOTORS = range(101, 113)  # of PX4's PWM_..._FUNCn
_DSHOT = -2  # and below, of PWM_..._TIMn; -1 is OneShot (PX4, pwm_out/module.yaml)


class Encoding(StrEnum):
    """How an integer travels in a float field."""

    CAST = "cast"  # its value: ArduPilot
    BYTES = "bytes"  # its four bytes: PX4
    FLOAT = "float"  # not at all: every parameter is a float


class Kind(IntEnum):
    """MAV_PARAM_TYPE, as far as used."""

    INT8 = 2
    INT16 = 4
    INT32 = 6
    REAL32 = 9


class Parameter(NamedTuple):
    """One parameter. span: the lowest and highest value that it may be set to; None if it cannot be set."""

    name: str
    value: float
    kind: Kind = Kind.REAL32
    span: tuple[float, float] | None = None


class Parameters:
    """The parameters of one component."""

    def __init__(self, rows: Sequence[Parameter], encoding: Encoding = Encoding.CAST) -> None:
        kind = {Encoding.BYTES: Kind.INT32, Encoding.FLOAT: Kind.REAL32}.get(encoding)
        self._bytewise, self._whole = encoding is Encoding.BYTES, {r.name for r in rows if r.kind is not Kind.REAL32}
        self._rows = {row.name: row._replace(kind=kind) if kind and row.name in self._whole else row for row in rows}

    def value(self, name: str, default: float = 0.0) -> float:
        """The value in force; the default for a name that there is not."""
        return self._rows[name].value if name in self._rows else default

    def change(self, name: str, value: float) -> bool:
        """Whether a value was taken: the name is known, can be set, and the value is within its span."""
        row = self._rows.get(name)
        if row is None or row.span is None or not row.span[0] <= value <= row.span[1]:
            return False
        self._rows[name] = row._replace(value=float(round(value)) if name in self._whole else value)
        return True

    def wanted(self, frame: Frame) -> tuple[str, float]:
        """Name and value of a PARAM_SET; NaN where the bytes of the value are of another type."""
        name, kind = frame.text("param_id"), frame.value("param_type")
        wrong = self._bytewise and name in self._rows and self._rows[name].kind != kind
        return name, math.nan if wrong else _sent(frame, bytewise=self._bytewise)

    def told(self, frame: Frame) -> list[tuple[Argument, ...]]:
        """The fields of each PARAM_VALUE that answers one of `ASKING`: values in force, none for an unknown name."""
        names = list(self._rows)
        if frame.msgid != MessageId.PARAM_REQUEST_LIST:
            index = frame.value("param_index") if frame.msgid == MessageId.PARAM_REQUEST_READ else -1
            asked = [frame.text("param_id")] if index < 0 else names[index : index + 1]
            names = [name for name in names if name in asked]
        return [self._fields(name) for name in names]

    def _fields(self, name: str) -> tuple[Argument, ...]:
        row, place = self._rows[name], list(self._rows).index(name)
        value = row.value
        if self._bytewise and row.kind is not Kind.REAL32:
            value = struct.unpack("<f", struct.pack("<i", round(value)))[0]
        return name, value, row.kind, len(self._rows), place


def _sent(frame: Frame, *, bytewise: bool) -> float:
    form = _FORMS.get(frame.value("param_type"), "<f") if bytewise else "<f"
    return float(struct.unpack_from(form, frame.payload)[0])  # param_value is first on the wire


def parameters_in(frames: Iterable[Frame], autopilot: int) -> dict[str, float]:
    """The latest value of each parameter in the frames of one vehicle's autopilot (MAV_AUTOPILOT), by name.

    Values that are not finite are left out.
    """
    told = (frame for frame in frames if frame.msgid == MessageId.PARAM_VALUE and frame.compid == AUTOPILOT)
    found = {frame.text("param_id"): _sent(frame, bytewise=autopilot == Autopilot.PX4) for frame in told}
    return {name: value for name, value in found.items() if name and math.isfinite(value)}


def drives_dshot(parameters: Mapping[str, float]) -> bool:
    """Whether PX4's parameters give motors to a group of outputs (PWM_MAIN, PWM_AUX) of which a timer has DShot."""
    groups = {name.partition("_TIM")[0] for name, value in parameters.items() if "_TIM" in name and value <= _DSHOT}
    motors = {name.partition("_FUNC")[0] for name, value in parameters.items() if value in _MOTORS and "_FUNC" in name}
    return not groups.isdisjoint(motors)
