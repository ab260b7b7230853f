"""The autopilot's frames (component 1) of one vehicle, message by message: what the conversion to samples reads."""

from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.link.codec import Frame
from mavdiag.link.messages import Component
from mavdiag.telemetry import IntArray

Record: TypeAlias = NDArray[Any]

AUTOPILOT = int(Component.AUTOPILOT1)
_host_ns = itemgetter(5)  # of a Frame


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """The frames of one message, in order of arrival.

    places: (n,) which of the batch's frames they are, ascending.
    payloads: as on the wire, with the trimmed zeros put back, one behind the other: bytes, or (n, size).
    host_ns: (n,) when they were received [ns].
    """

    places: IntArray
    payloads: bytes | NDArray[np.uint8]
    host_ns: IntArray

    def __len__(self) -> int:
        return len(self.host_ns)

    def record(self, dtype: np.dtype[np.void]) -> Record:
        """(n,) the payloads as records, see `codec.record_dtype`."""
        return np.frombuffer(self.payloads, dtype)

    def part(self, start: int, stop: int) -> "Column | None":
        """The frames at these places of the batch, counted from `start`; None if there are none."""
        first, last = np.searchsorted(self.places, (start, stop)).tolist()
        if first == last:
            return None
        size = len(self.payloads) // len(self) if isinstance(self.payloads, bytes) else 1
        own = self.payloads[first * size : last * size]
        return Column(self.places[first:last] - start, own, self.host_ns[first:last])


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Frames of one vehicle in order of arrival.

    size: how many places there are; every frame has one.
    columns: the autopilot's frames, by message; that which came first is the first. None is empty.
    """

    size: int
    columns: Mapping[int, Column]

    def part(self, start: int, stop: int) -> "Batch":
        """What is at these places."""
        parts = {msgid: part for msgid, column in self.columns.items() if (part := column.part(start, stop))}
        first = sorted(parts, key=lambda msgid: int(parts[msgid].places[0]))
        return Batch(max(0, min(stop, self.size) - start), {msgid: parts[msgid] for msgid in first})


def batch_of(frames: Sequence[Frame], wanted: Container[int] | None = None) -> Batch:
    """Frames that came one by one. wanted: messages; None for all."""
    members: dict[int, tuple[list[int], list[Frame]]] = {}
    for place, frame in enumerate(frames):
        msgid = frame[0]
        if frame[2] == AUTOPILOT and (wanted is None or msgid in wanted):
            if msgid not in members:
                members[msgid] = ([], [])
            places, own = members[msgid]
            places.append(place)
            own.append(frame)
    columns = {
        msgid: Column(
            np.array(places),
            b"".join([frame[4] for frame in own]),
            np.fromiter(map(_host_ns, own), np.int64, len(own)),
        )
        for msgid, (places, own) in members.items()
    }
    return Batch(len(frames), columns)


def total(batches: Iterable[Batch]) -> Counter[int]:
    """How many frames of each message the autopilot sent in all of these."""
    found = Counter[int]()
    for batch in batches:
        found.update({msgid: len(column) for msgid, column in batch.columns.items()})
    return found
