"""What a campaign found, with 95 % confidence intervals, and as tables on the terminal.

share:  Wilson, JASA 22 (1927)
rate:   chi2(0.025, 2k) / 2T  to  chi2(0.975, 2k + 2) / 2T                      Garwood, Biometrika 28 (1936)

Flights of one airframe share its baseline, so they are not independent; the intervals do not know that.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from mavdiag.units import S_PER_H
from sitl_plant.campaign.plan import CAUSES, CONDITIONS, HEALTHY, RIGHT, Group
from sitl_plant.campaign.worker import FlightResult, Results

UNJUDGED = ("not_judgeable", "error")
PIPED_WIDTH = 1000  # no column is cut where nobody looks at a screen; a table takes what it needs
CELL = "fault, phenomenology"  # rows that make a table of their own


@dataclass(frozen=True, slots=True)
class Share:
    """hits of `of`, with the interval of the true share; 0 to 1 if `of` is 0."""

    hits: int
    of: int
    low: float
    high: float

    @property
    def part(self) -> str:
        """As text, and `interval` the interval."""
        return f"{self.hits}/{self.of}" if self.of else "-"

    @property
    def interval(self) -> str:
        """Its interval as text."""
        return f"{self.low:.2f}-{self.high:.2f}"


@dataclass(frozen=True, slots=True)
class Rate:
    """count in so many hours, and the interval of the true rate [1/h]; without hours it is 0 to infinity (None)."""

    count: int
    hours: float
    low: float
    high: float | None

    @property
    def cells(self) -> tuple[str, str, str]:
        """Count, rate and interval as text."""
        if self.high is None:
            return str(self.count), "-", "-"
        return str(self.count), f"{self.count / self.hours:.2f}", f"{self.low:.2f}-{self.high:.2f}"


def wilson(hits: int, of: int) -> Share:
    """The share and its interval.

    >>> share = wilson(8, 10)
    >>> round(share.low, 3), round(share.high, 3)
    (0.49, 0.943)
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


@dataclass(frozen=True, slots=True)
class ConditionMonitor:
    """One monitor in healthy flight: judged share of the time flown, and its own alarms by the time that it judged."""

    name: str
    judged_share: float
    rate: Rate


@dataclass(frozen=True, slots=True)
class ConditionDetection:
    """T's faults at one scale of the fitted terms; the shares are of the flights that were judged."""

    phenomenology: float
    flights: int  # flown
    detected: Share  # with an alarm after the onset
    declared: Share  # with the decision "fault" after it


@dataclass(frozen=True, slots=True)
class ConditionRow:
    """One condition. All but `detection` is of its healthy flights."""

    condition: str
    flown_h: float  # judged or not
    judged_h: float  # of it, judged by the deciding monitor that judged for longest; the rates are by these hours
    judged_share: float
    alarms: Rate  # episodes of alarms
    faults: Rate  # how often the decision came to "fault"
    flagged: Share  # flights with the verdict "fault", of those flown
    monitors: tuple[ConditionMonitor, ...]
    detection: tuple[ConditionDetection, ...]


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
    """How one cause was answered."""

    group: str
    cause: str
    flights: int
    answers: tuple[tuple[str, int], ...]  # counts by kind of answer
    early: int  # flights with an alarm before the onset
    right: Share  # answered by the kind that is right for the group, of those judged
    named: int  # flights in which a rotor was named; of a sensor's cause there should be none


@dataclass(frozen=True, slots=True)
class Summary:
    """All tables."""

    seed: int
    airframes: int
    flights: int
    unjudged: tuple[tuple[str, int], ...]
    healthy_hours: float  # of healthy flights, and of the others up to their onset; alarms there are false
    chance: float  # share of healthy stretches, as long as those after an onset, in which an alarm would begin
    alarms: tuple[AlarmRow, ...]
    detection: tuple[DetectionRow, ...]
    monitors: tuple[MonitorRow, ...]
    answers: tuple[AnswerRow, ...]
    conditions: tuple[ConditionRow, ...]
    every: ConditionRow  # all conditions together


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
    CELL: lambda flight: f"{flight.cause} x{flight.phenomenology:g}",
    "rotor": lambda flight: str(flight.rotor),
    **_SHARED,
}


def summarise(results: Results) -> Summary:
    """All tables of a campaign."""
    flights = results.flights
    judged = _judged(flights)
    faulty = _faulty(judged)
    by_condition = [(name, [one for one in flights if one.conditions.condition == name]) for name in CONDITIONS]
    return Summary(
        seed=results.plan.design.seed,
        airframes=results.plan.design.airframes,
        flights=len(flights),
        unjudged=_counts(f"{one.verdict}: {one.reason}" for one in flights if one.verdict in UNJUDGED),
        healthy_hours=_hours(judged),
        chance=_chance(judged, faulty),
        alarms=tuple(_alarm_row(*row) for row in _by_level(_ALARM_FACTORS, judged)),
        detection=tuple(_detection_row(*row) for row in _by_level(_FAULT_FACTORS, faulty)),
        monitors=_monitor_rows(judged, faulty),
        answers=_answer_rows(flights),
        conditions=tuple(_condition_row(name, own) for name, own in by_condition if own),
        every=_condition_row("all", flights),
    )


