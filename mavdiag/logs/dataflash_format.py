"""Message types of ArduPilot's DataFlash logs, and the table of one type's records.

Every record is A3 95, a type byte and a body. Records of type 0x80 (FMT) give each type its length, its name, a format
of one character per field, and the fields' labels. `mavdiag.logs.dataflash_walk` finds the records.
"""

import struct
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavdiag.logs.records import as_floats
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.units import NS_PER_MS, NS_PER_US

__all__ = [
    "FMT_BYTES",
    "FMT_TYPE",
    "HEADER",
    "HEADER_BYTES",
    "INTEGERS",
    "MAX_RECORD",
    "Format",
    "Table",
    "declared",
    "first_instance",
]

HEADER = b"\xa3\x95"
HEADER_BYTES = 3
MAX_RECORD = 255  # the length of a record is a byte
FMT_TYPE = 0x80
FMT_BODY = struct.Struct("<BB4s16s64s")  # type, length, name, format, labels
FMT_BYTES = HEADER_BYTES + FMT_BODY.size

# Format characters (ArduPilot, AP_Logger/LogStructure.h): numpy layout, and what a stored unit is worth.
_LAYOUTS = {
    "a": "(32,)<i2", "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8",
    "f": "<f4", "d": "<f8", "g": "<f2", "n": "S4", "N": "S16", "Z": "S64", "M": "u1",
    "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4",
}  # fmt: skip
_SIZES = {character: np.dtype(layout).itemsize for character, layout in _LAYOUTS.items()}
_MULTIPLIERS = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}
INTEGERS = "bBhHiIqQ"
_NUMBERS = INTEGERS + "fdgMcCeEL"  # the rest are texts and arrays
_TIMES = (("TimeUS", NS_PER_US), ("TimeMS", NS_PER_MS))  # label, nanoseconds
_INSTANCES = ("I", "IMU", "Inst", "Instance")


@dataclass(frozen=True, slots=True)
class Format:
    """One message type.

    length: of a record, with its header.
    name: of the message.
    characters: one per field.
    labels: one per field.
    sound: whether the characters add up to the length. Records of a type that is not are stepped over, not read.
    """

    length: int
    name: str
    characters: str
    labels: tuple[str, ...]
    sound: bool

    def layout(self) -> np.dtype[np.void]:
        """A record as numpy has it, fields f0, f1, … by label. Only of a sound type."""
        fields = [(f"f{i}", _LAYOUTS[c]) for i, c in enumerate(self.characters)]
        return np.dtype([("header", f"V{HEADER_BYTES}"), *fields])


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """All records of one type.

    format: what its FMT record says.
    starts: (n,) their places in the file.
    records: (n,), fields f0, f1, … by label.
    """

    format: Format
    starts: IntArray
    records: NDArray[np.void]

    def has(self, labels: Collection[str], characters: str = _NUMBERS) -> bool:
        """Whether all these fields are there, and of these formats: damage can turn a number into a text."""
        kinds = dict(zip(self.format.labels, self.format.characters, strict=True))
        return all(label in kinds and kinds[label] in characters for label in labels)

    def raw(self, label: str) -> NDArray[np.generic]:
        """The stored values of a field."""
        return self.records[f"f{self.format.labels.index(label)}"]

    def column(self, label: str, integer_unit: float = 1.0) -> FloatArray:
        """A field as numbers, (n,), by its character's multiplier; a plain integer counts in `integer_unit`."""
        character = self.format.characters[self.format.labels.index(label)]
        unit = integer_unit if character in INTEGERS else _MULTIPLIERS.get(character, 1.0)
        return as_floats(self.raw(label)) * unit

    def columns(self, labels: Collection[str], integer_unit: float = 1.0) -> FloatArray:
        """Several fields, (n, len(labels))."""
        return np.column_stack([self.column(label, integer_unit) for label in labels])

    def t_ns(self) -> IntArray | None:
        """Time since boot of each record, (n,); None if the type carries no time."""
        for label, unit_ns in _TIMES:
            if self.has((label,), INTEGERS):
                return self.raw(label).astype(np.int64) * unit_ns
        return None


def declared(data: bytes, position: int) -> tuple[int, Format]:
    """The type that the FMT record at this place declares, and how it is laid out. The record must be whole."""
    kind, length, name, characters, labels = FMT_BODY.unpack_from(data, position + HEADER_BYTES)
    fields, names = _text(characters), tuple(_text(labels).split(","))
    needed = HEADER_BYTES + sum([_SIZES.get(character, MAX_RECORD) for character in fields])  # too much if unknown
    return kind, Format(length, _text(name), fields, names, needed == length and len(names) == len(fields))


def _text(raw: bytes) -> str:
    """Text up to the first NUL."""
    return raw.partition(b"\0")[0].decode("latin-1")


def first_instance(table: Table) -> Table:
    """Only the records of the lowest instance, for messages that carry the instance as a field."""
    label = next((name for name in _INSTANCES if table.has((name,), INTEGERS)), None)
    if label is None:
        return table
    instance = table.raw(label)
    first = instance == instance.min()
    if first.all():
        return table
    whole = table.records.view(f"V{table.records.itemsize}")  # copied in one piece each, not field by field
    return Table(table.format, table.starts[first], whole[first].view(table.records.dtype))
