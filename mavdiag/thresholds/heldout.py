"""Score a statistic on healthy flights that its fit did not see, as maxima over blocks of flight.

With several flights each is scored by a fit to the others. A single flight is cut into pieces, its separate hops where
there are as many, and each piece is scored by a fit to the rest.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.monitors.base import Flights, Monitor
from mavdiag.rows.front import Rows
from mavdiag.rows.rates import RateBlock
from mavdiag.telemetry import NS_PER_S, FloatArray, IntArray

__all__ = ["Flights", "Scores", "folds", "held_out_scores", "score"]

BLOCK_S = 10.0  # our choice; 7 to 13 s change no verdict on the recorded flights
MAX_FOLDS = 10  # models that share the work of judging flights they did not see (our choice)
PIECES = 5  # of a single flight, one per block at most (our choice)

Spec = TypeVar("Spec")


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """maxima: (b,) of the statistic, one a block of flight. block_s: its length.

    judged_s: time of flight that the maxima cover, from the first valid row of a segment to its last judged one.
    """

    maxima: FloatArray
    judged_s: float
    block_s: float = BLOCK_S


def score(monitor: Monitor[Any, Any], flight: Sequence[Rows], block_s: float = BLOCK_S) -> Scores:
    """Block maxima of a monitor over one flight.

    A block is `block_s` of one segment, counted from its first valid row. A remainder counts if half a block of it
    was judged, or if it is all that the segment has.
    """
    maxima: list[float] = []
    judged_s = 0.0
    for t_s, statistic, dt_s in _judged(monitor, flight):
        number = np.floor(t_s / block_s).astype(np.int64)
        for one in np.unique(number):
            inside = statistic[number == one]
            if one == 0 or len(inside) * dt_s >= block_s / 2:
                maxima.append(float(inside.max()))
        judged_s += float(t_s[-1]) + dt_s
    return Scores(np.array(maxima), judged_s, block_s)


def held_out_scores(
    flights: Flights,
    fit: Callable[[Flights], Spec],
    watch: Callable[[Spec], Monitor[Any, Any]],
    block_s: float = BLOCK_S,
) -> Scores:
    """Scores of all flights, each by a fit that did not see it. watch: the monitor of a fit.

    Raises IdentificationError if there is nothing to fit to or no block to score.
    """
    parts = []
    for left_out, rest in folds(flights, block_s):
        monitor = watch(fit(rest))
        parts += [score(monitor, flight, block_s) for flight in left_out]
    maxima = np.concatenate([part.maxima for part in parts]) if parts else np.empty(0)
    if len(maxima) == 0:
        raise IdentificationError("the healthy flights are too short to score the statistic on; fly longer")
    return Scores(maxima, sum(part.judged_s for part in parts), block_s)


def folds(flights: Flights, block_s: float = BLOCK_S) -> Iterator[tuple[Flights, Flights]]:
    """Pairs of what is left out and the rest: of flights, or of the pieces of a single one."""
    if len(flights) == 1:
        yield from _pieces(flights[0], block_s)
        return
    count = min(MAX_FOLDS, len(flights))
    for fold in range(count):
        left_out = [flight for i, flight in enumerate(flights) if i % count == fold]
        yield left_out, [flight for i, flight in enumerate(flights) if i % count != fold]


def _judged(monitor: Monitor[Any, Any], flight: Sequence[Rows]) -> Iterator[tuple[FloatArray, FloatArray, float]]:
    """For each segment: time since its first valid row [s] and statistic of the judged rows, and their period."""
    state, last = monitor.start(), -1
    first_ns: dict[int, int] = {}
    times: dict[int, list[IntArray]] = {}
    values: dict[int, list[FloatArray]] = {}
    for rows in flight:
        state = state if rows.block.segment == last else monitor.start()
        last = rows.block.segment
        state, reading = monitor.step(state, rows)
        segment, valid = rows.block.segment, rows.block.valid
        if segment not in first_ns and valid.any():
            first_ns[segment] = int(rows.block.t_ns[np.argmax(valid)])
        times.setdefault(segment, []).append(reading.t_ns[reading.valid])
        values.setdefault(segment, []).append(reading.value[reading.valid])
    for segment, start_ns in first_ns.items():
        t_ns = np.concatenate(times[segment])
        if len(t_ns):
            # a monitor may speak more seldom than there are rows: what counts is the time that its readings stand for
            period_s = float(np.median(np.diff(t_ns))) / NS_PER_S if len(t_ns) > 1 else flight[0].block.dt_s
            yield (t_ns - start_ns) / NS_PER_S, np.concatenate(values[segment]), period_s


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
        rates = _cut_rates(rows.rates, low_ns, high_ns, segment)
        if stop > first or len(rates):
            out.append(Rows(rows.block.rows(first, stop, segment), rates))
    return out


def _cut_rates(rates: RateBlock, low_ns: int, high_ns: int, segment: int) -> RateBlock:
    kept = slice(*np.searchsorted(rates.t_ns, [low_ns, high_ns]).tolist())
    return RateBlock(
        segment,
        rates.dt_s,
        rates.t_ns[kept],
        rates.u[kept],
        rates.y[kept],
        rates.valid[kept],
        rates.commanded[kept],
    )
