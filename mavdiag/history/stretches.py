"""From records and marks to series: what of an airframe's flights may be compared, and how near each came. Pure.

A trend does not go on over new propellers, a repair or another baseline: there a new stretch begins.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np

from mavdiag.archive.figures import FlightRecord
from mavdiag.baseline import SESSION_GAP_NS
from mavdiag.monitors import BY_NAME
from mavdiag.monitors.base import FaultKind
from mavdiag.telemetry import Axis, FloatArray, IntArray

STEPS = ("trim_step",)  # shows what happens within a flight; wear does not raise it
WATCHED = tuple(name for name, monitor in BY_NAME.items() if monitor.kind is FaultKind.PROPELLER and name not in STEPS)
"""The monitors whose trend is watched: those of propellers."""


class MarkKind(StrEnum):
    """What was done to an airframe between flights. No trend goes on over it."""

    NEW_PROPELLERS = "new propellers"
    REPAIR = "repair"


@dataclass(frozen=True, slots=True)
class Mark:
    """A maintenance mark. t_ns: when it was done, unix epoch [ns]. note: what else there is to say."""

    airframe: str
    t_ns: int
    kind: MarkKind
    note: str = ""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Flights that one baseline judged, with no mark between them, in order of time.

    first: number of the first one in the whole history, from 1. began: why it begins; empty for the first stretch.
    """

    first: int
    began: str
    flights: tuple[FlightRecord, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One statistic over the n flights of a stretch.

    monitor, axis, unit: as in `SlotFigures`.
    threshold: the highest that judged any of them: that of a flight on another day than the healthy ones.
    number: (n,) of the flight in its stretch, from 1.
    session: (n,) which session it is of; flights within an hour are of one.
    peak: (n,) of the statistic; NaN where it was not judged.
    """

    monitor: str
    axis: Axis | None
    unit: str
    threshold: float
    number: IntArray
    session: IntArray
    peak: FloatArray

    @property
    def name(self) -> str:
        """Monitor and axis."""
        return self.monitor if self.axis is None else f"{self.monitor} {self.axis}"

    @property
    def share(self) -> FloatArray:
        """(n,) peak over threshold: 1 is the threshold."""
        return self.peak / self.threshold


def stretches_of(flights: Sequence[FlightRecord], marks: Sequence[Mark]) -> tuple[Stretch, ...]:
    """Cut a history, in order of time, at marks and at changes of the baseline.

    After a mark that is newer than all flights the last stretch has none yet.
    """

    def done(after_ns: int, until_ns: int | None) -> str:
        marked = (mark for mark in marks if mark.t_ns > after_ns and (until_ns is None or mark.t_ns <= until_ns))
        return ", ".join(dict.fromkeys(mark.kind.value for mark in marked))

    if not flights:
        return ()
    found: list[Stretch] = []
    begin, why = 0, ""
    for place, (before, after) in enumerate(pairwise(flights), 1):
        if reason := done(before.t_ns, after.t_ns) or ("new baseline" if before.baseline != after.baseline else ""):
            found.append(Stretch(begin + 1, why, tuple(flights[begin:place])))
            begin, why = place, reason
    found.append(Stretch(begin + 1, why, tuple(flights[begin:])))
    later = done(flights[-1].t_ns, None)
    return (*found, Stretch(len(flights) + 1, later, ())) if later else tuple(found)


def series_of(stretch: Stretch) -> tuple[Series, ...]:
    """The series of the watched monitors that judged at least one flight, in the order of the baseline."""
    flights, n = stretch.flights, len(stretch.flights)
    times = np.array([flight.started_ns for flight in flights], dtype=np.int64)
    together = (times[1:] > 0) & (times[:-1] > 0) & (np.diff(times) <= SESSION_GAP_NS)
    session = np.concatenate(([0], np.cumsum(~together))).astype(np.int64)[:n]
    figures = [{(slot.monitor, slot.axis): slot for slot in flight.slots} for flight in flights]
    found = []
    for key in dict.fromkeys(key for slots in figures for key in slots if key[0] in WATCHED):
        there = [slots[key] for slots in figures if key in slots]
        peak = np.array([slots[key].peak if key in slots else None for slots in figures], dtype=np.float64)
        if np.isfinite(peak).any():
            threshold = max(slot.threshold for slot in there)
            found.append(Series(*key, there[-1].unit, threshold, np.arange(1, n + 1), session, peak))
    return tuple(found)