def _judged(flights: Sequence[FlightResult]) -> list[FlightResult]:
    return [flight for flight in flights if flight.verdict not in UNJUDGED]


def _faulty(flights: Sequence[FlightResult]) -> list[FlightResult]:
    return [one for one in flights if one.cause in CAUSES and CAUSES[one.cause].group is Group.FAULT]


def _by_level(factors: _Factors, flights: Sequence[FlightResult]) -> Iterable[tuple[str, str, list[FlightResult]]]:
    for factor, level_of in factors.items():
        levels: dict[str, list[FlightResult]] = {}
        for flight in flights:
            levels.setdefault(level_of(flight), []).append(flight)
        if factor == "all" or len(levels) > 1:
            for level in sorted(levels, key=_natural):
                yield factor, level, levels[level]


def _natural(level: str) -> tuple[float, str]:
    try:
        return float(level), ""
    except ValueError:
        return math.inf, level


def _counts(names: Iterable[str]) -> tuple[tuple[str, int], ...]:
    return tuple(sorted(Counter(names).items(), key=lambda item: (-item[1], item[0])))


def _hours(flights: Sequence[FlightResult]) -> float:
    return sum(flight.healthy_s for flight in flights) / S_PER_H


def _chance(judged: Sequence[FlightResult], faulty: Sequence[FlightResult]) -> float:
    hours = _hours(judged)
    after_h = [(flight.flown_s - flight.onset_s) / S_PER_H for flight in faulty if flight.onset_s is not None]
    if not (hours and after_h):
        return 0.0
    return 1.0 - math.exp(-sum(flight.episodes for flight in judged) / hours * float(np.mean(after_h)))


def _condition_row(name: str, flights: Sequence[FlightResult]) -> ConditionRow:
    healthy, faulty = [flight for flight in flights if flight.cause == HEALTHY], _faulty(flights)
    flown_h = sum(flight.flown_s for flight in healthy) / S_PER_H
    judged_h = sum(flight.judged_s for flight in healthy) / S_PER_H
    monitors, detection = [], []
    for monitor in sorted({one.name for flight in healthy for one in flight.monitors}):
        own = [one for flight in healthy for one in flight.monitors if one.name == monitor]
        hours = sum(one.judged_s for one in own) / S_PER_H
        monitors.append(ConditionMonitor(monitor, hours / flown_h, poisson(sum(one.before for one in own), hours)))
    for scale in sorted({flight.phenomenology for flight in faulty}):
        scaled = [flight for flight in faulty if flight.phenomenology == scale]
        judged = _judged(scaled)
        detected = wilson(sum(flight.latency_s is not None for flight in judged), len(judged))
        declared = wilson(sum(flight.declared_s is not None for flight in judged), len(judged))
        detection.append(ConditionDetection(scale, len(scaled), detected, declared))
    return ConditionRow(
        condition=name,
        flown_h=flown_h,
        judged_h=judged_h,
        judged_share=judged_h / flown_h if flown_h else 0.0,
        alarms=poisson(sum(flight.episodes for flight in healthy), judged_h),
        faults=poisson(sum(flight.faults for flight in healthy), judged_h),
        flagged=wilson(sum(flight.verdict == "fault" for flight in healthy), len(healthy)),
        monitors=tuple(monitors),
        detection=tuple(detection),
    )


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
    rows = []
    for name in sorted({monitor.name for flight in judged for monitor in flight.monitors}):
        every = [one for flight in judged for one in flight.monitors if one.name == name]
        damaged = [one for flight in faulty for one in flight.monitors if one.name == name]
        rate = poisson(sum(one.before for one in every), _hours(judged))
        rows.append(MonitorRow(name, rate, wilson(sum(one.after > 0 for one in damaged), len(damaged))))
    return tuple(rows)


def _answer_rows(flights: Sequence[FlightResult]) -> tuple[AnswerRow, ...]:
    rows = []
    for name, cause in CAUSES.items():
        own = [flight for flight in flights if flight.cause == name]
        if own:
            judged = _judged(own)
            answers = _counts(flight.answer.kind for flight in own)
            early = sum(flight.episodes > 0 for flight in own)
            right = wilson(sum(flight.answer.kind == RIGHT[cause.group] for flight in judged), len(judged))
            named = sum(flight.answer.rotor is not None for flight in own)
            rows.append(AnswerRow(cause.group.value, name, len(own), answers, early, right, named))
    return tuple(rows)


