"""One slot's values cut at the times at which the decision looks at them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

__all__ = ["Looks", "Reading", "cut", "known_from"]


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
class Looks:
    """All values up to the last look, None if there are none, and those that wait for a later one.

    at: (looks + 1,) where each look begins and ends.
    ratio: (n,) statistic over threshold, -1 where it is not valid.
    """

    values: Statistic | None
    rest: tuple[Statistic, ...]
    at: list[int]
    ratio: FloatArray

    def part(self, number: int) -> Statistic | None:
        """The values of a look, None if it has none."""
        first, stop = self.at[number], self.at[number + 1]
        return None if self.values is None or first == stop else self.values.part(first, stop)

    def highest(self, number: int) -> float | None:
        """The highest ratio of a look: -1 if no value is valid, None if there is none."""
        first, stop = self.at[number], self.at[number + 1]
        return None if first == stop else float(self.ratio[first:stop].max())

    def reading(self, number: int, t_ns: int) -> Reading | None:
        """What a look gave; None if no value is valid."""
        ratio, values = self.highest(number), self.values
        if values is None or ratio is None or ratio < 0:
            return None
        first, stop = self.at[number], self.at[number + 1]
        last = first + int(np.flatnonzero(values.valid[first:stop])[-1])
        rotors = tuple(values.rotors[last].tolist()) if len(values.rotors) else ()
        return Reading(t_ns, ratio, float(values.value[last]), rotors)


def known_from(waiting: Sequence[Statistic], delay_s: float) -> int | None:
    """When the first of these values was known [ns]; None if there are none."""
    return None if not waiting else int(waiting[0].t_ns[0]) + round(delay_s * NS_PER_S)


def cut(waiting: Sequence[Statistic], delay_s: float, threshold: float, looks: Sequence[int]) -> Looks:
    """Cut values at these times. delay_s: how much later than its time stamp a value is known."""
    if not waiting:
        return Looks(None, (), [0] * (len(looks) + 1), np.empty(0))
    values = waiting[0] if len(waiting) == 1 else _joined(waiting)
    known_ns = values.t_ns + round(delay_s * NS_PER_S)
    at = [0, *np.searchsorted(known_ns, looks, side="right").tolist()]
    rest = (values.part(at[-1], len(values)),) if at[-1] < len(values) else ()
    values = values.part(0, at[-1]) if rest else values
    return Looks(values, rest, at, np.where(values.valid, values.value / threshold, -1.0))


def _joined(waiting: Sequence[Statistic]) -> Statistic:
    names = ("t_ns", "value", "valid", "level", "signal", "rotors")
    columns = {name: np.concatenate([getattr(one, name) for one in waiting]) for name in names}
    return Statistic(period_s=waiting[0].period_s, **columns)
