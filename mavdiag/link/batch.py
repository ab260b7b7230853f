"""Frames of one vehicle in order of arrival, seen message by message: what the conversion to samples reads.

A live link brings frames one by one (`FrameBatch`), a recording whole columns of them (`ColumnBatch`). Of both, only
what the autopilot itself sends (component 1) is in the columns.
"""

from collections import Counter, defaultdict
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.link.codec import Frame
from mavdiag.link.messages import Component
from mavdiag.telemetry import IntArray

__all__ = ["Batch", "Column", "ColumnBatch", "FrameBatch", "Record", "total"]

Record: TypeAlias = NDArray[Any]

AUTOPILOT = int(Component.AUTOPILOT1)

_host_ns = itemgetter(5)  # of a Frame


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """The frames of one message, in order of arrival.

    payloads: as on the wire, with the trimmed zeros put back, one behind the other: bytes, or (n, size).
    host_ns: (n,) when they were received [ns].
    """

    payloads: bytes | NDArray[np.uint8]
    host_ns: IntArray

    def __len__(self) -> int:
        return len(self.host_ns)

    def record(self, dtype: np.dtype[np.void]) -> Record:
        """(n,) the payloads as records, see `codec.record_dtype`."""
        return np.frombuffer(self.payloads, dtype) if len(self.payloads) else np.empty(0, dtype)


class Batch(Protocol):
    """Frames of one vehicle in order of arrival."""

    def __len__(self) -> int:
        """How many places there are; every frame has one."""

    def counts(self) -> Mapping[int, int]:
        """How many frames of each message the autopilot sent."""

    def columns(self, wanted: Container[int]) -> Mapping[int, Column]:
        """The autopilot's frames of these messages, by message; that which came first is the first."""

    def places(self, msgid: int) -> IntArray:
        """(n,) where in the batch the autopilot's frames of a message are."""

    def part(self, start: int, stop: int) -> "Batch":
        """What is at these places."""


class FrameBatch:
    """Frames that came one by one."""

    def __init__(self, frames: Sequence[Frame]) -> None:
        self._frames = frames

    def __len__(self) -> int:
        return len(self._frames)

    def counts(self) -> Mapping[int, int]:
        """See `Batch`."""
        return Counter(frame.msgid for frame in self._frames if frame.compid == AUTOPILOT)

    def columns(self, wanted: Container[int]) -> Mapping[int, Column]:
        """See `Batch`."""
        autopilot = AUTOPILOT
        members: defaultdict[int, list[Frame]] = defaultdict(list)
        for frame in self._frames:
            if frame[0] in wanted and frame[2] == autopilot:
                members[frame[0]].append(frame)
        return {
            msgid: Column(b"".join([frame[4] for frame in own]), np.fromiter(map(_host_ns, own), np.int64, len(own)))
            for msgid, own in members.items()
        }

    @cached_property
    def _ids(self) -> IntArray:
        own = (frame[0] if frame[2] == AUTOPILOT else -1 for frame in self._frames)
        return np.fromiter(own, np.int64, len(self._frames))

    def places(self, msgid: int) -> IntArray:
        """See `Batch`."""
        return np.flatnonzero(self._ids == msgid)

    def part(self, start: int, stop: int) -> "FrameBatch":
        """See `Batch`."""
        return FrameBatch(self._frames[start:stop])


class ColumnBatch:
    """Frames that came as columns, those of the autopilot.

    size: places.
    rows: by message, where its frames are, ascending, and the frames themselves.
    """

    def __init__(self, size: int, rows: Mapping[int, tuple[IntArray, Column]]) -> None:
        self._size = size
        self._rows = dict(sorted(rows.items(), key=lambda one: int(one[1][0][0])))

    def __len__(self) -> int:
        return self._size

    def counts(self) -> Mapping[int, int]:
        """See `Batch`."""
        return {msgid: len(column) for msgid, (_, column) in self._rows.items()}

    def columns(self, wanted: Container[int]) -> Mapping[int, Column]:
        """See `Batch`."""
        return {msgid: column for msgid, (_, column) in self._rows.items() if msgid in wanted}

    def places(self, msgid: int) -> IntArray:
        """See `Batch`."""
        return self._rows[msgid][0] if msgid in self._rows else np.empty(0, np.int64)

    def part(self, start: int, stop: int) -> "ColumnBatch":
        """See `Batch`."""
        rows = {}
        for msgid, (places, column) in self._rows.items():
            first, last = np.searchsorted(places, (start, stop)).tolist()
            if first < last:
                own = Column(column.payloads[first:last], column.host_ns[first:last])
                rows[msgid] = (places[first:last] - start, own)
        return ColumnBatch(max(0, min(stop, self._size) - start), rows)


def total(batches: Iterable[Batch]) -> Counter[int]:
    """How many frames of each message the autopilot sent in all of these."""
    found = Counter[int]()
    for batch in batches:
        found.update(batch.counts())
    return found
