"""What a campaign found, with 95 % confidence intervals, and as tables on the terminal.

share:  Wilson, JASA 22 (1927)
rate:   chi2(0.025, 2k) / 2T  to  chi2(0.975, 2k + 2) / 2T                      Garwood, Biometrika 28 (1936)

Flights of one airframe share its baseline, so they are not independent; the intervals do not know that. The summary:

    healthy_hours  of healthy flights, and of the others up to their onset; alarms there are false
    chance         share of healthy stretches, as long as those after an onset, in which an alarm would begin
    alarms         healthy flight at one level of a factor: episodes of alarms, and flights with any
    detection      judged flights with a propeller damaged as in T; latencies [s] and named shares are of the detected
                   ones; right: of those that name a rotor, a type or a severity, how many name the true one
    monitors       one monitor: its own false alarms in healthy flight, and T's faults that it found
    answers        how one cause was answered: counts by kind of answer; early: with an alarm before the onset; right:
                   by the kind that is right for the group, of those judged; named: flights that name a rotor
    conditions     one condition: its healthy flights, their hours, verdicts and declared faults, the monitors, and T's
                   faults at each scale of the fitted terms with an alarm or (declared) the decision "fault"; every: all
"""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from rich.console import Console
from rich.table import Table

from mavdiag.units import S_PER_H
from sitl_plant.campaign.plan import CAUSES, CONDITIONS, HEALTHY, Group
from sitl_plant.campaign.worker import FlightResult, Results

UNJUDGED = ("not_judgeable", "error")
PIPED_WIDTH = 1000  # no column is cut where nobody looks at a screen; a table takes what it needs
Row: TypeAlias = dict[str, Any]
Flights: TypeAlias = Sequence[FlightResult]


@dataclass(frozen=True, slots=True)
class Share:
    """hits of `of`, with the interval of the true share; 0 to 1 if `of` is 0."""

    hits: int
    of: int
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.hits}/{self.of}, {self.low:.2f}-{self.high:.2f}" if self.of else "-"


@dataclass(frozen=True, slots=True)
class Rate:
    """count in so many hours, and the interval of the true rate [1/h]; without hours it is 0 to infinity (None)."""

    count: int
    hours: float
    low: float
    high: float | None

    def __str__(self) -> str:
        if self.high is None:
            return f"{self.count} in 0 h"
        return f"{self.count} in {self.hours:.2f} h, {self.count / self.hours:.2f}/h, {self.low:.2f}-{self.high:.2f}"


def wilson(hits: int, of: int) -> Share:
    """The share and its interval.

    >>> print(wilson(8, 10))
    8/10, 0.49-0.94
    """
    if of == 0:
        return Share(0, 0, 0.0, 1.0)
    from scipy.stats import binomtest  # scipy.stats takes a second to load

    interval = binomtest(hits, of).proportion_ci(method="wilson")
    return Share(hits, of, float(interval.low), float(interval.high))


def poisson(count: int, hours: float) -> Rate:
    """The rate's exact interval.

    >>> round(poisson(0, 10.0).high, 3)        # ln(40) / 10
    0.369
    """
    from scipy.stats import chi2

    if hours <= 0.0:
        return Rate(count, 0.0, 0.0, None)
    low = float(chi2.ppf(0.025, 2 * count)) / (2 * hours) if count else 0.0
    return Rate(count, hours, low, float(chi2.ppf(0.975, 2 * count + 2)) / (2 * hours))


_Factors = Mapping[str, Callable[[FlightResult], str]]
_SHARED: _Factors = {
    "condition": lambda flight: flight.conditions.condition,
    "manoeuvre": lambda flight: flight.conditions.manoeuvre,
    "wind m/s": lambda flight: f"{flight.conditions.wind_m_s:g}",
    "payload g": lambda flight: f"{flight.conditions.payload_g:g}",
    "link": lambda flight: flight.link,
    "loss": lambda flight: f"{flight.loss:g}",
    "airframe": lambda flight: "aged" if flight.airframe % 2 else "new",
}
_ALARM_FACTORS: _Factors = {
    "all": lambda flight: "all",
    "flight": lambda flight: HEALTHY if flight.cause == HEALTHY else "before an onset",
    **_SHARED,
}
_FAULT_FACTORS: _Factors = {
    "all": lambda flight: "all",
    "phenomenology": lambda flight: f"{flight.phenomenology:g}",
    "fault": lambda flight: flight.cause,
    "fault, phenomenology": lambda flight: f"{flight.cause} x{flight.phenomenology:g}",
    "rotor": lambda flight: str(flight.rotor),
    **_SHARED,
}


