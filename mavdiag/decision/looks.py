"""One slot's values cut at the times at which the decision looks at them."""

import itertools
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.units import NS_PER_S

__all__ = ["MANY", "Looks", "Reading", "Waiting", "cut", "known_from"]

NAN = float("nan")
MANY = 4  # looks from which on it is quicker to take them all at once


_Found: TypeAlias = tuple[list[float] | FloatArray, list[int] | IntArray]


@dataclass(frozen=True, slots=True)
class Reading:
    """A slot's latest look that had a valid value.

    t_ns: when it was known.
    ratio: highest statistic over threshold in the look.
    value: the last statistic in it.
    rotors: the last evidence for each rotor; empty if the slot has none.
    """

    t_ns: int
    ratio: float
    value: float
    rotors: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Waiting:
    """Values of one chunk that were not all looked at yet.

    values: all of the chunk.
    ratio: (n,) statistic over threshold, -1 where it is not valid.
    first: the first that was not looked at.
    """

    values: Statistic
    ratio: FloatArray
    first: int = 0

    @classmethod
    def of(cls, values: Statistic, threshold: float) -> "Waiting":
        """A chunk of which nothing was looked at."""
        ratio = values.value / threshold
        return cls(
            values, ratio if np.count_nonzero(values.valid) == len(ratio) else np.where(values.valid, ratio, -1.0)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Looks:
    """The values of each look, and what waits for a later one.

    times: of the looks [ns].
    chunks: where they lie; at: of each chunk the (looks + 1,) rows where the looks begin and end.
    highest: of each look the highest ratio, -1 if no value is valid, nan if there is none.
    chunk, row: of each look the chunk and the row of its last valid value; row is -1 if there is none.
    """

    times: Sequence[int]
    chunks: tuple[Waiting, ...]
    rest: tuple[Waiting, ...]
    at: list[Sequence[int]]
    highest: list[float] | FloatArray
    chunk: list[int]
    row: list[int] | IntArray

    def reading(self, number: int) -> Reading | None:
        """What a look gave, None if no value is valid."""
        row, ratio = int(self.row[number]), float(self.highest[number])
        if row < 0 or not ratio >= 0:
            return None
        values = self.chunks[self.chunk[number]].values
        rotors = tuple(values.rotors[row].tolist()) if len(values.rotors) else ()
        return Reading(self.times[number], ratio, values.value.item(row), rotors)

    def part(self, number: int) -> Statistic | None:
        """The values of a look, None if it has none."""
        cuts = [(one.values, at[number], at[number + 1]) for one, at in zip(self.chunks, self.at, strict=True)]
        parts = [values.part(first, stop) for values, first, stop in cuts if first < stop]
        return None if not parts else parts[0] if len(parts) == 1 else _joined(parts)


def known_from(waiting: Sequence[Waiting], delay_s: float) -> int | None:
    """When the first of these values was known [ns]; None if there are none."""
    if not waiting:
        return None
    return int(waiting[0].values.t_ns[waiting[0].first]) + round(delay_s * NS_PER_S)


def cut(waiting: Sequence[Waiting], delay_s: float, looks: IntArray) -> Looks:
    """Cut values at these times [ns]. delay_s: how much later than its time stamp a value is known."""
    t_ns, times = looks - round(delay_s * NS_PER_S), looks.tolist()
    at, rest, found = list[Sequence[int]](), list[Waiting](), list[tuple[int, _Found]]()
    for number, one in enumerate(waiting):
        stops = one.values.t_ns.searchsorted(t_ns, side="right")
        edges = [one.first, *stops.tolist()]
        at.append(edges)
        stop = edges[-1]
        if stop < len(one.ratio):
            rest.append(one if stop == one.first else Waiting(one.values, one.ratio, stop))
        if edges[0] < stop:
            found.append((number, _few(one, edges) if len(times) < MANY else _many(one, stops)))
    if not found:
        nothing = [-1] * len(times)
        return Looks(times, tuple(waiting), tuple(rest), at, [NAN] * len(times), nothing, nothing)
    newest, (highest, row) = found[-1]
    chunk = [newest] * len(times)
    for number, (tops, rows) in found[-2::-1]:  # of an older chunk only the first looks hold something
        for k in range(bisect_left(at[number], at[number][-1])):
            if highest[k] != highest[k] or tops[k] > highest[k]:  # the first is nan
                highest[k] = tops[k]
            if row[k] < 0:
                chunk[k], row[k] = number, rows[k]
    return Looks(times, tuple(waiting), tuple(rest), at, highest, chunk, row)


def _few(one: Waiting, edges: Sequence[int]) -> _Found:
    """The highest ratio of each look, nan for none, and the row of its last valid value, -1 for none."""
    tops, rows = list[float](), list[int]()
    for first, stop in itertools.pairwise(edges):
        tops.append(float(np.maximum.reduce(one.ratio[first:stop])) if first < stop else NAN)
        row = stop - 1 if first < stop else -1
        if row >= 0 and not one.values.valid[row]:
            good = np.flatnonzero(one.values.valid[first:row])
            row = first + int(good[-1]) if len(good) else -1
        rows.append(row)
    return tops, rows


def _many(one: Waiting, stops: IntArray) -> _Found:
    """The same for many looks at once. stops: (looks,) rows where they end."""
    starts = np.concatenate(([one.first], stops[:-1]))
    some = stops > starts
    tops = np.full(len(stops), NAN)
    tops[some] = np.maximum.reduceat(one.ratio[: stops[-1]], starts[some])
    rows, valid = stops - 1, one.values.valid[: stops[-1]]
    if np.count_nonzero(valid) < len(valid):
        rows = np.maximum.accumulate(np.where(valid, np.arange(len(valid)), -1))[np.maximum(rows, 0)]
    return tops, np.where(some & (rows >= starts), rows, -1)


def _joined(parts: Sequence[Statistic]) -> Statistic:
    names = ("t_ns", "value", "valid", "level", "signal", "rotors")
    columns = {name: np.concatenate([getattr(one, name) for one in parts]) for name in names}
    return Statistic(period_s=parts[0].period_s, **columns)
