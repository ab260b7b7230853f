"""What a link brought, as columns: what comes by the ten thousand a second is no object each."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.jit import cached
from mavdiag.link.sequence import Source
from mavdiag.telemetry import IntArray

Bytes: TypeAlias = NDArray[np.uint8]
Chunk: TypeAlias = tuple[bytes, int]  # the bytes as they came, and the host clock [ns] when they came, or were read


@dataclass(frozen=True, slots=True, eq=False)
class Datagrams:
    """Datagrams, or reads of a byte stream, in order of arrival; iterates them one by one.

    data: bytes of all, end to end. sizes, host_ns, whose: (n,) bytes, arrival [ns] and place in `peers` of each.
    """

    data: Bytes
    sizes: IntArray
    host_ns: IntArray
    whose: IntArray
    peers: tuple[Any, ...]  # as `Source`

    def __post_init__(self) -> None:
        self.data.flags.writeable = False  # as bytes are: numba compiles once

    def __len__(self) -> int:
        return len(self.sizes)

    def __iter__(self) -> Iterator[Chunk]:
        data, stop = self.data.tobytes(), 0
        for size, host_ns in zip(self.sizes.tolist(), self.host_ns.tolist(), strict=True):
            stop += size
            yield data[stop - size : stop], host_ns

    @property
    def sources(self) -> list[Any]:
        """The sender of each."""
        whose = self.whose.tolist() if len(self.peers) > 1 else ()
        return [self.peers[number] for number in whose] or [*self.peers] * len(self)


def as_columns(chunks: Sequence[Chunk], sources: Sequence[Source] = ()) -> Datagrams:
    """What came one by one as columns. sources: the sender of each; empty where there is one other end."""
    if not chunks:
        return NOTHING
    data, times = zip(*chunks, strict=True)
    places = {source: place for place, source in enumerate(dict.fromkeys(sources or (None,)))}
    whose = [places[source] for source in sources] if sources else [0] * len(data)
    sizes, host_ns, numbers = np.array([[*map(len, data)], times, whose], np.int64)
    return Datagrams(np.frombuffer(b"".join(data), np.uint8), sizes, host_ns, numbers, tuple(places))


def joined_datagrams(pieces: Sequence[Datagrams]) -> Datagrams:
    """All of these as one, in this order."""
    if len(pieces) < 2:
        return pieces[0] if pieces else NOTHING
    peers, whose = list[Source](), list[IntArray]()
    for piece in pieces:
        whose.append(piece.whose + len(peers))
        peers += piece.peers
    columns = ((piece.data, piece.sizes, piece.host_ns) for piece in pieces)
    data, sizes, host_ns = map(np.concatenate, zip(*columns, strict=True))
    return Datagrams(data, sizes, host_ns, np.concatenate(whose), tuple(peers))


@cached
def end_to_end(room: Bytes, sizes: IntArray) -> Bytes:
    """The first bytes of each row, so many as `sizes` says, one after the other."""
    data, stop = np.empty(np.sum(sizes), np.uint8), 0
    for k in range(len(sizes)):
        for place in range(sizes[k]):
            data[stop + place] = room[k, place]
        stop += sizes[k]
    return data


_NONE = np.empty(0, np.int64)
NOTHING = Datagrams(np.empty(0, np.uint8), _NONE, _NONE, _NONE, (None,))