def summarise(results: Results) -> Row:
    """All tables of a campaign."""
    flights = results.flights
    judged = _judged(flights)
    faulty, hours = _faulty(judged), _hours(judged)
    conditions = _levels(flights, lambda flight: flight.conditions.condition)
    causes = _levels(flights, lambda flight: flight.cause)
    after_h = [(flight.flown_s - flight.onset_s) / S_PER_H for flight in faulty if flight.onset_s is not None]
    expected = sum(flight.episodes for flight in judged) / hours * float(np.mean(after_h)) if hours and after_h else 0.0
    return {
        "seed": results.design.seed,
        "airframes": results.design.airframes,
        "flights": len(flights),
        "unjudged": _counts(f"{flight.verdict}: {flight.reason}" for flight in flights if flight.verdict in UNJUDGED),
        "healthy_hours": hours,
        "chance": 1.0 - math.exp(-expected),
        "alarms": _by_factor(
            _ALARM_FACTORS,
            judged,
            lambda some: {
                "rate": poisson(sum(flight.episodes for flight in some), _hours(some)),
                "flights": _share(some, lambda flight: flight.episodes > 0),
            },
        ),
        "detection": _by_factor(_FAULT_FACTORS, faulty, _detection),
        "monitors": [
            {"name": name, "rate": poisson(before, hours), "detected": wilson(sum(own), len(own))}
            for name, before, _ in _by_monitor(judged)
            for own in [[one.after > 0 for flight in faulty for one in flight.monitors if one.name == name]]
        ],
        "answers": [_answer(name, causes[name]) for name in CAUSES if name in causes],
        "conditions": [_condition(name, conditions[name]) for name in CONDITIONS if name in conditions],
        "every": _condition("all", flights),
    }


def _share(flights: Flights, hit: Callable[[FlightResult], bool]) -> Share:
    return wilson(sum(map(hit, flights)), len(flights))


def _judged(flights: Flights) -> list[FlightResult]:
    return [flight for flight in flights if flight.verdict not in UNJUDGED]


def _faulty(flights: Flights) -> list[FlightResult]:
    return [flight for flight in flights if flight.cause in CAUSES and CAUSES[flight.cause].group is Group.FAULT]


def _hours(flights: Flights) -> float:
    return sum(flight.healthy_s for flight in flights) / S_PER_H


def _counts(names: Iterable[str]) -> tuple[tuple[str, int], ...]:
    return tuple(sorted(Counter(names).items(), key=lambda item: (-item[1], item[0])))


def _levels(flights: Flights, level_of: Callable[[FlightResult], str]) -> dict[str, list[FlightResult]]:
    levels: dict[str, list[FlightResult]] = defaultdict(list)
    for flight in flights:
        levels[level_of(flight)].append(flight)
    return levels


def _by_factor(factors: _Factors, flights: Flights, count: Callable[[Flights], Row]) -> list[Row]:
    rows = []
    for factor, level_of in factors.items():
        levels = _levels(flights, level_of)
        if factor == "all" or len(levels) > 1:
            ordered = sorted(levels, key=_natural)
            rows += [{"factor": factor, "level": level, **count(levels[level])} for level in ordered]
    return rows


def _natural(level: str) -> tuple[float, str]:
    try:
        return float(level), ""
    except ValueError:  # a vehicle's name may begin with a digit
        return math.inf, level


def _by_monitor(flights: Flights) -> Iterable[tuple[str, int, float]]:
    """Name of each monitor, its alarms before an onset, and the hours that it judged."""
    found = [monitor for flight in flights for monitor in flight.monitors]
    for name in sorted({monitor.name for monitor in found}):
        own = [monitor for monitor in found if monitor.name == name]
        yield name, sum(monitor.before for monitor in own), sum(monitor.judged_s for monitor in own) / S_PER_H


