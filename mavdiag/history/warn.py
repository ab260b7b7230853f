"""What is found of an airframe: which flights may be compared, where each statistic is heading, and when to warn. Pure.

A trend does not go on over new propellers, a repair or another baseline: there a new stretch of flights begins. With a
the present level, b its growth a flight, r the level of the stretch's first flights (all shares of the threshold,
`trend`), a statistic is warned of if it is so at each of the last three flights that it judged:

    a + b HORIZON >= 1                    the line reaches the threshold within the horizon,
    (a - r)/(1 - r) >= PROGRESS           most of the way from the first flights to the threshold is gone,
    a - r >= GROWN s                      and that is more than the scatter of a session,
    q - r >= HALF (1 - r)                 and so is the median q of the last ten flights, in part.

A warning stands until the level falls back below KEPT of the way. **Its price** (benchmarks/history_wear.py): less
than 1 in 100 healthy airframes is warned of in 200 flights. Wear that jumps over its last fifth comes without a
warning, and wear that slows down is warned of early.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mavdiag.archive.figures import FlightRecord
from mavdiag.archive.together import Reference, Together, together
from mavdiag.baseline import SESSION_GAP_NS
from mavdiag.history.trend import Change, Trend, changes_of, sessions_of, trend_of
from mavdiag.judging import Verdict
from mavdiag.monitors import BY_NAME
from mavdiag.monitors.base import FaultKind
from mavdiag.telemetry import Axis, FloatArray, IntArray

HORIZON = 40.0  # flights ahead
PROGRESS = 0.8  # share of the way that must be gone
GROWN = 1.5  # scatters of a session
FIRST = 20  # flights at the beginning of a stretch whose median is its first level
CONFIRMED = 3  # flights that must agree
HALF, RECENT = 0.5, 10  # share of the way that the median of so many flights must have gone
KEPT = 0.6  # share of the way below which the level must fall back for a warning to be over
FEW = 10  # flights at either end of a stretch whose medians are compared (our choice)
SURE = 3.0  # standard errors of the level from which it is called grown (our choice)
STEPS = ("trim_step",)  # shows what happens within a flight; wear does not raise it
NEW_BASELINE = "new baseline"
WATCHED = tuple(name for name, monitor in BY_NAME.items() if monitor.kind is FaultKind.PROPELLER and name not in STEPS)
"""The monitors whose trend is watched: those of propellers."""


class MarkKind(StrEnum):
    """What was done to an airframe between flights. No trend goes on over it."""

    NEW_PROPELLERS = "new propellers"
    REPAIR = "repair"


@dataclass(frozen=True, slots=True)
class Mark:
    """A maintenance mark. t_ns: when it was done, unix epoch [ns]."""

    airframe: str
    t_ns: int
    kind: MarkKind
    note: str = ""

    def __str__(self) -> str:
        return f"{self.kind}: {self.note}" if self.note else self.kind


@dataclass(frozen=True, slots=True)
class Stretch:
    """Flights that one baseline judged, with no mark between them. first: number in the history, from 1; began: why."""

    first: int
    began: str
    flights: tuple[FlightRecord, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One statistic over the n flights of a stretch. threshold: the highest that judged any of them.

    session: (n,) of the flight in its stretch; flights within an hour are of one session.
    peak: (n,) of the statistic; NaN where it was not judged.
    """

    monitor: str
    axis: Axis | None
    unit: str
    threshold: float
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


class Outlook(StrEnum):
    """What the trend of a statistic says."""

    TOO_FEW = "too few flights for a trend"
    STEADY = "not grown since the first flights"
    GROWN = "grown since the first flights"
    WARNING = "reaches the threshold soon"
    REACHED = "has reached the threshold"


WARNS = (Outlook.WARNING, Outlook.REACHED)
"""The outlooks that ask for action."""


@dataclass(frozen=True, slots=True)
class Review:
    """What is found of one statistic in one stretch. trend: at the newest flight that it judged.

    warned_at: number of the flight since which it is warned of; None if it is not. changes: where it jumped.
    """

    series: Series
    outlook: Outlook
    trend: Trend | None
    warned_at: int | None
    changes: tuple[Change, ...]


@dataclass(frozen=True, slots=True)
class Overview:
    """One airframe: its flights, what of them may be compared, and what is found in the last stretch, nearest first.

    rotor_growth: rise of each rotor's trim from the first to the last ten flights of the stretch [fraction of hover].
    together: whether a rotor has changed since the last stretch began; None if it cannot be known.
    """

    airframe: str
    flights: tuple[FlightRecord, ...]
    stretches: tuple[Stretch, ...]
    found: tuple[Review, ...]
    rotor_growth: tuple[float, ...]
    together: Together | None = None

    @property
    def warned(self) -> tuple[Review, ...]:
        """The series that reach their threshold soon, or have."""
        return tuple(review for review in self.found if review.outlook in WARNS)

    @property
    def faulty(self) -> bool:
        """Whether the last flight is a fault, and nothing was mended or changed since."""
        last = self.stretches[-1].flights if self.stretches else ()
        return bool(last) and last[-1].verdict is Verdict.FAULT

    @property
    def asks(self) -> bool:
        """Whether it asks for action: a rotor has changed, a statistic is warned of, or the last flight is a fault."""
        return bool(self.warned) or self.faulty or (self.together is not None and self.together.changed)


