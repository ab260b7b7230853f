"""One slot's values cut at the times at which the decision looks at them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.units import NS_PER_S

__all__ = ["Looks", "Reading", "Waiting", "cut", "known_from"]


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

    chunks: where they lie; at: of each chunk the (looks + 1,) rows where the looks begin and end.
    highest: of each look the highest ratio, -1 if no value is valid, None if there is none.
    readings: of each look what it gave, None if no value is valid.
    """

    chunks: tuple[Waiting, ...]
    rest: tuple[Waiting, ...]
    at: list[list[int]]
    highest: list[float | None]
    readings: list[Reading | None]

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
    at, rest = list[list[int]](), list[Waiting]()
    highest: list[float | None] = [None] * len(times)
    readings: list[Reading | None] = [None] * len(times)
    for one in waiting:
        edges = [one.first, *one.values.t_ns.searchsorted(t_ns, side="right").tolist()]
        at.append(edges)
        stop = edges[-1]
        if stop < len(one.ratio):
            rest.append(one if stop == one.first else Waiting(one.values, one.ratio, stop))
        if edges[0] < stop:
            _look(one, edges, times, highest, readings)
    return Looks(tuple(waiting), tuple(rest), at, highest, readings)


def _look(
    one: Waiting,
    edges: Sequence[int],
    times: Sequence[int],
    highest: list[float | None],
    readings: list[Reading | None],
) -> None:
    """Add one chunk's values to the looks that hold some of them."""
    values, valid = one.values, one.values.valid
    for k, t_ns in enumerate(times):
        if edges[k] == edges[k + 1]:
            continue
        ratio = float(np.maximum.reduce(one.ratio[edges[k] : edges[k + 1]]))
        before = highest[k]
        highest[k] = top = ratio if before is None else max(before, ratio)
        last = edges[k + 1] - 1
        if top < 0:
            continue
        if not valid[last]:
            good = np.flatnonzero(valid[edges[k] : last])
            if len(good) == 0:
                held = readings[k]
                readings[k] = None if held is None else replace(held, ratio=top)
                continue
            last = edges[k] + int(good[-1])
        rotors = tuple(values.rotors[last].tolist()) if len(values.rotors) else ()
        readings[k] = Reading(t_ns, top, values.value.item(last), rotors)


def _joined(parts: Sequence[Statistic]) -> Statistic:
    names = ("t_ns", "value", "valid", "level", "signal", "rotors")
    columns = {name: np.concatenate([getattr(one, name) for one in parts]) for name in names}
    return Statistic(period_s=parts[0].period_s, **columns)
