"""How high the ratios of a moment are, and which looks may be passed over because nothing can happen at them.

A look at which no ratio is over its threshold, no event is open, and whose height leaves the stage as it is, changes
nothing but the latest readings. In healthy flight nearly all looks are such, so a chunk's heights are found at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from mavdiag.decision.diagnosis import Stage
from mavdiag.decision.looks import Looks, Reading
from mavdiag.telemetry import BoolArray, FloatArray, IntArray
from mavdiag.units import NS_PER_S

__all__ = ["CALM_BELOW", "RAISED_FROM", "STALE_NS", "Ahead", "Height", "height_of", "look_ahead"]

CALM_BELOW, RAISED_FROM = 0.7, 0.8  # of the threshold (our choice); one emulated flight in 62 healthy h was suspected
STALE_NS = NS_PER_S  # a slot whose last valid value is older does not count (our choice)
NEVER_NS = -(2**62)


class Height(IntEnum):
    """How high the highest ratio is. SETTLED: calm for 2 s. UNKNOWN: nothing judged."""

    UNKNOWN = -1
    SETTLED = 0
    CALM = 1
    HELD = 2
    RAISED = 3
    OVER = 4


LEFT_ALONE: dict[Stage, tuple[Height, ...]] = {
    Stage.NOT_JUDGED: (Height.UNKNOWN,),
    Stage.QUIET: (Height.CALM, Height.HELD),
    Stage.SUSPECTED: (Height.HELD, Height.RAISED),
    Stage.INSPECT: (Height.UNKNOWN, Height.CALM, Height.HELD, Height.RAISED),
}
"""Heights that leave a stage as it is, whatever came before them; a fault is looked at every time it is seen."""


def height_of(ratio: float, decides: bool) -> Height:
    """The height of one slot's ratio."""
    if not decides:
        return Height.RAISED if ratio > 1.0 else Height.CALM
    if ratio > 1.0:
        return Height.OVER
    if ratio >= RAISED_FROM:
        return Height.RAISED
    return Height.HELD if ratio >= CALM_BELOW else Height.CALM


@dataclass(frozen=True, slots=True, eq=False)
class Ahead:
    """What the looks of a chunk will read.

    parts, before: of each slot its looks, and its latest reading before them.
    from_look: (slots, looks) the look of the latest reading, -1 where it is the one before.
    heights: (looks,) height of each look.
    stops: of each stage the looks at which something may happen, (n,).
    """

    parts: Sequence[Looks]
    before: Sequence[Reading | None]
    from_look: IntArray
    heights: IntArray
    stops: dict[Stage, IntArray]

    def until(self, stage: Stage, number: int) -> int:
        """The first look from `number` on at which something may happen while the stage is that."""
        stops = self.stops.get(stage)
        if stops is None:
            return number
        at = int(stops.searchsorted(number))
        return int(stops[at]) if at < len(stops) else len(self.heights)

    def latest(self, number: int) -> tuple[Reading | None, ...]:
        """The latest reading of each slot after a look."""
        looks = self.from_look[:, number].tolist()
        return tuple(
            old if look < 0 else one.reading(look)
            for one, old, look in zip(self.parts, self.before, looks, strict=True)
        )

    def calm_ns(self, first: int, stop: int, since_ns: int | None) -> int | None:
        """Since when all is calm after the looks [first, stop). since_ns: the same before them."""
        other = np.flatnonzero(self.heights[first:stop] != Height.CALM)
        begun = first + int(other[-1]) + 1 if len(other) else first
        if begun == stop:
            return None
        return since_ns if begun == first and since_ns is not None else self.parts[0].times[begun]


def look_ahead(parts: Sequence[Looks], before: Sequence[Reading | None], decides: Sequence[bool]) -> Ahead:
    """Find the heights of all looks. decides: whether each slot does."""
    times = np.array(parts[0].times)
    tops = np.array([one.highest for one in parts])
    numbers = np.arange(len(times))
    from_look = np.maximum.accumulate(np.where(tops >= 0, numbers, -1), axis=1)
    old_ns = np.array([NEVER_NS if one is None else one.t_ns for one in before])
    old_ratio = np.array([0.0 if one is None else one.ratio for one in before])
    there, at = from_look >= 0, np.maximum(from_look, 0)
    read_ns = np.where(there, times[at], old_ns[:, None])
    ratio: FloatArray = np.where(there, np.take_along_axis(tops, at, axis=1), old_ratio[:, None])
    fresh: BoolArray = times - read_ns <= STALE_NS
    heights = np.where(fresh, _heights(ratio, np.array(decides)[:, None]), Height.UNKNOWN).max(axis=0)
    heights[~fresh[np.array(decides)].any(axis=0)] = Height.UNKNOWN
    busy = (tops > 1.0).any(axis=0)
    stops = {
        stage: np.flatnonzero(busy | np.logical_and.reduce([heights != one for one in alone], axis=0))
        for stage, alone in LEFT_ALONE.items()
        if alone
    }
    return Ahead(parts, before, from_look, heights, stops)


def _heights(ratio: FloatArray, decides: BoolArray) -> IntArray:
    """`height_of` of arrays."""
    levels = np.where(ratio >= RAISED_FROM, Height.RAISED, np.where(ratio >= CALM_BELOW, Height.HELD, Height.CALM))
    deciding = np.where(ratio > 1.0, Height.OVER, levels)
    return np.where(decides, deciding, np.where(ratio > 1.0, Height.RAISED, Height.CALM))
