"""What a campaign found, with 95 % confidence intervals: Wilson's for shares, the exact Poisson one for rates.

Flights of one airframe share its baseline, so they are not independent; the intervals do not know that.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.units import S_PER_H
from sitl_plant.campaign.causes import CAUSES, HEALTHY, RIGHT, Group
from sitl_plant.campaign.condition_rows import UNJUDGED, ConditionRow, condition_row, condition_rows
from sitl_plant.campaign.intervals import Rate, Share, poisson, wilson
from sitl_plant.campaign.runner import Results
from sitl_plant.campaign.worker import FlightResult

__all__ = [
    "AlarmRow",
    "AnswerRow",
    "DetectionRow",
    "MonitorRow",
    "Summary",
    "summarise",
]


@dataclass(frozen=True, slots=True)
class AlarmRow:
    """Healthy flight under one condition: episodes of alarms an hour, and flights with any."""

    factor: str
    level: str
    rate: Rate
    flights: Share


@dataclass(frozen=True, slots=True)
class DetectionRow:
    """Judged flights with a propeller damaged as in T. Latencies [s] and named shares are of the detected ones.

    right: of those that name a rotor, a type or a severity, how many name the true one.
    """

    factor: str
    level: str
    detected: Share
    early: int
    latency_median_s: float | None
    latency_p90_s: float | None
    rotor_right: Share
    type_right: Share
    severity_right: Share


@dataclass(frozen=True, slots=True)
class MonitorRow:
    """One monitor: its own false alarms in healthy flight, and T's faults that it found."""

    name: str
    rate: Rate
    detected: Share


@dataclass(frozen=True, slots=True)
class AnswerRow:
    """How one cause was answered: counts by kind of answer.

    early: flights with an alarm before the onset.
    right: flights answered by the kind that is right for the group, of those judged.
    named: flights in which a rotor was named; of a sensor's cause there should be none.
    """

    group: str
    cause: str
    flights: int
    answers: tuple[tuple[str, int], ...]
    early: int
    right: Share
    named: int


@dataclass(frozen=True, slots=True)
class Summary:
    """All tables.

    healthy_hours: of healthy flights, and of the others up to their onset; alarms there are false.
    chance: share of healthy stretches, as long as those after an onset, in which an alarm would begin.
    every: all conditions together.
    """

    seed: int
    airframes: int
    flights: int
    unjudged: tuple[tuple[str, int], ...]
    healthy_hours: float
    chance: float
    alarms: tuple[AlarmRow, ...]
    detection: tuple[DetectionRow, ...]
    monitors: tuple[MonitorRow, ...]
    answers: tuple[AnswerRow, ...]
    conditions: tuple[ConditionRow, ...]
    every: ConditionRow


_FACTORS: Mapping[str, Callable[[FlightResult], str]] = {
    "all": lambda flight: "all",
    "condition": lambda flight: flight.conditions.condition,
    "manoeuvre": lambda flight: flight.conditions.manoeuvre,
    "wind m/s": lambda flight: f"{flight.conditions.wind_m_s:g}",
    "payload g": lambda flight: f"{flight.conditions.payload_g:g}",
    "link": lambda flight: flight.link,
    "loss": lambda flight: f"{flight.loss:g}",
    "airframe": lambda flight: "aged" if flight.airframe % 2 else "new",
}
_ALARM_FACTORS: Mapping[str, Callable[[FlightResult], str]] = {
    "all": lambda flight: "all",
    "flight": lambda flight: HEALTHY if flight.cause == HEALTHY else "before an onset",
    **{name: level for name, level in _FACTORS.items() if name != "all"},
}
_FAULT_FACTORS: Mapping[str, Callable[[FlightResult], str]] = {
    "all": lambda flight: "all",
    "phenomenology": lambda flight: f"{flight.phenomenology:g}",
    "fault": lambda flight: flight.cause,
    "fault, phenomenology": lambda flight: f"{flight.cause} x{flight.phenomenology:g}",
    "rotor": lambda flight: str(flight.rotor),
    **{name: level for name, level in _FACTORS.items() if name != "all"},
}


def summarise(results: Results) -> Summary:
    """All tables of a campaign."""
    judged = [flight for flight in results.flights if flight.verdict not in UNJUDGED]
    faulty = [flight for flight in judged if flight.cause in CAUSES and CAUSES[flight.cause].group is Group.FAULT]
    return Summary(
        seed=results.plan.design.seed,
        airframes=results.plan.design.airframes,
        flights=len(results.flights),
        unjudged=_counts(f"{one.verdict}: {one.reason}" for one in results.flights if one.verdict in UNJUDGED),
        healthy_hours=_hours(judged),
        chance=_chance(judged, faulty),
        alarms=tuple(_alarm_row(*row) for row in _by_level(_ALARM_FACTORS, judged)),
        detection=tuple(_detection_row(*row) for row in _by_level(_FAULT_FACTORS, faulty)),
        monitors=_monitor_rows(judged, faulty),
        answers=_answer_rows(results.flights),
        conditions=condition_rows(results.flights),
        every=condition_row("all", results.flights),
    )


