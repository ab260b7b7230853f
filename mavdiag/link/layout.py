"""How a MAVLink message lies on the wire, and how values are made to fit it.

Fields travel sorted by size and are declared in another order; arrays lie flat; text is bytes padded with NUL.
"""

import math
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeAlias, cast

import numpy as np
from fastcrc.crc16 import mcrf4xx

from mavdiag.errors import UsageError
from mavdiag.link.messages import MessageId

FieldValue: TypeAlias = int | float | bytes
Argument: TypeAlias = int | float | bytes | str | Sequence[int] | Sequence[float]

FLOAT32_MAX = 3.4028234663852886e38  # IEEE 754 binary32
_INTEGERS = {
    code: (-(1 << bits - 1), (1 << bits - 1) - 1) if code.islower() else (0, (1 << bits) - 1)
    for codes, bits in (("bB", 8), ("hH", 16), ("iI", 32), ("qQ", 64))
    for code in codes
}


@dataclass(frozen=True, slots=True)
class Layout:
    """One message on the wire."""

    name: str
    names: tuple[str, ...]  # fields as declared
    sizes: tuple[int, ...]  # places that each takes in a flat tuple
    order: tuple[int, ...]  # declared index of each wire field
    packer: struct.Struct
    crc_extra: bytes  # the one-byte checksum seed, different for each definition of a message

    @property
    def codes(self) -> tuple[str, ...]:
        """The struct code of each place of the wire; text is one place, with its length, as in `50s`."""
        return _codes(self.packer.format)

    def place(self, name: str) -> int:
        """Where a field, or an array's first element, is in the flat tuple. Raises UsageError if there is none."""
        if name not in self.names:
            raise UsageError(f"{self.name} has no field {name}")
        before = self.order[: self.order.index(self.names.index(name))]
        return sum(self.sizes[index] for index in before)

    def offset(self, name: str) -> tuple[int, str]:
        """At which byte of the payload a field begins, and its struct code. Raises UsageError if there is none."""
        place = self.place(name)
        return struct.calcsize("<" + "".join(self.codes[:place])), self.codes[place]

    def record_dtype(self, *columns: tuple[str, int]) -> np.dtype[np.void]:
        """How numpy reads payloads as records of some columns (field, count): so many places from the field on.

        Raises UsageError if there is no such field, or the places differ in type.
        """
        formats, offsets = [], []
        for name, count in columns:
            place, (offset, code) = self.place(name), self.offset(name)
            if set(self.codes[place : place + count]) != {code}:
                raise UsageError(f"{self.name}: {count} places from {name} on are not of one type")
            formats.append(np.dtype("<" + code) if count == 1 else np.dtype(("<" + code, count)))
            offsets.append(offset)
        names = [name for name, _ in columns]
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.packer.size})

    def pack(self, fields: Sequence[Argument]) -> bytes:
        """The payload, not trimmed, from fields in the declared order; trailing ones left out are zero.

        Integers are rounded and saturated, text is cut. Raises UsageError for too many fields, an array of the wrong
        length, or a value that its field cannot hold at all.
        """
        if len(fields) > len(self.names):
            raise UsageError(f"{self.name} has {len(self.names)} fields, not {len(fields)}")
        if len(fields) < len(self.names):
            fields = [*fields, *(0 if size == 1 else (0,) * size for size in self.sizes[len(fields) :])]
        places: list[Argument] = []
        for index in self.order:
            if self.sizes[index] == 1:
                places.append(fields[index])
            else:
                places += fields[index]  # type: ignore[arg-type]  # a scalar here raises TypeError below
        try:
            return self.packer.pack(*places)  # the common case: everything fits as it is
        except (struct.error, OverflowError):
            pass
        if len(self.codes) != len(places):
            wanted = f"{self.name} takes {len(self.codes)} values in all, not {len(places)}"
            raise UsageError(f"{wanted}: an array is too long or short")
        try:
            return self.packer.pack(*(_fit(code, place) for code, place in zip(self.codes, places, strict=True)))
        except (struct.error, TypeError, ValueError) as error:
            raise UsageError(f"{self.name}: {error}") from error