def _condition(name: str, flights: Flights) -> Row:
    healthy, faulty = [flight for flight in flights if flight.cause == HEALTHY], _faulty(flights)
    flown_h = sum(flight.flown_s for flight in healthy) / S_PER_H
    judged_h = sum(flight.judged_s for flight in healthy) / S_PER_H
    detection = []
    for scale in sorted({flight.phenomenology for flight in faulty}):
        scaled = [flight for flight in faulty if flight.phenomenology == scale]
        judged = _judged(scaled)
        declared = _share(judged, lambda flight: flight.declared_s is not None)
        found = {"detected": _share(judged, lambda flight: flight.latency_s is not None), "declared": declared}
        detection.append({"phenomenology": scale, "flights": len(scaled), **found})
    return {
        "condition": name,
        "flown_h": flown_h,
        "judged_h": judged_h,
        "judged_share": judged_h / flown_h if flown_h else 0.0,
        "alarms": poisson(sum(flight.episodes for flight in healthy), judged_h),
        "faults": poisson(sum(flight.faults for flight in healthy), judged_h),
        "flagged": _share(healthy, lambda flight: flight.verdict == "fault"),
        "verdicts": _counts(flight.verdict for flight in healthy),
        "monitors": [
            {"name": monitor, "judged_share": hours / flown_h, "rate": poisson(before, hours)}
            for monitor, before, hours in _by_monitor(healthy)
        ],
        "detection": detection,
    }


def _detection(flights: Flights) -> Row:
    latencies = [flight.latency_s for flight in flights if flight.latency_s is not None]

    def right(name: str, true: Callable[[FlightResult], object]) -> Share:
        naming = [flight for flight in flights if getattr(flight.answer, name) is not None]
        return _share(naming, lambda flight: bool(getattr(flight.answer, name) == true(flight)))

    return {
        "detected": _share(flights, lambda flight: flight.latency_s is not None),
        "early": sum(flight.episodes > 0 for flight in flights),
        "latency_median_s": float(np.median(latencies)) if latencies else None,
        "latency_p90_s": float(np.percentile(latencies, 90)) if latencies else None,
        "rotor_right": right("rotor", lambda flight: flight.rotor),
        "type_right": right("fault_type", lambda flight: flight.cause[:2]),
        "severity_right": right("severity", lambda flight: int(flight.cause[-1])),
    }


def _answer(name: str, flights: Flights) -> Row:
    group = CAUSES[name].group
    return {
        "group": group.value,
        "cause": name,
        "flights": len(flights),
        "answers": _counts(flight.answer.kind for flight in flights),
        "early": sum(flight.episodes > 0 for flight in flights),
        "right": _share(_judged(flights), lambda flight: flight.answer.kind == group.right),
        "named": sum(flight.answer.rotor is not None for flight in flights),
    }


def print_summary(summary: Row) -> None:
    """Print all tables, and what was not judged."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=PIPED_WIDTH)
    conditions = [*summary["conditions"], summary["every"]] if len(summary["conditions"]) > 1 else []
    for title, rows in {
        "Healthy flight by condition: alarms and decisions for a fault, by the hours judged": conditions,
        "Healthy flight by monitor: share judged, and alarms": [
            {"condition": row["condition"]}
            | {own["name"]: f"{100 * own['judged_share']:.0f} % {own['rate'].count}" for own in row["monitors"]}
            for row in conditions
        ],
        "T's nine faults by condition and fitted terms: with an alarm, and decided a fault, of those judged": [
            {"condition": row["condition"], **own} for row in conditions for own in row["detection"]
        ],
        "False alarms in healthy flight (the time before an onset counts): episodes, and flights with any": (
            summary["alarms"]
        ),
        f"T's nine faults; chance alone would be {100 * summary['chance']:.0f} %": summary["detection"],
        "Monitors, each alone": summary["monitors"],
        "Answers after the onset": summary["answers"],
    }.items():
        headings = dict.fromkeys(name for row in rows for name, cell in row.items() if not isinstance(cell, list))
        table = Table(*headings, title=title, title_justify="left")
        for row in rows:
            table.add_row(*(_text(row.get(name)) for name in headings))
        if rows:
            console.print(table)
    console.print(
        f"seed {summary['seed']}, {summary['airframes']} airframes, {summary['flights']} flights, "
        f"{summary['healthy_hours']:.2f} hours of healthy flight judged"
    )
    if verdicts := summary["every"]["verdicts"]:
        console.print(f"healthy flights: {_text(verdicts)}; faults declared: {summary['every']['faults']}")
    for reason, count in summary["unjudged"]:
        console.print(f"not judged: {count} flights, {reason}")


def _text(cell: object) -> str:
    if isinstance(cell, tuple):
        return ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in cell)
    if isinstance(cell, float):
        return f"{cell:.2f}"
    return "-" if cell is None else str(cell)
