"""How long a slot judged, and why it did not; how much of the flight any of several slots judged."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from mavdiag.rows.block import Block
from mavdiag.rows.conditions import Condition
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import BoolArray, IntArray, Signal
from mavdiag.thresholds.envelope import Outside
from mavdiag.units import NS_PER_S

__all__ = ["WAITING", "Account", "Coverage", "Stretch", "reason_of"]

LATE_S = 1.0  # by so much a value may come after the rows of its time: half a filter's window at most (our choice)
WAITING = "waiting for enough unbroken flight"  # why a monitor does not judge although its signals are known


def reason_of(missing: str) -> str:
    """What is said of a signal that is unknown; a doubt of the gyro is said as it is."""
    return f"no {missing.replace('_', ' ')}" if missing in tuple(Signal) else missing


@dataclass(frozen=True, slots=True)
class Account:
    """How long a slot judged, and why it did not.

    flight_s: flight time so far.
    judged_s: time that its valid values stand for.
    peak: highest valid statistic; None if there was none.
    missing: flight time with a valid gyro in which what it takes of a signal was unknown, by signal; and flight time
        in which the gyro is there but must not be judged, by the reason (`rows.quality.Doubt`) [s].
    outside: time that it did not judge because a condition was outside of the envelope, and how far that was.
    """

    flight_s: float = 0.0
    judged_s: float = 0.0
    peak: float | None = None
    missing: Mapping[str, float] = field(default_factory=dict)
    outside: Mapping[Condition, Outside] = field(default_factory=dict)

    @property
    def outside_s(self) -> float:
        """Time outside of the envelope [s]."""
        return sum((one.span_s for one in self.outside.values()), 0.0)

    @property
    def not_judged(self) -> Mapping[str, float]:
        """Reasons with their seconds: a signal that is unknown, or waiting for unbroken flight."""
        found: dict[str, float] = {}
        idle_s = max(0.0, self.flight_s - self.judged_s - self.outside_s)
        for signal, span_s in self.missing.items():
            found[reason_of(signal)] = min(span_s, max(0.0, idle_s))
            idle_s -= span_s
        return {**found, WAITING: idle_s} if idle_s > 0 else found

    def add(
        self, found: Statistic, flight_s: float, missing: Mapping[str, float], outside: Mapping[Condition, Outside]
    ) -> "Account":
        """The account after the next rows."""
        beside, lacking = self.outside, self.missing
        if outside:
            beside = dict(beside)
            for condition, one in outside.items():
                beside[condition] = beside[condition].plus(one) if condition in beside else one
        if missing:
            lacking = {**lacking, **{signal: lacking.get(signal, 0.0) + span_s for signal, span_s in missing.items()}}
        count, peak = int(np.count_nonzero(found.valid)), self.peak
        if count:
            highest = float(np.maximum.reduce(found.value if count == len(found) else found.value[found.valid]))
            peak = highest if peak is None else max(peak, highest)
        return Account(self.flight_s + flight_s, self.judged_s + count * found.period_s, peak, lacking, beside)


Stretch: TypeAlias = tuple[int, int]
"""First and last row of a part of a flight [ns]."""


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """How much of the flown time was judged: a row was, if it lies in the window of a valid value of any slot.

    A valid value at t with a window of w seconds has judged the rows after t - w, as far as the slot knew its signals
    there. Rows of a take-off are not counted.

    dt_s: of a row.
    flown, judged: rows so far.
    open_ns: (n,) rows that later values may still reach back to.
    able: (slots, n) whether a slot knew all its signals in them.
    unjudged: the stretches that nothing can reach any more, in order of time.
    """

    dt_s: float = 0.0
    flown: int = 0
    judged: int = 0
    open_ns: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    able: BoolArray = field(default_factory=lambda: np.empty((0, 0), dtype=np.bool_))
    unjudged: tuple[Stretch, ...] = ()

    @property
    def flown_s(self) -> float:
        """Flown time so far [s]."""
        return self.flown * self.dt_s

    @property
    def judged_s(self) -> float:
        """How much of it was judged [s]."""
        return self.judged * self.dt_s

    def add(self, block: Block, able: BoolArray, values: Sequence[Statistic], reach_s: Sequence[float]) -> "Coverage":
        """After the next rows. able: (slots, rows). values, reach_s: of each slot, and the length of its window."""
        first = int(block.t_ns.searchsorted(block.settled_ns))
        fresh, able = block.t_ns[first:], able[:, first:]
        if len(self.open_ns):
            fresh, able = np.concatenate((self.open_ns, fresh)), np.concatenate((self.able, able), axis=1)
        covered = np.zeros(len(fresh), dtype=np.bool_)
        for known, found, window_s in zip(able, values, reach_s, strict=True):
            whole = np.count_nonzero(found.valid) == len(found)
            at_ns = found.t_ns if whole else found.t_ns[found.valid]
            if len(at_ns) and len(fresh):
                following = at_ns.take(at_ns.searchsorted(fresh), mode="clip") - fresh
                covered |= known & (following >= 0) & (following < window_s * NS_PER_S)
        counts = self.flown + len(block) - first, self.judged + int(np.count_nonzero(covered))
        fresh, able = fresh[~covered], able[:, ~covered]
        late_ns = int(block.t_ns[-1]) - round((max(reach_s, default=0.0) + LATE_S) * NS_PER_S)
        gone = int(fresh.searchsorted(late_ns))
        unjudged = _joined(self.unjudged, fresh[:gone], block.dt_s)
        return Coverage(block.dt_s, *counts, fresh[gone:], able[:, gone:], unjudged)

    def closed(self) -> "Coverage":
        """At a border: no value reaches back over it."""
        if not len(self.open_ns):
            return self
        return Coverage(self.dt_s, self.flown, self.judged, unjudged=_joined(self.unjudged, self.open_ns, self.dt_s))


def _joined(stretches: tuple[Stretch, ...], rows_ns: IntArray, dt_s: float) -> tuple[Stretch, ...]:
    """With the stretches of further rows that were not judged."""
    if len(rows_ns) == 0:
        return stretches
    most_ns = 1.5 * dt_s * NS_PER_S  # between two rows that follow each other
    edges = np.flatnonzero(np.diff(rows_ns) > most_ns)
    firsts, lasts = rows_ns[np.append(0, edges + 1)], rows_ns[np.append(edges, len(rows_ns) - 1)]
    fresh: list[Stretch] = list(zip(firsts.tolist(), lasts.tolist(), strict=True))
    if stretches and fresh[0][0] - stretches[-1][1] <= most_ns:
        fresh[0] = (stretches[-1][0], fresh[0][1])
        stretches = stretches[:-1]
    return (*stretches, *fresh)
