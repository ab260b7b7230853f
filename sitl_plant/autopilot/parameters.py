"""The parameters of the emulated autopilot and their protocol: list, read, set (MAVLink parameter protocol).

A set is checked against type and range. The answer is always the value in force, so a client sees whether it was taken.
PARAM_VALUE carries every value in a float field: PX4 puts the bytes of an integer there, ArduPilot its value.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum

from mavdiag.link.codec import Frame
from mavdiag.link.messages import MessageId
from sitl_plant.autopilot.wire import Action, Reply, number, text


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


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter. span: the lowest and highest value that it may be set to; None if it cannot be set."""

    name: str
    value: float
    kind: Kind = Kind.REAL32
    span: tuple[float, float] | None = None


class Parameters:
    """The parameters of one vehicle."""

    def __init__(self, rows: Sequence[Parameter], encoding: Encoding = Encoding.CAST) -> None:
        kind = {Encoding.BYTES: Kind.INT32, Encoding.FLOAT: Kind.REAL32}.get(encoding)
        self._bytewise = encoding is Encoding.BYTES
        self._rows = tuple(replace(row, kind=kind) if kind and row.kind is not Kind.REAL32 else row for row in rows)
        self._given = tuple(rows)
        self._index = {row.name: index for index, row in enumerate(rows)}
        self._values = [row.value for row in rows]

    def value(self, name: str, default: float = 0.0) -> float:
        """The value in force; the default for a name that there is not."""
        return self._values[self._index[name]] if name in self._index else default

    def change(self, name: str, value: float) -> bool:
        """Whether a value was taken: the name is known, can be set, and the value is within its span."""
        span = self._rows[self._index[name]].span if name in self._index else None
        if span is None or not span[0] <= value <= span[1]:
            return False
        whole = self._given[self._index[name]].kind is not Kind.REAL32
        self._values[self._index[name]] = float(round(value)) if whole else value
        return True

    def all(self, link: int) -> list[Action]:
        """The answer to PARAM_REQUEST_LIST."""
        return [self._reply(link, index) for index in range(len(self._rows))]

    def read(self, link: int, frame: Frame) -> list[Action]:
        """The answer to PARAM_REQUEST_READ, by index or by name; nothing for an unknown one."""
        index = int(number(frame, "param_index"))
        if index < 0:
            index = self._index.get(text(frame, "param_id"), -1)
        return [self._reply(link, index)] if 0 <= index < len(self._rows) else []

    def set(self, link: int, frame: Frame) -> list[Action]:
        """The answer to PARAM_SET: the value in force; nothing for an unknown name."""
        name = text(frame, "param_id")
        if name not in self._index:
            return []
        row, asked = self._rows[self._index[name]], int(number(frame, "param_type"))
        if not self._bytewise or asked == row.kind:
            self.change(name, self._decoded(frame, row.kind))
        return [self._reply(link, self._index[name])]

    def _decoded(self, frame: Frame, kind: Kind) -> float:
        if self._bytewise and kind is not Kind.REAL32:
            (held,) = struct.unpack_from("<i", frame.payload)  # param_value is first on the wire
            return float(held)
        return number(frame, "param_value")

    def _reply(self, link: int, index: int) -> Reply:
        row, value = self._rows[index], self._values[index]
        if self._bytewise and row.kind is not Kind.REAL32:
            value = struct.unpack("<f", struct.pack("<i", round(value)))[0]
        return Reply(link, MessageId.PARAM_VALUE, (row.name, value, row.kind, len(self._rows), index))
