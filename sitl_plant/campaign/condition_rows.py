"""What a campaign found in each named condition: healthy hours, judged share, alarms, and faults found."""

from collections.abc import Sequence
from dataclasses import dataclass

from mavdiag.units import S_PER_H
from sitl_plant.campaign.causes import CAUSES, HEALTHY, Group
from sitl_plant.campaign.conditions import CONDITIONS
from sitl_plant.campaign.intervals import Rate, Share, poisson, wilson
from sitl_plant.campaign.worker import FlightResult

__all__ = ["UNJUDGED", "ConditionDetection", "ConditionMonitor", "ConditionRow", "condition_row", "condition_rows"]

UNJUDGED = ("not_judgeable", "error")


@dataclass(frozen=True, slots=True)
class ConditionMonitor:
    """One monitor in healthy flight: judged share of the time flown, and its own alarms by the time that it judged."""

    name: str
    judged_share: float
    rate: Rate


@dataclass(frozen=True, slots=True)
class ConditionDetection:
    """T's faults at one scale of the fitted terms.

    flights: flown; the shares are of those that were judged.
    detected: with an alarm after the onset.
    declared: with the decision "fault" after it.
    """

    phenomenology: float
    flights: int
    detected: Share
    declared: Share


@dataclass(frozen=True, slots=True)
class ConditionRow:
    """One condition. All but `detection` is of its healthy flights.

    flown_h: flown, judged or not.
    judged_h: of it, judged by the deciding monitor that judged for longest; the rates are by these hours.
    alarms: episodes of alarms. faults: how often the decision came to "fault".
    flagged: flights with the verdict "fault", of those flown.
    """

    condition: str
    flown_h: float
    judged_h: float
    judged_share: float
    alarms: Rate
    faults: Rate
    flagged: Share
    monitors: tuple[ConditionMonitor, ...]
    detection: tuple[ConditionDetection, ...]


def condition_rows(flights: Sequence[FlightResult]) -> tuple[ConditionRow, ...]:
    """A row for each condition that was flown, in the order of the table."""
    rows = []
    for name in CONDITIONS:
        own = [flight for flight in flights if flight.conditions.condition == name]
        if own:
            rows.append(condition_row(name, own))
    return tuple(rows)


def condition_row(name: str, flights: Sequence[FlightResult]) -> ConditionRow:
    """What was found in these flights."""
    healthy = [flight for flight in flights if flight.cause == HEALTHY]
    flown_h = sum(flight.flown_s for flight in healthy) / S_PER_H
    judged_h = sum(flight.judged_s for flight in healthy) / S_PER_H
    faulty = [flight for flight in flights if flight.cause in CAUSES and CAUSES[flight.cause].group is Group.FAULT]
    return ConditionRow(
        condition=name,
        flown_h=flown_h,
        judged_h=judged_h,
        judged_share=judged_h / flown_h if flown_h else 0.0,
        alarms=poisson(sum(flight.episodes for flight in healthy), judged_h),
        faults=poisson(sum(flight.faults for flight in healthy), judged_h),
        flagged=wilson(sum(flight.verdict == "fault" for flight in healthy), len(healthy)),
        monitors=_monitors(healthy, flown_h),
        detection=tuple(
            _detection(scale, [flight for flight in faulty if flight.phenomenology == scale])
            for scale in sorted({flight.phenomenology for flight in faulty})
        ),
    )


def _monitors(healthy: Sequence[FlightResult], flown_h: float) -> tuple[ConditionMonitor, ...]:
    rows = []
    for name in sorted({monitor.name for flight in healthy for monitor in flight.monitors}):
        own = [monitor for flight in healthy for monitor in flight.monitors if monitor.name == name]
        hours = sum(monitor.judged_s for monitor in own) / S_PER_H
        rows.append(ConditionMonitor(name, hours / flown_h, poisson(sum(monitor.before for monitor in own), hours)))
    return tuple(rows)


def _detection(scale: float, flights: Sequence[FlightResult]) -> ConditionDetection:
    judged = [flight for flight in flights if flight.verdict not in UNJUDGED]
    return ConditionDetection(
        phenomenology=scale,
        flights=len(flights),
        detected=wilson(sum(flight.latency_s is not None for flight in judged), len(judged)),
        declared=wilson(sum(flight.declared_s is not None for flight in judged), len(judged)),
    )
