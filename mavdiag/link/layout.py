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
    """One message on the wire.

    name: of the message.
    names: fields as declared.
    sizes: places that each takes in a flat tuple.
    order: declared index of each wire field.
    packer: the wire format.
    crc_extra: the one-byte checksum seed, different for each definition of a message.
    """

    name: str
    names: tuple[str, ...]
    sizes: tuple[int, ...]
    order: tuple[int, ...]
    packer: struct.Struct
    crc_extra: bytes

    @property
    def wire_fields(self) -> tuple[tuple[str, int], ...]:
        """Name and number of places of each field, in the order of the wire."""
        return tuple((self.names[i], self.sizes[i]) for i in self.order)

    @property
    def codes(self) -> tuple[str, ...]:
        """The struct code of each place of the wire; text is one place, with its length, as in `50s`."""
        return _codes(self.packer.format)

    def place(self, name: str) -> int:
        """Where a field, or an array's first element, is in the flat tuple. Raises UsageError if there is none."""
        place = 0
        for wire_name, size in self.wire_fields:
            if wire_name == name:
                return place
            place += size
        raise UsageError(f"{self.name} has no field {name}")

    def offset(self, name: str) -> tuple[int, str]:
        """At which byte of the payload a field begins, and its struct code. Raises UsageError if there is none."""
        place = self.place(name)
        return struct.calcsize("<" + "".join(self.codes[:place])), self.codes[place]

    def record_dtype(self, columns: Sequence[tuple[str, int]]) -> np.dtype[np.void]:
        """The payload as a record of some columns. Raises UsageError: no such field, or a column of several types.

        columns: (field, count); a column of count > 1 takes that many consecutive places from the field on.
        """
        codes = self.codes
        formats, offsets = [], []
        for name, count in columns:
            first = self.place(name)
            kinds = set(codes[first : first + count])
            if len(kinds) != 1:
                raise UsageError(f"{self.name}: {count} places from {name} on are not of one type")
            kind = np.dtype("<" + kinds.pop())
            formats.append(kind if count == 1 else np.dtype((kind, count)))
            offsets.append(struct.calcsize("<" + "".join(codes[:first])))
        names = [name for name, _ in columns]
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.packer.size})

    def pack(self, fields: Sequence[Argument]) -> bytes:
        """The payload, not trimmed, from fields in the declared order; trailing ones left out are zero.

        Integers are rounded and saturated, text is cut. Raises UsageError for too many fields, an array of the wrong
        length, or a value that its field cannot hold at all.
        """
        if len(fields) != len(self.names):
            fields = self._complete(fields)
        places: list[Argument] = []
        for index in self.order:
            if self.sizes[index] == 1:
                places.append(fields[index])
            else:
                places += fields[index]  # type: ignore[arg-type]  # a scalar here raises TypeError below
        try:
            return self.packer.pack(*places)  # the common case: everything fits as it is
        except (struct.error, OverflowError):
            return self._pack_fitted(places)

    def _complete(self, fields: Sequence[Argument]) -> Sequence[Argument]:
        if len(fields) > len(self.names):
            raise UsageError(f"{self.name} has {len(self.names)} fields, not {len(fields)}")
        zeros: list[Argument] = [0 if size == 1 else (0,) * size for size in self.sizes[len(fields) :]]
        return [*fields, *zeros]

    def _pack_fitted(self, places: Sequence[Argument]) -> bytes:
        codes = self.codes
        if len(codes) != len(places):
            raise UsageError(
                f"{self.name} takes {len(codes)} values in all, not {len(places)}: an array is too long or short"
            )
        try:
            return self.packer.pack(*(_fit(code, place) for code, place in zip(codes, places, strict=True)))
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
    """The text in UTF-8 within `size` bytes, cut at a whole character.

    >>> cut("a\u00e9", 2)
    b'a'
    """
    return text.encode()[:size].decode(errors="ignore").encode()


EXTRA_LAYOUTS: Mapping[int, Layout] = {
    MessageId.ESC_INFO: Layout(
        "ESC_INFO",
        (
            "index",
            "time_usec",
            "counter",
            "count",
            "connection_type",
            "info",
            "failure_flags",
            "error_count",
            "temperature",
        ),
        (1, 1, 1, 1, 1, 1, 4, 4, 4),
        (1, 7, 2, 6, 8, 0, 3, 4, 5),
        struct.Struct("<Q4IH4H4h4B"),
        bytes([251]),
    ),
    MessageId.ESC_STATUS: Layout(
        "ESC_STATUS",
        ("index", "time_usec", "rpm", "voltage", "current"),
        (1, 1, 4, 4, 4),
        (1, 2, 3, 4, 0),
        struct.Struct("<Q4i4f4fB"),
        bytes([10]),
    ),
    MessageId.PROTOCOL_VERSION: Layout(
        "PROTOCOL_VERSION",
        ("version", "min_version", "max_version", "spec_version_hash", "library_version_hash"),
        (1, 1, 1, 8, 8),
        (0, 1, 2, 3, 4),
        struct.Struct("<3H8B8B"),
        bytes([217]),
    ),
    MessageId.AVAILABLE_MODES: Layout(
        "AVAILABLE_MODES",
        ("number_modes", "mode_index", "standard_mode", "custom_mode", "properties", "mode_name"),
        (1, 1, 1, 1, 1, 1),
        (3, 4, 0, 1, 2, 5),
        struct.Struct("<2I3B35s"),
        bytes([134]),
    ),
}
"""Messages of common.xml that the dialect shipped with pymavlink 2.4 leaves out."""
