"""All that is said of one airframe: its stretches, the present trends, and what is to be done. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.history.records import FlightRecord, Mark
from mavdiag.history.stretches import Series, Stretch, series_of, stretches_of
from mavdiag.history.warn import POLICY, WARNS, Policy, Review, review
from mavdiag.judging import Verdict

__all__ = ["Found", "Overview", "overview_of"]

FEW = 10  # flights at either end of a stretch whose medians are compared (our choice)


@dataclass(frozen=True, slots=True)
class Found:
    """A series of the present stretch and what was found of it."""

    series: Series
    review: Review


@dataclass(frozen=True, slots=True)
class Overview:
    """One airframe.

    flights: all of them, in order of time.
    stretches: what of them may be compared; trends are those of the last one.
    found: its series, nearest to the threshold first.
    rotor_growth: by how much each rotor's trim rose from the first ten to the last ten flights of the stretch [fraction
        of hover]; empty if not known.
    """

    airframe: str
    flights: tuple[FlightRecord, ...]
    stretches: tuple[Stretch, ...]
    found: tuple[Found, ...]
    rotor_growth: tuple[float, ...]

    @property
    def warned(self) -> tuple[Found, ...]:
        """The series that reach their threshold soon, or have."""
        return tuple(one for one in self.found if one.review.outlook in WARNS)

    @property
    def faulty(self) -> bool:
        """Whether the last flight is a fault, and nothing was mended or changed since."""
        last = self.stretches[-1].flights if self.stretches else ()
        return bool(last) and last[-1].verdict is Verdict.FAULT


def overview_of(
    airframe: str, flights: Sequence[FlightRecord], marks: Sequence[Mark], policy: Policy = POLICY
) -> Overview:
    """What is found of an airframe. flights, marks: all of it, in order of time."""
    stretches = stretches_of(flights, marks)
    present = stretches[-1] if stretches else None
    found = [Found(series, review(series, policy)) for series in series_of(present)] if present else []
    found.sort(key=lambda one: -1.0 if one.review.trend is None else one.review.trend.level, reverse=True)
    return Overview(airframe, tuple(flights), stretches, tuple(found), _rotor_growth(present))


def _rotor_growth(stretch: Stretch | None) -> tuple[float, ...]:
    known = [one.rotor_trim for one in stretch.flights if one.rotor_trim] if stretch else []
    if len(known) < 2 or len({len(one) for one in known}) != 1:
        return ()
    trims, count = np.array(known), min(FEW, len(known) // 2)
    growth: list[float] = (np.median(trims[-count:], axis=0) - np.median(trims[:count], axis=0)).tolist()
    return tuple(growth)