def _by_level(
    factors: Mapping[str, Callable[[FlightResult], str]], flights: Sequence[FlightResult]
) -> Iterable[tuple[str, str, list[FlightResult]]]:
    """Each factor that varies, level by level."""
    for factor, level_of in factors.items():
        levels: dict[str, list[FlightResult]] = {}
        for flight in flights:
            levels.setdefault(level_of(flight), []).append(flight)
        if factor == "all" or len(levels) > 1:
            for level in sorted(levels, key=_natural):
                yield factor, level, levels[level]


def _natural(level: str) -> tuple[float, str]:
    """Numbers by size, then texts."""
    try:
        return float(level), ""
    except ValueError:
        return math.inf, level


def _counts(names: Iterable[str]) -> tuple[tuple[str, int], ...]:
    """How often each occurs, the most frequent first."""
    counts: dict[str, int] = {}
    for name in names:
        counts[name] = counts.get(name, 0) + 1
    return tuple(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def _hours(flights: Sequence[FlightResult]) -> float:
    return sum(flight.healthy_s for flight in flights) / S_PER_H


def _chance(judged: Sequence[FlightResult], faulty: Sequence[FlightResult]) -> float:
    """1 - exp(-rate T), T the mean flight after an onset: what "detected" would be if nothing were to detect."""
    hours = _hours(judged)
    after_h = [(flight.flown_s - flight.onset_s) / S_PER_H for flight in faulty if flight.onset_s is not None]
    if not (hours and after_h):
        return 0.0
    return 1.0 - math.exp(-sum(flight.episodes for flight in judged) / hours * float(np.mean(after_h)))


def _alarm_row(factor: str, level: str, flights: Sequence[FlightResult]) -> AlarmRow:
    alarmed = sum(flight.episodes > 0 for flight in flights)
    rate = poisson(sum(flight.episodes for flight in flights), _hours(flights))
    return AlarmRow(factor, level, rate, wilson(alarmed, len(flights)))


def _detection_row(factor: str, level: str, flights: Sequence[FlightResult]) -> DetectionRow:
    latencies = [flight.latency_s for flight in flights if flight.latency_s is not None]

    def right(named: Callable[[FlightResult], object], true: Callable[[FlightResult], object]) -> Share:
        naming = [flight for flight in flights if named(flight) is not None]
        return wilson(sum(named(flight) == true(flight) for flight in naming), len(naming))

    return DetectionRow(
        factor,
        level,
        wilson(len(latencies), len(flights)),
        sum(flight.episodes > 0 for flight in flights),
        float(np.median(latencies)) if latencies else None,
        float(np.percentile(latencies, 90)) if latencies else None,
        right(lambda flight: flight.answer.rotor, lambda flight: flight.rotor),
        right(lambda flight: flight.answer.fault_type, lambda flight: flight.cause[:2]),
        right(lambda flight: flight.answer.severity, lambda flight: int(flight.cause[-1])),
    )


def _monitor_rows(judged: Sequence[FlightResult], faulty: Sequence[FlightResult]) -> tuple[MonitorRow, ...]:
    names = sorted({monitor.name for flight in judged for monitor in flight.monitors})
    rows = []
    for name in names:
        every = [one for flight in judged for one in flight.monitors if one.name == name]
        damaged = [one for flight in faulty for one in flight.monitors if one.name == name]
        rate = poisson(sum(one.before for one in every), _hours(judged))
        rows.append(MonitorRow(name, rate, wilson(sum(one.after > 0 for one in damaged), len(damaged))))
    return tuple(rows)


def _answer_rows(flights: Sequence[FlightResult]) -> tuple[AnswerRow, ...]:
    rows = []
    for name in CAUSES:
        own = [flight for flight in flights if flight.cause == name]
        if own:
            answers = _counts(flight.answer.kind for flight in own)
            early = sum(flight.episodes > 0 for flight in own)
            group = CAUSES[name].group
            judged = [flight.answer for flight in own if flight.verdict not in UNJUDGED]
            right = wilson(sum(answer.kind == RIGHT[group] for answer in judged), len(judged))
            named = sum(flight.answer.rotor is not None for flight in own)
            rows.append(AnswerRow(group.value, name, len(own), answers, early, right, named))
    return tuple(rows)
