"""Score a statistic on healthy flights that its fit did not see, as maxima over blocks of judged time.

With several flights each is scored by a fit to the others. A single flight is cut into pieces, its separate hops where
there are as many, and each piece is scored by a fit to the rest. This is the only place that makes blocks.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple, Protocol, TypeAlias, overload

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.rows.front import Rows
from mavdiag.rows.rates import RateBlock
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, FloatArray

BLOCK_S = 10.0  # judged time of a block (our choice); 7 to 13 s change no verdict on the recorded flights
MAX_FOLDS = 10  # models that share the work of judging flights they did not see (our choice)
PIECES = 5  # of a single flight, one per block at most (our choice)

Flights: TypeAlias = Sequence[Sequence[Rows]]


class Scored(Protocol):
    """What can be scored: a monitor."""

    def over(self, flight: Sequence[Rows]) -> Iterator[Statistic]:
        """Judge a whole flight."""


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """What a statistic reached in healthy flight.

    maxima: (b,) its highest valid value in each block.
    spans_s: (b,) judged time of each block [s].
    """

    maxima: FloatArray
    spans_s: FloatArray

    @property
    def judged_s(self) -> float:
        """Judged time in all blocks: the number of valid values times the span that each stands for."""
        return float(self.spans_s.sum())


def score(monitor: Scored, flight: Sequence[Rows], block_s: float = BLOCK_S) -> Scores:
    """Block maxima of a monitor over one flight (`maxima`)."""
    values, period_s = [np.empty(0)], 0.0
    for statistic in monitor.over(flight):
        values.append(statistic.value[statistic.valid])
        period_s = statistic.period_s
    return maxima(np.concatenate(values), period_s, block_s)


def maxima(x: FloatArray, period_s: float, block_s: float = BLOCK_S) -> Scores:
    """Block maxima of the valid values of one flight, each of which stands for so much time.

    A block holds `block_s` of judged time, whatever lies between; a remainder shorter than half a block belongs to the
    block before it. Only valid values count, so warm-up, gaps and ground do not.
    """
    if len(x) == 0:
        return Scores(np.empty(0), np.empty(0))
    size = max(1, round(block_s / period_s))
    count = max(1, len(x) // size + (len(x) % size >= size / 2))
    starts = np.arange(count) * size
    return Scores(np.maximum.reduceat(x, starts), np.diff(np.append(starts, len(x))) * period_s)


def pooled(parts: Iterable[Scores]) -> Scores:
    """Scores of several flights as one."""
    found = [Scores(np.empty(0), np.empty(0)), *parts]
    return Scores(np.concatenate([one.maxima for one in found]), np.concatenate([one.spans_s for one in found]))


def by_axis(parts: Iterable[tuple[Axis | None, Scores]]) -> dict[Axis | None, Scores]:
    """The scores of each axis that has any. Raises IdentificationError if there are none."""
    found: dict[Axis | None, list[Scores]] = {}
    for axis, scores in parts:
        found.setdefault(axis, []).append(scores)
    joined = {axis: pooled(scores) for axis, scores in found.items() if any(len(one.maxima) for one in scores)}
    if not joined:
        raise IdentificationError("the healthy flights are too short to score the statistic on; fly longer")
    return joined


def folds(
    flights: Flights, block_s: float = BLOCK_S, sessions: Sequence[int] | None = None
) -> Iterator[tuple[Flights, Flights]]:
    """Pairs of what is left out and the rest: of sessions, of flights, or of the pieces of a single flight."""
    if len(flights) == 1:
        yield from _pieces(flights[0], block_s)
        return
    groups = list(range(len(flights))) if sessions is None or len(set(sessions)) < 2 else list(sessions)
    order = {group: number for number, group in enumerate(dict.fromkeys(groups))}
    count = min(MAX_FOLDS, len(order))
    for fold in range(count):
        left_out = [flight for flight, group in zip(flights, groups, strict=True) if order[group] % count == fold]
        yield left_out, [flight for flight, group in zip(flights, groups, strict=True) if order[group] % count != fold]


class _Place(NamedTuple):
    """Rows [first, stop) of rows with a number, as a segment that begins at a time [ns]."""

    number: int
    first: int
    stop: int
    segment: int
    from_ns: int = int(np.iinfo(np.int64).min)


@dataclass(frozen=True, slots=True, eq=False)
class _Cut(Sequence[Rows]):
    """Parts of the rows of a flight, made as they are looked at."""

    flight: Sequence[Rows]
    places: tuple[_Place, ...]

    def __len__(self) -> int:
        return len(self.places)

    @overload
    def __getitem__(self, at: int) -> Rows: ...

    @overload
    def __getitem__(self, at: slice) -> Sequence[Rows]: ...

    def __getitem__(self, at: int | slice) -> Rows | Sequence[Rows]:
        if isinstance(at, slice):
            return _Cut(self.flight, self.places[at])
        number, first, stop, segment, from_ns = self.places[at]
        rows = self.flight[number]
        rates, lag = rows.rates, len(rows.block) - len(rows.rates)
        kept = slice(max(first - lag, int(rates.t_ns.searchsorted(from_ns)), 0), max(stop - lag, 0))
        columns = (getattr(rates, column.name)[kept] for column in fields(RateBlock)[2:])
        return Rows(rows.block.rows(first, stop, segment), RateBlock(segment, rates.dt_s, *columns))


def _pieces(flight: Sequence[Rows], block_s: float) -> Iterator[tuple[Flights, Flights]]:
    """Contiguous folds of one flight, of equal judged time; the parts of a segment become segments of their own."""
    looks = [(rows.block.segment, rows.block.t_ns.copy(), rows.block.valid.copy(), rows.block.dt_s) for rows in flight]
    judged_ns = np.sort(np.concatenate([t_ns[valid] for _, t_ns, valid, _ in looks] or [np.empty(0, dtype=np.int64)]))
    if len(judged_ns) == 0:
        return
    count = min(max(int(len(judged_ns) * looks[0][3] / block_s), 2), PIECES)
    hops = list(dict.fromkeys(segment for segment, _, valid, _ in looks if valid.any()))
    edges = judged_ns[np.linspace(0, len(judged_ns) - 1, count + 1).round().astype(np.int64)].tolist()
    edges[-1] += 1
    for low_ns, high_ns, hop in zip(edges[:-1], edges[1:], hops if len(hops) == count else [None] * count, strict=True):
        part, rest = list[_Place](), list[_Place]()
        for number, (segment, t_ns, _, _) in enumerate(looks):
            if hop is not None:  # each is a piece
                (part if segment == hop else rest).append(_Place(number, 0, len(t_ns), segment))
                continue
            first, stop = np.searchsorted(t_ns, [low_ns, high_ns]).tolist()
            rest.append(_Place(number, 0, first, 3 * segment))
            part.append(_Place(number, first, stop, 3 * segment + 1, low_ns))
            rest.append(_Place(number, stop, len(t_ns), 3 * segment + 2, high_ns))
        cuts = (_Cut(flight, tuple(place for place in places if place.stop > place.first)) for places in (part, rest))
        yield [next(cuts)], [next(cuts)]