def stretches_of(flights: Sequence[FlightRecord], marks: Sequence[Mark]) -> tuple[Stretch, ...]:
    """Cut a history at marks and changes of the baseline; after a mark newer than all flights the last one is empty."""
    found, begin, why = list[Stretch](), 0, ""
    for place, before in enumerate(flights, 1):
        after = flights[place] if place < len(flights) else None
        until_ns = np.inf if after is None else after.t_ns
        marked = dict.fromkeys(str(mark) for mark in marks if before.t_ns < mark.t_ns <= until_ns)
        other = after is not None and after.baseline != before.baseline
        reason = ", ".join(marked) or (NEW_BASELINE if other else "")
        if reason or after is None:
            found.append(Stretch(begin + 1, why, tuple(flights[begin:place])))
            begin, why = place, reason
    return (*found, Stretch(begin + 1, why, ())) if why else tuple(found)


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
            found.append(Series(*key, there[-1].unit, threshold, session, peak))
    return tuple(found)


def overview_of(
    airframe: str, flights: Sequence[FlightRecord], marks: Sequence[Mark], references: Sequence[Reference] = ()
) -> Overview:
    """What is found of an airframe. flights, marks: all of it, in order of time. references: of their baselines."""
    stretches = stretches_of(flights, marks)
    present = stretches[-1] if stretches else None
    found = [review(series) for series in series_of(present)] if present else []
    found.sort(key=lambda found: -1.0 if found.trend is None else found.trend.level, reverse=True)
    growth, said = _rotor_growth(present), _said(present, references)
    return Overview(airframe, tuple(flights), stretches, tuple(found), growth, said)


def _said(stretch: Stretch | None, references: Sequence[Reference]) -> Together | None:
    if stretch is None or not stretch.flights:
        return None
    taught = next((one for one in references if one.baseline == stretch.flights[0].baseline), None)
    marked = stretch.began not in ("", NEW_BASELINE)
    found = taught and together(taught, stretch.flights, new_propellers=marked)
    return found if found and found.evidence else None


def review(series: Series) -> Review:
    """Trend, outlook and change points of a series as it stands."""
    share = series.share
    judged = np.flatnonzero(np.isfinite(share))
    changes = changes_of(sessions_of(series.session, share))
    trend = _trend_at(series, share, int(judged[-1])) if len(judged) >= CONFIRMED else None
    first = _first_level(share)
    if trend is None or first is None or len(share) < FIRST:
        return Review(series, Outlook.TOO_FEW, None, None, changes)
    since, grown = warned_at(series), trend.level - first
    error = float(np.hypot(np.sqrt(trend.level_variance), trend.scale / np.sqrt(FIRST / 2)))
    outlook = Outlook.GROWN if grown > SURE * error else Outlook.STEADY
    if trend.level >= 1.0:
        outlook = Outlook.REACHED
    elif since is not None and grown >= KEPT * (1.0 - first):
        outlook = Outlook.WARNING
    return Review(series, outlook, trend, since if outlook in WARNS else None, changes)


def warned_at(series: Series) -> int | None:
    """Number of the first flight after which the series was warned of; None if it never was."""
    share, row = series.share, 0
    first = _first_level(share)
    if first is None:
        return None
    judged = np.flatnonzero(np.isfinite(share))
    for place, at in enumerate(judged.tolist()):
        middle = float(np.median(share[judged[max(place + 1 - RECENT, 0) : place + 1]]))
        far = at + 1 < FIRST or middle - first < HALF * (1.0 - first)
        row = 0 if far or not _is_near(_trend_at(series, share, at), first) else row + 1
        if row >= CONFIRMED:
            return at + 1
    return None


def _first_level(share: FloatArray) -> float | None:
    known = share[:FIRST][np.isfinite(share[:FIRST])]
    return float(np.median(known)) if len(known) else None


def _is_near(trend: Trend | None, first: float) -> bool:
    if trend is None or trend.level + trend.slope * HORIZON < 1.0:
        return False
    return trend.level - first >= max(PROGRESS * (1.0 - first), GROWN * trend.scale)


def _trend_at(series: Series, share: FloatArray, at: int) -> Trend | None:
    return trend_of(sessions_of(series.session[: at + 1], share[: at + 1]), at + 1.0)


def _rotor_growth(stretch: Stretch | None) -> tuple[float, ...]:
    known = [flight.rotor_trim for flight in stretch.flights if flight.rotor_trim] if stretch else []
    if len(known) < 2 or len({len(trim) for trim in known}) != 1:
        return ()
    trims, count = np.array(known), min(FEW, len(known) // 2)
    growth: list[float] = (np.median(trims[-count:], axis=0) - np.median(trims[:count], axis=0)).tolist()
    return tuple(growth)
