"""From the bytes of a DataFlash log to one table per message: the chain of records, followed in arrays.

A record begins with A3 95 and its type, and the type's length tells where the next one begins. All places with A3 95
are found at once. In a sound file nearly every record ends where the next of these places is, or before it, so only the
records that hold an A3 95 within themselves are gone through one by one. After damage the chain resumes at the next
A3 95 of a known type; a last record that is cut short is dropped. Records carry no checksum: a flipped bit in a value
is a wrong value.

A record means what its type was declared to be before it. So where types are being declared, at the head of every log,
the records are followed one by one, and arrays are used from there on, up to the next declaration that is new.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mavdiag.logs.dataflash_format import (
    FMT_BYTES,
    FMT_TYPE,
    HEADER,
    HEADER_BYTES,
    MAX_RECORD,
    Format,
    Table,
    declared,
    first_instance,
)
from mavdiag.logs.records import gather

__all__ = ["Walk"]

PATIENCE = 64  # this many records without a new type: the head of the file is over (our choice)
FIRST_SPAN, MAX_SPAN = 1024, 1 << 18  # places taken at once: few behind a declaration, then more each time (our choice)

PAIRS_AT_ONCE = 1 << 17  # bytes compared at once stay in the processor's cache (our choice)
HEADER_WORD = int.from_bytes(HEADER, "little")

Places = NDArray[np.int64]


@dataclass(slots=True)
class _Gathered:
    """The records of one type so far, and their places in the file (int64). Arrays that grow would be held twice."""

    starts: bytearray = field(default_factory=bytearray)
    records: bytearray = field(default_factory=bytearray)


class Walk:
    """The records of the wanted messages, taken from a file that is fed piece by piece.

    wanted: names of the messages.
    patience, first_span: as the constants above.
    """

    def __init__(self, wanted: Collection[str], patience: int = PATIENCE, first_span: int = FIRST_SPAN) -> None:
        self._wanted = wanted
        self._patience = patience
        self._first_span = first_span
        self._span = 0  # how many places are taken at once; 0 where types are being declared
        self._formats: dict[int, Format] = {}
        self._lengths = [FMT_BYTES if kind == FMT_TYPE else 0 for kind in range(256)]  # by type; 0 for unknown
        self._steps = np.maximum(np.array(self._lengths, np.int64), 1)  # to where the next record may begin
        self._taken = np.zeros(256, np.bool_)  # whether records of a type are gathered
        self._gathered: dict[int, _Gathered] = {}  # by type, in the order of their declaration
        self._found: list[tuple[Places, NDArray[np.uint8]]] = []  # within the present piece: places and types
        self._base = 0  # place in the file where the present piece starts
        self._carry = b""  # the end of the last piece, where a record may have begun
        self._sound_end = 0  # place in the file behind the last whole record of a known type
        self._sound = 0  # bytes in such records so far
        self._lost = False  # whether anything but padding was behind it

    def feed(self, data: bytes) -> None:
        """Take in the next piece of the file. Never raises on content."""
        data = self._carry + data if self._carry else data
        sound_end = self._sound_end
        resume = self._follow(data)
        self._gather(data)
        advanced = self._sound_end > sound_end
        rest = data[self._sound_end - self._base :] if advanced else data
        self._lost = bool(rest.strip(b"\0\xff")) or (self._lost and not advanced)
        self._carry = data[resume:]
        self._base += resume

    def finish(self) -> tuple[Mapping[str, Table], tuple[str, ...]]:
        """The tables by name, absent messages left out, and what is wrong with the file, one sentence each.

        Of a message that comes from several instances of a sensor, only the first instance is kept; of two types with
        the same name, the one that was declared first and has records.
        """
        found: dict[str, Table] = {}
        for kind, gathered in self._gathered.items():
            form = self._formats[kind]
            if gathered.starts and form.name not in found:
                records = np.frombuffer(gathered.records, form.layout())
                found[form.name] = first_instance(Table(form, np.frombuffer(gathered.starts, np.int64), records))
        lost = self._base + len(self._carry) - self._sound_end
        cut = f"it ends within a record, {lost} bytes are lost: the recording was cut off"
        between = self._sound_end - self._sound
        damaged = f"{between} bytes of it are no records of a known type and were skipped"
        return found, tuple(note for note, told in ((damaged, between), (cut, self._lost)) if told)

    def _follow(self, data: bytes) -> int:
        """Follow the chain through a piece. Returns where a record may begin that it does not hold whole."""
        if len(data) <= MAX_RECORD:
            return self._one_by_one(data, _next_header(data, 0), len(data))
        octets = np.frombuffer(data, np.uint8)
        places = _headers(data, octets)
        whole = int(np.searchsorted(places, len(data) - MAX_RECORD, "right"))  # records from these places are
        position = _next_header(data, 0)
        while (first := int(np.searchsorted(places, position))) < whole:
            if self._span == 0:
                position = self._one_by_one(data, position, self._patience)
                self._span = self._first_span
            else:
                end, learnt = self._at_once(data, octets, places[first : min(first + self._span, whole)])
                position = _next_header(data, end)
                self._span = 0 if learnt else min(2 * self._span, MAX_SPAN)
        return self._one_by_one(data, position, len(data))

    def _one_by_one(self, data: bytes, position: int, patience: int) -> int:
        """Follow the chain from the header at `position` until no new type was declared for `patience` records.

        Returns the next header, or the first one whose record is not whole.
        """
        places: list[int] = []
        left = patience
        while left > 0 and position <= len(data) - HEADER_BYTES:
            kind = data[position + 2]
            length = self._lengths[kind]
            if position + length > len(data):
                break
            if length:
                self._sound_end = self._base + position + length
                self._sound += length
            left -= 1
            if kind == FMT_TYPE:
                left = patience if self._learn(data, position) else left
            elif self._taken[kind]:
                places.append(position)
            position = _next_header(data, position + (length or 1))
        if places:
            at = np.array(places, np.int64)
            self._found.append((at, np.frombuffer(data, np.uint8)[at + 2]))
        return position

    def _at_once(self, data: bytes, octets: NDArray[np.uint8], places: Places) -> tuple[int, bool]:
        """Follow the chain from the first of these headers through all of them, as arrays.

        Returns where the last record that was followed ends, and whether it declared a new type: then the rest of the
        places may mean something else.
        """
        kinds = octets[places + 2]
        ends = places + self._steps.take(kinds)
        kept = np.ones(len(places), np.bool_)
        holding = np.flatnonzero(ends[:-1] > places[1:])
        if len(holding):
            kept = _reached(len(places), holding, np.searchsorted(places, ends[holding]))
        taken = self._taken.take(kinds) & kept
        declarations = np.flatnonzero((kinds == FMT_TYPE) & kept).tolist()
        new = next((index for index in declarations if self._learn(data, int(places[index]))), None)
        if new is not None:
            kept[new + 1 :] = taken[new + 1 :] = False
        self._found.append((places[taken], kinds[taken]))
        sound = kept & (ends > places + 1)
        if sound.any():
            self._sound += int((ends - places)[sound].sum())
            self._sound_end = self._base + int(ends[_last(sound)])
        return int(ends[_last(kept)]), new is not None

    def _learn(self, data: bytes, position: int) -> bool:
        """Take in the FMT record at `position`. Returns whether records behind it mean something else than before.

        A type keeps its first sound definition: a later one is damage.
        """
        kind, found = declared(data, position)
        known = self._formats.get(kind)
        if kind == FMT_TYPE or found.length < HEADER_BYTES or (known is not None and known.sound):
            return False
        self._formats[kind] = found
        taken = found.name in self._wanted and found.sound
        changed = taken or found.length != self._lengths[kind]
        self._lengths[kind] = self._steps[kind] = found.length
        if taken:
            self._taken[kind] = True
            self._gathered[kind] = _Gathered()
        return changed

    def _gather(self, data: bytes) -> None:
        """Copy the records that were found in a piece out of it."""
        if not self._found:
            return
        places = np.concatenate([places for places, _ in self._found])
        kinds = np.concatenate([kinds for _, kinds in self._found])
        self._found.clear()
        for kind, gathered in self._gathered.items():
            at = places[kinds == kind]
            if len(at):
                gathered.starts += (at + self._base).data
                gathered.records += gather(data, self._formats[kind].layout(), at).view(np.uint8).data


def _last(flags: NDArray[np.bool_]) -> int:
    """The last place that is set; at least one is."""
    return len(flags) - 1 - int(flags[::-1].argmax())


def _headers(data: bytes, octets: NDArray[np.uint8]) -> Places:
    """Where the bytes A3 95 are, except perhaps the last two. Of a pair of places only one can have them."""
    pairs = (len(data) - 1) // 2
    even, odd = np.frombuffer(data, "<u2", pairs), np.frombuffer(data, "<u2", pairs, 1)
    parts = []
    for first in range(0, pairs, PAIRS_AT_ONCE):
        either = even[first : first + PAIRS_AT_ONCE] == HEADER_WORD
        either |= odd[first : first + PAIRS_AT_ONCE] == HEADER_WORD
        parts.append(np.flatnonzero(either) + first)
    places = 2 * np.concatenate(parts)
    places += octets[places + 1] == HEADER[0]
    return places


def _next_header(data: bytes, position: int) -> int:
    """Where the next header is; if there is none, where one may begin that the data does not hold whole."""
    found = data.find(HEADER, position)
    return found if found >= 0 else max(position, len(data) - data.endswith(HEADER[:1]))


def _reached(count: int, holding: Places, after: Places) -> NDArray[np.bool_]:
    """Which of `count` headers the chain reaches from the first one, (count,).

    holding: (k,) the headers whose record holds the next one, rising. after: (k,) the first header behind that record.
    """
    change = np.zeros(count + 1, np.int8)
    reached = 0
    for one, next_one in zip(holding.tolist(), after.tolist(), strict=True):
        if one >= reached:
            change[one + 1] += 1
            change[next_one] -= 1
            reached = next_one
    kept: NDArray[np.bool_] = np.cumsum(change[:count], dtype=np.int8) == 0
    return kept