def print_summary(summary: Summary) -> None:
    """Print all tables, and what was not judged."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=PIPED_WIDTH)
    for table in (*_condition_tables(summary), *_fault_tables(summary)):
        if table.row_count:
            console.print(table)
    console.print(
        f"seed {summary.seed}, {summary.airframes} airframes, {summary.flights} flights, "
        f"{summary.healthy_hours:.2f} hours of healthy flight judged"
    )
    for reason, count in summary.unjudged:
        console.print(f"not judged: {count} flights, {reason}")


def _table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Table:
    table = Table(title=title, title_justify="left")
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="right" if i else "left")
    for row in rows:
        table.add_row(*row)
    return table


def _condition_tables(summary: Summary) -> Iterable[Table]:
    rows = (*summary.conditions, summary.every) if len(summary.conditions) > 1 else ()
    hours, monitors, found = [], [], []
    names = sorted({one.name for row in rows if row.flown_h for one in row.monitors})
    scales = sorted({one.phenomenology for row in rows for one in row.detection})
    for row in rows:
        if row.flown_h:
            flown = row.condition, f"{row.flown_h:.2f}", f"{100 * row.judged_share:.0f} %"
            hours.append((*flown, *row.alarms.cells, *row.faults.cells, row.flagged.part))
            shares = {one.name: f"{100 * one.judged_share:.0f} % {one.rate.count}" for one in row.monitors}
            monitors.append((row.condition, *(shares.get(name, "-") for name in names)))
        if row.detection:
            parts = {one.phenomenology: f"{one.detected.part}, {one.declared.part}" for one in row.detection}
            found.append((row.condition, *(parts.get(scale, "-") for scale in scales)))
    title = "Healthy flight by condition: alarms and decisions for a fault, by the hours judged"
    rates = ("per hour", "95 %")
    yield _table(title, ("condition", "flown h", "judged", "alarms", *rates, "faults", *rates, "flagged"), hours)
    yield _table("Healthy flight by monitor: share judged, and alarms", ("condition", *names), monitors)
    title = (
        "T's nine faults by condition and fitted terms: flights with an alarm, and decided as a fault, of those judged"
    )
    yield _table(title, ("condition", *(f"x{scale:g}" for scale in scales)), found)


def _fault_tables(summary: Summary) -> Iterable[Table]:
    alarms, detection = [], []
    cells: dict[str, dict[str, str]] = {}
    for row in summary.alarms:
        count, *rate = row.rate.cells
        flights = f"{row.flights.hits}/{row.flights.of}", row.flights.interval
        alarms.append((_level(row.factor, row.level), count, f"{row.rate.hours:.2f}", *rate, *flights))
    for found in summary.detection:
        hits, of = found.detected.hits, found.detected.of
        fault, _, scale = found.level.partition(" ")
        if found.factor == CELL:
            cells.setdefault(fault, {})[scale] = found.detected.part
            continue
        share = f"{hits}/{of}", f"{hits / of:.2f}", found.detected.interval, str(found.early)
        seconds = ("-" if value is None else f"{value:.2f}" for value in (found.latency_median_s, found.latency_p90_s))
        right = found.rotor_right.part, found.type_right.part, found.severity_right.part
        detection.append((_level(found.factor, found.level), *share, *seconds, *right))
    title = "False alarms in healthy flight (the time before an onset counts): episodes an hour, and flights with any"
    yield _table(title, ("condition", "alarms", "hours", "per hour", "95 %", "flights", "95 %"), alarms)
    headings: tuple[str, ...] = (
        "condition",
        "detected",
        "share",
        "95 %",
        "early",
        "latency s",
        "90 %",
        "rotor",
        "type",
        "severity",
    )
    yield _table(f"T's nine faults; chance alone would be {100 * summary.chance:.0f} %", headings, detection)
    scales = sorted({scale for own in cells.values() for scale in own})
    lines = ((fault, *(own.get(scale, "-") for scale in scales)) for fault, own in cells.items())
    yield _table("Detected, by fault and fitted terms", ("fault", *scales), lines)
    monitors = ((one.name, *one.rate.cells, one.detected.part, one.detected.interval) for one in summary.monitors)
    headings = ("monitor", "alarms", "per hour", "95 %", "faults detected", "95 %")
    yield _table("Monitors, each alone", headings, monitors)
    answers = []
    for answer in summary.answers:
        kinds = ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in answer.answers)
        right = answer.right.part, answer.right.interval, str(answer.named)
        answers.append((answer.group, answer.cause, str(answer.flights), kinds, str(answer.early), *right))
    headings = ("group", "cause", "flights", "answers", "early", "right", "95 %", "rotor named")
    yield _table("Answers after the onset", headings, answers)


def _level(factor: str, level: str) -> str:
    return level if factor in ("all", "fault", "flight") else f"{factor} {level}"
