"""From the bytes of an ArduPilot DataFlash log to one table per message.

Every record is A3 95, a type byte and a body. Records of type 0x80 (FMT) give each type its length, its name, a format
of one character per field, and the fields' labels; a type keeps its first sound definition, for a later one is damage.
The type's length tells where the next record begins. After damage the chain resumes at the next A3 95 of a known type;
a last record that is cut short is dropped. Records carry no checksum: a flipped bit in a value is a wrong value.
"""

import struct
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdiag.jit import cached
from mavdiag.logs.log import Table, gather
from mavdiag.telemetry import BoolArray, IntArray
from mavdiag.units import NS_PER_MS, NS_PER_US

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
_SIZES = {character: np.dtype(layout).itemsize for character, layout in _LAYOUTS.items()}
_MULTIPLIERS = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}
_TIMES = {"TimeUS": NS_PER_US, "TimeMS": NS_PER_MS}
_INSTANCES = ("I", "IMU", "Inst", "Instance")


class Format(NamedTuple):
    """One message type: length of a record with its header, name, and a character and a label for each field."""

    length: int
    name: str
    characters: str
    labels: tuple[str, ...]

    @property
    def sound(self) -> bool:
        """Whether the characters add up to the length. Records of a type that is not are stepped over, not read."""
        sizes = [_SIZES.get(character, 256) for character in self.characters]  # too much if unknown
        return HEADER_BYTES + sum(sizes) == self.length and len(self.labels) == len(self.characters)

    def layout(self) -> np.dtype[np.void]:
        """A record as numpy has it, fields f0, f1, … by label. Only of a sound type."""
        fields = [(f"f{i}", _LAYOUTS[character]) for i, character in enumerate(self.characters)]
        return np.dtype([("header", f"V{HEADER_BYTES}"), *fields])


def table_of(form: Format, starts: IntArray, records: NDArray[np.void]) -> Table:
    """The records of one type; of those that carry the instance of a sensor, only those of the lowest one."""
    fields = {label: records[f"f{place}"] for place, label in enumerate(form.labels)}
    units = {label: _MULTIPLIERS.get(c) for label, c in zip(form.labels, form.characters, strict=True)}
    table = Table(form.name, None, fields, {label: unit for label, unit in units.items() if unit}, starts)
    instance = next((found for found in map(table.integers, _INSTANCES) if found is not None), None)
    if instance is not None and (instance != instance.min()).any():
        first = instance == instance.min()
        whole = records.view(f"V{records.itemsize}")  # copied in one piece each, not field by field
        return table_of(form, starts[first], whole[first].view(records.dtype))
    stamps = ((table.integers(label), unit_ns) for label, unit_ns in _TIMES.items())
    return replace(table, t_ns=next((stamp * unit_ns for stamp, unit_ns in stamps if stamp is not None), None))


def declared(data: bytes, position: int) -> tuple[int, Format]:
    """The type that the FMT record at this place declares, and how it is laid out. The record must be whole."""
    kind, length, *texts = FMT_BODY.unpack_from(data, position + HEADER_BYTES)
    name, characters, labels = (raw.partition(b"\0")[0].decode("latin-1") for raw in texts)
    return kind, Format(length, name, characters, tuple(labels.split(",")))


