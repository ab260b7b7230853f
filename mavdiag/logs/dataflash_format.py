"""The container of ArduPilot's DataFlash logs: from bytes to one table per message, by the file's own format records.

Every record is A3 95, a type byte and a body. Records of type 0x80 (FMT) give each type its length, its name, a format
of one character per field, and the fields' labels. The walk jumps from record to record. After damage it resumes at the
next A3 95 of a known type; a last record that is cut short is dropped. Records carry no checksum: a flipped bit in a
value is a wrong value.
"""

import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mavdiag.logs.records import as_floats, gather
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.units import NS_PER_MS, NS_PER_US

__all__ = ["INTEGERS", "Table", "read_tables"]

HEADER = b"\xa3\x95"
HEADER_BYTES = 3
FMT_TYPE = 0x80
FMT_BODY = struct.Struct("<BB4s16s64s")  # type, length, name, format, labels
FMT_BYTES = HEADER_BYTES + FMT_BODY.size

# Format characters (ArduPilot, AP_Logger/LogStructure.h): numpy layout, and what a stored unit is worth.
_LAYOUTS = {
    "a": "(32,)<i2", "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8",
    "f": "<f4", "d": "<f8", "g": "<f2", "n": "S4", "N": "S16", "Z": "S64", "M": "u1",
    "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4",
}  # fmt: skip
_MULTIPLIERS = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}
INTEGERS = "bBhHiIqQ"
_NUMBERS = INTEGERS + "fdgMcCeEL"  # the rest are texts and arrays
_TIMES = (("TimeUS", NS_PER_US), ("TimeMS", NS_PER_MS))  # label, nanoseconds
_INSTANCES = ("I", "IMU", "Inst", "Instance")


@dataclass(frozen=True, slots=True)
class _Format:
    """One message type.

    length: of a record, with its header.
    name: of the message.
    characters: one per field.
    labels: one per field.
    layout: None where the characters do not add up to the length: such records are stepped over, not read.
    """

    length: int
    name: str
    characters: str
    labels: tuple[str, ...]
    layout: np.dtype[np.void] | None


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """All records of one type.

    format: what its FMT record says.
    starts: (n,) their places in the file.
    records: (n,), fields f0, f1, … by label.
    """

    format: _Format
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


@dataclass(slots=True)
class _Walk:
    """What the walk has learnt so far.

    wanted: names of the messages to gather.
    formats: by type.
    lengths: by type, 0 for unknown.
    starts: by type, of the wanted types only.
    """

    wanted: Collection[str]
    formats: dict[int, _Format] = field(default_factory=dict)
    lengths: list[int] = field(default_factory=lambda: [FMT_BYTES if kind == FMT_TYPE else 0 for kind in range(256)])
    starts: dict[int, list[int]] = field(default_factory=dict)

    def learn(self, data: bytes, position: int) -> None:
        """Take in the format record at `position`. A type keeps its first sound definition: a later one is damage."""
        kind, length, name, characters, labels = FMT_BODY.unpack_from(data, position + HEADER_BYTES)
        known = self.formats.get(kind)
        if kind == FMT_TYPE or length < HEADER_BYTES or (known is not None and known.layout is not None):
            return
        found = _format(length, _text(name), _text(characters), _text(labels))
        self.formats[kind] = found
        self.lengths[kind] = length
        if found.name in self.wanted and found.layout is not None:
            self.starts[kind] = []


def read_tables(data: bytes, wanted: Collection[str]) -> tuple[Mapping[str, Table], tuple[str, ...]]:
    """Walk the file once and gather the wanted messages by name; absent ones are left out. Never raises on content.

    Of a message that comes from several instances of a sensor, only the first instance is kept. Returns what is wrong
    with the file, too, one sentence each.
    """
    walk = _Walk(wanted)
    lengths, starts = walk.lengths, walk.starts
    position, sound_end = data.find(HEADER), 0
    while 0 <= position <= len(data) - HEADER_BYTES:
        kind = data[position + 2]
        length = lengths[kind]
        if position + length > len(data):
            break
        sound_end = position + length if length else sound_end
        if kind == FMT_TYPE:
            walk.learn(data, position)
        elif kind in starts:
            starts[kind].append(position)
        position = data.find(HEADER, position + (length or 1))
    found: dict[str, Table] = {}
    for kind, at in starts.items():
        form = walk.formats[kind]
        if at and form.layout is not None and form.name not in found:
            found[form.name] = _first_instance(Table(form, np.asarray(at), gather(data, form.layout, at)))
    return found, _notes(data[sound_end:])


def _notes(rest: bytes) -> tuple[str, ...]:
    """What the bytes behind the last whole record mean; padding means nothing."""
    if not rest.strip(b"\0\xff"):
        return ()
    return (f"it ends within a record, {len(rest)} bytes are lost: the recording was cut off",)


def _format(length: int, name: str, characters: str, labels: str) -> _Format:
    """A message type as its FMT record declares it."""
    names = tuple(labels.split(","))
    layout = None
    if len(names) == len(characters) and all(c in _LAYOUTS for c in characters):
        header = [("header", f"V{HEADER_BYTES}")]
        fields = np.dtype(header + [(f"f{i}", _LAYOUTS[c]) for i, c in enumerate(characters)])
        layout = fields if fields.itemsize == length else None
    return _Format(length, name, characters, names, layout)


def _text(raw: bytes) -> str:
    """Text up to the first NUL."""
    return raw.partition(b"\0")[0].decode("latin-1")


def _first_instance(table: Table) -> Table:
    """Only the records of the lowest instance, for messages that carry the instance as a field."""
    label = next((name for name in _INSTANCES if table.has((name,), INTEGERS)), None)
    if label is None:
        return table
    instance = table.raw(label)
    first = instance == instance.min()
    return Table(table.format, table.starts[first], table.records[first])