@cache
def _codes(wire_format: str) -> tuple[str, ...]:
    runs = re.findall(r"(\d*)([a-zA-Z])", wire_format)
    places = ([count + code] if code == "s" else [code] * int(count or 1) for count, code in runs)
    return tuple(code for run in places for code in run)


def _fit(code: str, value: Argument) -> FieldValue:
    """The nearest value that the field can hold. Raises ValueError or TypeError if there is none (a NaN integer)."""
    limits = _INTEGERS.get(code)
    if limits is not None:
        number = cast(float, value)  # anything else raises TypeError in the comparison
        return limits[0] if number < limits[0] else limits[1] if number > limits[1] else round(number)
    if code in ("f", "d"):
        number = cast(float, value)
        within = min(max(number, -FLOAT32_MAX), FLOAT32_MAX)
        return within if code == "f" and math.isfinite(number) else number
    if isinstance(value, str):
        return cut(value, int(code[:-1]))
    if isinstance(value, bytes):
        return value
    raise TypeError(f"text wanted, not {value!r}")


def cut(text: str, size: int) -> bytes:
    """The text in UTF-8 within `size` bytes, cut at a whole character."""
    return text.encode()[:size].decode(errors="ignore").encode()


_TYPES = {"char": "s", "uint8_t": "B", "int16_t": "h", "uint16_t": "H", "int32_t": "i", "uint32_t": "I"}
_TYPES |= {"uint64_t": "Q", "float": "f"}


def defined(name: str, *fields: str) -> Layout:
    """The layout of a message by its definition, without extensions.

    Fields travel by falling size of their type; the seed is the checksum of their names and types.

    >>> defined("ESC_STATUS", "uint8_t index", "uint64_t time_usec", "int32_t rpm[4]").order
    (1, 2, 0)
    """
    parts = (re.fullmatch(r"(\w+) (\w+)(?:\[(\d+)\])?", text) for text in fields)
    declared = [(_TYPES[part[1]], int(part[3] or 0), part[1], part[2]) for part in parts if part]
    order = sorted(range(len(declared)), key=lambda index: -struct.calcsize(declared[index][0]))
    crc = mcrf4xx(f"{name} ".encode())
    for _, count, kind, field in (declared[index] for index in order):
        crc = mcrf4xx(f"{kind} {field} ".encode() + bytes([count] if count else []), crc)
    return Layout(
        name,
        tuple(field for *_, field in declared),
        tuple(1 if code == "s" else count or 1 for code, count, *_ in declared),
        tuple(order),
        struct.Struct("<" + "".join(f"{declared[index][1] or 1}{declared[index][0]}" for index in order)),
        bytes([crc & 0xFF ^ crc >> 8]),
    )


_ROTORS = ("int32_t rpm[4]", "float voltage[4]", "float current[4]")
_VERSIONS = ("uint16_t version", "uint16_t min_version", "uint16_t max_version")
_HASHES = ("uint8_t spec_version_hash[8]", "uint8_t library_version_hash[8]")
_MODES = ("uint8_t number_modes", "uint8_t mode_index", "uint8_t standard_mode")
_MODE = ("uint32_t custom_mode", "uint32_t properties", "char mode_name[35]")
_TIMES = ("uint64_t capabilities", "uint32_t time_boot_ms", "uint32_t time_manufacture_s")
_NAMES = (
    *("char vendor_name[32]", "char model_name[32]"),
    *("char software_version[24]", "char hardware_version[24]", "char serial_number[32]"),
)

#: Messages of common.xml that the dialect shipped with pymavlink 2.4 leaves out.
EXTRA_LAYOUTS: Mapping[int, Layout] = {
    MessageId.ESC_STATUS: defined("ESC_STATUS", "uint8_t index", "uint64_t time_usec", *_ROTORS),
    MessageId.PROTOCOL_VERSION: defined("PROTOCOL_VERSION", *_VERSIONS, *_HASHES),
    MessageId.COMPONENT_INFORMATION_BASIC: defined("COMPONENT_INFORMATION_BASIC", *_TIMES, *_NAMES),
    MessageId.AVAILABLE_MODES: defined("AVAILABLE_MODES", *_MODES, *_MODE),
}