class Walk:
    """The records of the wanted messages, taken from a file that is fed piece by piece. wanted: their names."""

    def __init__(self, wanted: Collection[str]) -> None:
        self._wanted = wanted
        self._formats: dict[int, Format] = {}
        self._lengths = np.zeros(256, np.int64)  # by type; 0 for unknown
        self._lengths[FMT_TYPE] = FMT_BYTES
        self._taken = np.zeros(256, np.bool_)  # whether records of a type are gathered
        # Places in the file (int64) and records, by type, in the order of their declaration. As bytes, for arrays that
        # grow would be held twice.
        self._gathered: dict[int, tuple[bytearray, bytearray]] = {}
        self._base = 0  # place in the file where the present piece starts
        self._carry = b""  # the end of the last piece, where a record may have begun
        self._sound_end = 0  # place in the file behind the last whole record of a known type
        self._sound = 0  # bytes in such records so far
        self._lost = False  # whether anything but padding was behind it

    def feed(self, data: bytes) -> None:
        """Take in the next piece of the file. Never raises on content."""
        data = self._carry + data
        octets, found = np.frombuffer(data, np.uint8), np.empty(len(data) // HEADER_BYTES + 1, np.int64)
        position = count = sound_end = 0
        while True:
            at = _follow(octets, position, self._lengths, self._taken, found[count:])
            position, more, end, sound = at.tolist()
            count, sound_end, self._sound = count + more, max(sound_end, end), self._sound + sound
            if position >= 0:
                break
            position = -position  # behind a declaration
            self._learn(data, position - FMT_BYTES)
        self._gather(data, octets, found[:count])
        self._lost = bool(data[sound_end:].strip(b"\0\xff")) or (self._lost and not sound_end)
        self._sound_end = self._base + sound_end if sound_end else self._sound_end
        self._carry = data[position:]
        self._base += position

    def finish(self) -> tuple[Mapping[str, Table], tuple[str, ...]]:
        """The tables by name, absent messages left out, and what is wrong with the file, one sentence each.

        Of a message that comes from several instances of a sensor, only the first instance is kept; of two types with
        the same name, the one that was declared first and has records.
        """
        found: dict[str, Table] = {}
        for kind, (starts, records) in self._gathered.items():
            form = self._formats[kind]
            if starts and form.name not in found:
                stored = np.frombuffer(records, form.layout())
                found[form.name] = table_of(form, np.frombuffer(starts, np.int64), stored)
        lost = self._base + len(self._carry) - self._sound_end
        cut = f"it ends within a record, {lost} bytes are lost: the recording was cut off"
        between = self._sound_end - self._sound
        damaged = f"{between} bytes of it are no records of a known type and were skipped"
        return found, tuple(note for note, told in ((damaged, between), (cut, self._lost)) if told)

    def _learn(self, data: bytes, position: int) -> None:
        """Take in the FMT record at `position`."""
        kind, form = declared(data, position)
        known = self._formats.get(kind)
        if kind == FMT_TYPE or form.length < HEADER_BYTES or (known is not None and known.sound):
            return
        self._formats[kind], self._lengths[kind] = form, form.length
        if form.name in self._wanted and form.sound:
            self._taken[kind] = True
            self._gathered[kind] = bytearray(), bytearray()

    def _gather(self, data: bytes, octets: NDArray[np.uint8], places: IntArray) -> None:
        """Copy the records that were found in a piece out of it."""
        kinds = octets[places + 2]
        for kind, (starts, records) in self._gathered.items():
            at = places[kinds == kind]
            if len(at):
                starts += (at + self._base).data
                records += gather(data, self._formats[kind].layout(), at).view(np.uint8).data


@cached
def _follow(data: NDArray[np.uint8], position: int, lengths: IntArray, taken: BoolArray, found: IntArray) -> IntArray:
    """Follow the chain of records from a place on, up to a declaration or to where a record may go on behind the data.

    found: gets the places of the records that are taken. Returns (4,): where to go on, negative behind a declaration;
    how many were found; behind the last whole record of a known type, or 0; bytes in such records.
    """
    count, end, sound, size = 0, 0, 0, len(data)
    while position <= size - 3:
        if data[position] != 0xA3 or data[position + 1] != 0x95:
            position += 1
            continue
        kind = data[position + 2]
        length = lengths[kind]
        if position + length > size:
            break
        if length == 0:
            position += 1
            continue
        if taken[kind]:
            found[count] = position
            count += 1
        position += length
        sound += length
        end = position
        if kind == 0x80:
            return np.array([-position, count, end, sound])
    while position < size and (data[position] != 0xA3 or (position + 1 < size and data[position + 1] != 0x95)):
        position += 1  # where the next record may begin that the data does not hold whole
    return np.array([position, count, end, sound])
