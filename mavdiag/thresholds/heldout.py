"""Score a statistic on healthy flights that its fit did not see, as maxima over blocks of judged time.

With several flights each is scored by a fit to the others. A single flight is cut into pieces, its separate hops where
there are as many, and each piece is scored by a fit to the rest. This is the only place that makes blocks.
"""

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar, overload

import numpy as np

from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray, IntArray

BLOCK_S = 10.0  # judged time of a block (our choice); 7 to 13 s change no verdict on the recorded flights
MAX_FOLDS = 10  # models that share the work of judging flights they did not see (our choice)
MANY, MANY_FOLDS = 50, 5  # sessions, of which a fifth is left out at a time: it moves a threshold 0.12 % (our choice)
PIECES = 5  # of a single flight, one per block at most (our choice)

Found = TypeVar("Found")
Flights: TypeAlias = Sequence[Sequence[Rows]]


class Looks(Sequence[Rows]):
    """The rows of a flight, each made anew for a look, so that they take memory only as long as they are held.

    remembers: it keeps what was found in it, for fits to other sets of flights with it.
    """

    def __init__(self, makers: Iterable[Callable[[], Rows]], remembers: bool = True) -> None:
        self.makers, self._remembers = tuple(makers), remembers
        self._answers: dict[Hashable, Any] = {}

    def once(self, key: Hashable, find: Callable[[Sequence[Rows]], Found]) -> Found:
        """What `find` gives of this flight, and the same for the same key later on."""
        found: Found = self._answers[key] if key in self._answers else find(self)
        if self._remembers:
            self._answers[key] = found
        return found

    def __len__(self) -> int:
        return len(self.makers)

    @overload
    def __getitem__(self, at: int) -> Rows: ...

    @overload
    def __getitem__(self, at: slice) -> Sequence[Rows]: ...

    def __getitem__(self, at: int | slice) -> Rows | Sequence[Rows]:
        return Looks(self.makers[at]) if isinstance(at, slice) else self.makers[at]()


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """What a statistic reached in healthy flight.

    maxima, spans_s, flights: (b,) of each block its highest value, its judged time [s], and the number of its flight.
    """

    maxima: FloatArray
    spans_s: FloatArray
    flights: IntArray

    @property
    def judged_s(self) -> float:
        """Judged time in all blocks: the number of valid values times the span that each stands for."""
        return float(self.spans_s.sum())


def score(monitor: Any, flight: Sequence[Rows], number: int = 0) -> Scores:
    """Block maxima of a monitor over one flight of that number (`maxima`)."""
    return maxima([(one.value[one.valid], one.period_s) for one in monitor.over(flight)], number)


def maxima(pieces: Sequence[tuple[FloatArray, float]], number: int = 0) -> Scores:
    """Block maxima of the valid values of one flight, piece by piece with the time that each value stands for.

    A block holds `BLOCK_S` of judged time, whatever lies between; a remainder shorter than half a block belongs to the
    block before it.
    """
    x = np.concatenate([np.empty(0), *(values for values, _ in pieces)])
    if len(x) == 0:
        return pooled([])
    period_s = pieces[-1][1]
    size = max(1, round(BLOCK_S / period_s))
    count = max(1, len(x) // size + (len(x) % size >= size / 2))
    starts = np.arange(count) * size
    spans_s = np.diff(np.append(starts, len(x))) * period_s
    return Scores(np.maximum.reduceat(x, starts), spans_s, np.full(count, number))


def pooled(parts: Iterable[Scores]) -> Scores:
    """Scores of several flights as one."""
    found = [Scores(np.empty(0), np.empty(0), np.empty(0, dtype=np.int64)), *parts]
    columns = zip(*((one.maxima, one.spans_s, one.flights) for one in found), strict=True)
    return Scores(*map(np.concatenate, columns))


def folds(flights: Flights, sessions: Sequence[int] | None = None) -> Iterator[tuple[Flights, Flights]]:
    """Pairs of what is left out and the rest: of sessions, of flights, or of the pieces of a single flight.

    Up to ten sessions are left out one by one, of more a tenth at a time, of many a fifth.
    """
    if len(flights) == 1:
        yield from _pieces(flights[0])
        return
    groups = list(range(len(flights))) if sessions is None or len(set(sessions)) < 2 else list(sessions)
    order = {group: number for number, group in enumerate(dict.fromkeys(groups))}
    count = min(MAX_FOLDS if len(order) < MANY else MANY_FOLDS, len(order))
    for fold in range(count):
        parts: tuple[list[Sequence[Rows]], list[Sequence[Rows]]] = [], []
        for flight, group in zip(flights, groups, strict=True):
            parts[order[group] % count != fold].append(flight)
        yield parts


def _pieces(flight: Sequence[Rows]) -> Iterator[tuple[Flights, Flights]]:
    """Contiguous folds of one flight, of equal judged time; the parts of a segment become segments of their own."""
    looks = [(rows.block.segment, rows.block.t_ns.copy(), rows.block.valid.copy(), rows.block.dt_s) for rows in flight]
    judged_ns = np.sort(np.concatenate([t_ns[valid] for _, t_ns, valid, _ in looks] or [np.empty(0, dtype=np.int64)]))
    if len(judged_ns) == 0:
        return
    count = min(max(int(len(judged_ns) * looks[0][3] / BLOCK_S), 2), PIECES)
    hops = list(dict.fromkeys(segment for segment, _, valid, _ in looks if valid.any()))
    edges = judged_ns[np.linspace(0, len(judged_ns) - 1, count + 1).round().astype(np.int64)].tolist()
    edges[-1] += 1

    def cut(number: int, first: int, stop: int, segment: int, from_ns: int | None = None) -> Callable[[], Rows]:
        return lambda: flight[number].part(first, stop, segment, from_ns)

    for low_ns, high_ns, hop in zip(edges[:-1], edges[1:], hops if len(hops) == count else [None] * count, strict=True):
        part, rest = list[Callable[[], Rows]](), list[Callable[[], Rows]]()
        for number, (segment, t_ns, _, _) in enumerate(looks):
            if hop is not None:  # each is a piece
                (part if segment == hop else rest).append(cut(number, 0, len(t_ns), segment))
                continue
            first, stop = np.searchsorted(t_ns, [low_ns, high_ns]).tolist()
            places = ((rest, 0, first), (part, first, stop), (rest, stop, len(t_ns)))
            for third, (found, start, end) in enumerate(places):
                if end > start:
                    from_ns = (None, low_ns, high_ns)[third]
                    found.append(cut(number, start, end, 3 * segment + third, from_ns))
        yield [Looks(part, remembers=False)], [Looks(rest, remembers=False)]
