"""One slot's values cut at the times at which the decision looks at them."""

from collections.abc import Sequence
from dataclasses import dataclass

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
        return cls(values, ratio if np.count_nonzero(values.valid) == len(ratio) else np.where(values.valid, ratio, -1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Looks:
    """The values of each look, as they lie in their chunks, and what waits for a later one.

    at: of each chunk the (looks + 1,) rows where the looks begin and end.
    """

    chunks: tuple[Waiting, ...]
    rest: tuple[Waiting, ...]
    at: list[list[int]]

    def part(self, number: int) -> Statistic | None:
        """The values of a look, None if it has none."""
        parts = [one.values.part(first, stop) for one, first, stop in self._spans(number)]
        return None if not parts else parts[0] if len(parts) == 1 else _joined(parts)

    def reading(self, number: int, t_ns: int) -> tuple[float | None, Reading | None]:
        """The highest ratio of a look, -1 if no value is valid, None if there is none; and what it gave, if valid."""
        spans = self._spans(number)
        if not spans:
            return None, None
        ratio = max([float(np.maximum.reduce(one.ratio[first:stop])) for one, first, stop in spans])
        return ratio, None if ratio < 0 else self._latest(spans, t_ns, ratio)

    @staticmethod
    def _latest(spans: Sequence[tuple[Waiting, int, int]], t_ns: int, ratio: float) -> Reading | None:
        for one, first, stop in reversed(spans):
            values, last = one.values, stop - 1
            if not values.valid[last]:
                good = np.flatnonzero(values.valid[first:stop])
                if len(good) == 0:
                    continue
                last = first + int(good[-1])
            rotors = tuple(values.rotors[last].tolist()) if len(values.rotors) else ()
            return Reading(t_ns, ratio, float(values.value[last]), rotors)
        return None

    def _spans(self, number: int) -> list[tuple[Waiting, int, int]]:
        """The chunks of a look that hold some of it, with the rows."""
        cuts = [(one, at[number], at[number + 1]) for one, at in zip(self.chunks, self.at, strict=True)]
        return [one for one in cuts if one[1] < one[2]]


def known_from(waiting: Sequence[Waiting], delay_s: float) -> int | None:
    """When the first of these values was known [ns]; None if there are none."""
    if not waiting:
        return None
    return int(waiting[0].values.t_ns[waiting[0].first]) + round(delay_s * NS_PER_S)


def cut(waiting: Sequence[Waiting], delay_s: float, looks: IntArray) -> Looks:
    """Cut values at these times. delay_s: how much later than its time stamp a value is known."""
    t_ns = looks - round(delay_s * NS_PER_S)
    at = [[one.first, *one.values.t_ns.searchsorted(t_ns, side="right").tolist()] for one in waiting]
    rest = tuple(
        one if stops[-1] == one.first else Waiting(one.values, one.ratio, stops[-1])
        for one, stops in zip(waiting, at, strict=True)
        if stops[-1] < len(one.ratio)
    )
    return Looks(tuple(waiting), rest, at)


def _joined(parts: Sequence[Statistic]) -> Statistic:
    names = ("t_ns", "value", "valid", "level", "signal", "rotors")
    columns = {name: np.concatenate([getattr(one, name) for one in parts]) for name in names}
    return Statistic(period_s=parts[0].period_s, **columns)
