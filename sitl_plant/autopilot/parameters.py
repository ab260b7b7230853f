"""The parameters of the emulated autopilot and their protocol: list, read, set (MAVLink parameter protocol).

A set is checked against type and range. The answer is always the value in force, so a client sees whether it was taken.
PARAM_VALUE carries every value in a float field: PX4 puts the bytes of an integer there, ArduPilot its value.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from mavdiag.link.codec import Frame
from mavdiag.link.messages import MessageId
from sitl_plant.autopilot.wire import Action, Reply, number, text

__all__ = ["Kind", "Parameter", "Parameters"]


class Kind(IntEnum):
    """MAV_PARAM_TYPE, as far as used."""

    UINT8 = 1
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
    """The parameters of one vehicle. bytewise: an integer travels as its bytes, as with PX4."""

    def __init__(self, rows: Sequence[Parameter], bytewise: bool = False) -> None:
        self._rows = tuple(rows)
        self._bytewise = bytewise
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
        whole = self._rows[self._index[name]].kind is not Kind.REAL32
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
            self.change(name, self._decoded(number(frame, "param_value"), frame, row.kind))
        return [self._reply(link, self._index[name])]

    def _decoded(self, value: float, frame: Frame, kind: Kind) -> float:
        if self._bytewise and kind is not Kind.REAL32:
            (held,) = struct.unpack_from(_LAYOUTS[kind], frame.payload)  # param_value is first on the wire
            return float(held)
        return value

    def _reply(self, link: int, index: int) -> Reply:
        row, value = self._rows[index], self._values[index]
        if self._bytewise and row.kind is not Kind.REAL32:
            value = struct.unpack("<f", struct.pack(_LAYOUTS[row.kind], round(value)).ljust(4, b"\0"))[0]
        return Reply(link, MessageId.PARAM_VALUE, (row.name, value, row.kind, len(self._rows), index))


_LAYOUTS = {Kind.UINT8: "<B", Kind.INT8: "<b", Kind.INT16: "<h", Kind.INT32: "<i"}
