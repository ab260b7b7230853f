"""Score a statistic on healthy flights that its fit did not see, as maxima over blocks of judged time.

With several flights each is scored by a fit to the others. A single flight is cut into pieces, its separate hops where
there are as many, and each piece is scored by a fit to the rest. This is the only place that makes blocks.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Protocol, TypeAlias

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.rows.front import Rows
from mavdiag.rows.rates import RateBlock
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, FloatArray

__all__ = [
    "BLOCK_S",
    "Flights",
    "Scored",
    "Scores",
    "by_axis",
    "folds",
    "held_out_scores",
    "pooled",
    "score",
    "scored",
]

BLOCK_S = 10.0  # judged time of a block (our choice); 7 to 13 s change no verdict on the recorded flights
MAX_FOLDS = 10  # models that share the work of judging flights they did not see (our choice)
PIECES = 5  # of a single flight, one per block at most (our choice)

Flights: TypeAlias = Sequence[Sequence[Rows]]


class Scored(Protocol):
    """What can be scored: a monitor."""

    @property
    def axis(self) -> Axis | None:
        """The body axis that it is about."""

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
    """Block maxima of a monitor over one flight.

    A block holds `block_s` of judged time, whatever lies between; a remainder shorter than half a block belongs to the
    block before it. Only valid values count, so warm-up, gaps and ground do not.
    """
    values, period_s = [np.empty(0)], 0.0
    for statistic in monitor.over(flight):
        values.append(statistic.value[statistic.valid])
        period_s = statistic.period_s
    x = np.concatenate(values)
    if len(x) == 0:
        return Scores(np.empty(0), np.empty(0))
    size = max(1, round(block_s / period_s))
    count = max(1, len(x) // size + (len(x) % size >= size / 2))
    starts = np.arange(count) * size
    return Scores(np.maximum.reduceat(x, starts), np.diff(np.append(starts, len(x))) * period_s)


def pooled(parts: Iterable[Scores]) -> Scores:
    """Scores of several flights as one."""
    found = list(parts)
    empty = [np.empty(0)]
    return Scores(
        np.concatenate([one.maxima for one in found] or empty), np.concatenate([one.spans_s for one in found] or empty)
    )


def held_out_scores(
    flights: Flights,
    fit: Callable[[Flights], Sequence[Scored]],
    block_s: float = BLOCK_S,
    sessions: Sequence[int] | None = None,
) -> dict[Axis | None, Scores]:
    """Scores of all flights by axis, each flight scored by a fit that did not see it. fit: the monitors of a fit.

    sessions: the session of each flight; with two or more of them the fit has not seen the session either.

    Raises IdentificationError if there is nothing to fit to or no block to score.
    """
    pairs = list(folds(flights, block_s, sessions))
    (found,) = scored([left_out for left_out, _ in pairs], [[fit(rest) for _, rest in pairs]], block_s)
    return by_axis(found)


def scored(
    left_out: Sequence[Flights], fits: Sequence[Sequence[Sequence[Scored]]], block_s: float = BLOCK_S
) -> list[list[tuple[Axis | None, Scores]]]:
    """Scores of several monitors by axis, fold by fold; each flight is looked at once, for all of them.

    left_out: the flights of each fold. fits: of each monitor its fits, one for each axis, to the rest of each fold.
    """
    found: list[list[tuple[Axis | None, Scores]]] = [[] for _ in fits]
    for fold, flights in enumerate(left_out):
        of_fold: list[list[list[Scores]]] = [[[] for _ in one[fold]] for one in fits]
        for flight in flights:
            look = tuple(flight)
            for one, parts in zip(fits, of_fold, strict=True):
                for monitor, scores in zip(one[fold], parts, strict=True):
                    scores.append(score(monitor, look, block_s))
        for number, (one, parts) in enumerate(zip(fits, of_fold, strict=True)):
            found[number] += [(m.axis, pooled(scores)) for m, scores in zip(one[fold], parts, strict=True)]
    return found


def by_axis(parts: Sequence[tuple[Axis | None, Scores]]) -> dict[Axis | None, Scores]:
    """The scores of each axis that has any. Raises IdentificationError if there are none."""
    axes = dict.fromkeys(axis for axis, _ in parts)
    joined = {axis: pooled(scores for other, scores in parts if other == axis) for axis in axes}
    found = {axis: scores for axis, scores in joined.items() if len(scores.maxima)}
    if not found:
        raise IdentificationError("the healthy flights are too short to score the statistic on; fly longer")
    return found


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


def _pieces(flight: Sequence[Rows], block_s: float) -> Iterator[tuple[Flights, Flights]]:
    """Contiguous folds of one flight, of equal judged time."""
    times = [rows.block.t_ns[rows.block.valid] for rows in flight]
    judged_ns = np.sort(np.concatenate(times)) if times else np.empty(0, dtype=np.int64)
    if len(judged_ns) == 0:
        return
    count = min(max(int(len(judged_ns) * flight[0].block.dt_s / block_s), 2), PIECES)
    hops = _hops(flight)
    if len(hops) == count:
        for i, hop in enumerate(hops):
            yield [hop], [[rows for j, other in enumerate(hops) if j != i for rows in other]]
        return
    edges = judged_ns[np.linspace(0, len(judged_ns) - 1, count + 1).round().astype(np.int64)].tolist()
    edges[-1] += 1
    ends = (int(np.iinfo(np.int64).min), int(np.iinfo(np.int64).max))
    for low, high in itertools.pairwise(edges):
        rest = _between(flight, ends[0], low, 0) + _between(flight, high, ends[1], 2)
        yield [_between(flight, low, high, 1)], [rest]


def _hops(flight: Sequence[Rows]) -> list[list[Rows]]:
    """The rows of each segment that has a valid one."""
    hops: dict[int, list[Rows]] = {}
    for rows in flight:
        hops.setdefault(rows.block.segment, []).append(rows)
    return [hop for hop in hops.values() if any(rows.block.valid.any() for rows in hop)]


def _between(flight: Sequence[Rows], low_ns: int, high_ns: int, part: int) -> list[Rows]:
    """The rows with low <= t < high; the parts of a segment become segments of their own."""
    out = []
    for rows in flight:
        segment = 3 * rows.block.segment + part
        first, stop = np.searchsorted(rows.block.t_ns, [low_ns, high_ns]).tolist()
        rates = _cut_rates(rows, first, stop, low_ns, segment)
        if stop > first:
            out.append(Rows(rows.block.rows(first, stop, segment), rates))
    return out


def _cut_rates(rows: Rows, first: int, stop: int, low_ns: int, segment: int) -> RateBlock:
    """The rates that the rows [first, stop) complete, of a segment that begins at `low_ns`."""
    rates, lag = rows.rates, len(rows.block) - len(rows.rates)
    kept = slice(max(first - lag, int(rates.t_ns.searchsorted(low_ns)), 0), max(stop - lag, 0))
    columns = (getattr(rates, column.name)[kept] for column in fields(RateBlock)[2:])
    return RateBlock(segment, rates.dt_s, *columns)
