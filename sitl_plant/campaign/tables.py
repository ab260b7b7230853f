"""A campaign's summary as tables on the terminal (edge)."""

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table

from sitl_plant.campaign.condition_rows import ConditionRow
from sitl_plant.campaign.intervals import Rate, Share
from sitl_plant.campaign.summary import DetectionRow, Summary

__all__ = ["print_summary"]

PIPED_WIDTH = 1000  # no column is cut where nobody looks at a screen; a table takes what it needs
CELL = "fault, phenomenology"  # rows that make a table of their own


def print_summary(summary: Summary) -> None:
    """All tables, and what was not judged."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=PIPED_WIDTH)
    shown = (_conditions, _judged, _found, _alarms, _detection, _cells, _monitors, _answers)
    for table in (make(summary) for make in shown):
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


def _several(summary: Summary) -> tuple[ConditionRow, ...]:
    """The rows of the named conditions and of all, if there are several; of one alone the other tables tell."""
    return (*summary.conditions, summary.every) if len(summary.conditions) > 1 else ()


def _conditions(summary: Summary) -> Table:
    return _table(
        "Healthy flight by condition: alarms and decisions for a fault, by the hours judged",
        ("condition", "flown h", "judged", "alarms", "per hour", "95 %", "faults", "per hour", "95 %", "flagged"),
        (
            (
                row.condition,
                f"{row.flown_h:.2f}",
                f"{100 * row.judged_share:.0f} %",
                str(row.alarms.count),
                *_rate(row.alarms),
                str(row.faults.count),
                *_rate(row.faults),
                _part(row.flagged),
            )
            for row in _several(summary)
            if row.flown_h
        ),
    )


def _judged(summary: Summary) -> Table:
    """Share of healthy flight that each monitor judged, and its alarms."""
    rows = [row for row in _several(summary) if row.flown_h]
    names = sorted({one.name for row in rows for one in row.monitors})
    lines = []
    for row in rows:
        cells = {one.name: f"{100 * one.judged_share:.0f} % {one.rate.count}" for one in row.monitors}
        lines.append((row.condition, *(cells.get(name, "-") for name in names)))
    return _table("Healthy flight by monitor: share judged, and alarms", ("condition", *names), lines)


def _found(summary: Summary) -> Table:
    """T's nine faults found by condition and scale of the fitted terms: with an alarm, and decided as a fault."""
    rows = [row for row in _several(summary) if row.detection]
    scales = sorted({one.phenomenology for row in rows for one in row.detection})
    lines = []
    for row in rows:
        cells = {one.phenomenology: f"{_part(one.detected)}, {_part(one.declared)}" for one in row.detection}
        lines.append((row.condition, *(cells.get(scale, "-") for scale in scales)))
    title = (
        "T's nine faults by condition and fitted terms: flights with an alarm, and decided as a fault, of those judged"
    )
    return _table(title, ("condition", *(f"x{scale:g}" for scale in scales)), lines)


def _alarms(summary: Summary) -> Table:
    return _table(
        "False alarms in healthy flight (the time before an onset counts): episodes an hour, and flights with any",
        ("condition", "alarms", "hours", "per hour", "95 %", "flights", "95 %"),
        (
            (
                _level(row.factor, row.level),
                str(row.rate.count),
                f"{row.rate.hours:.2f}",
                *_rate(row.rate),
                f"{row.flights.hits}/{row.flights.of}",
                _interval(row.flights),
            )
            for row in summary.alarms
        ),
    )


def _detection(summary: Summary) -> Table:
    return _table(
        f"T's nine faults; chance alone would be {100 * summary.chance:.0f} %",
        ("condition", "detected", "share", "95 %", "early", "latency s", "90 %", "rotor", "type", "severity"),
        (
            (
                _level(row.factor, row.level),
                f"{row.detected.hits}/{row.detected.of}",
                f"{row.detected.hits / row.detected.of:.2f}",
                _interval(row.detected),
                str(row.early),
                _seconds(row.latency_median_s),
                _seconds(row.latency_p90_s),
                _part(row.rotor_right),
                _part(row.type_right),
                _part(row.severity_right),
            )
            for row in summary.detection
            if row.factor != CELL
        ),
    )


def _cells(summary: Summary) -> Table:
    """Detected by fault and scale of the fitted terms."""
    cells: dict[str, dict[str, DetectionRow]] = {}
    for row in summary.detection:
        if row.factor == CELL:
            fault, _, scale = row.level.partition(" ")
            cells.setdefault(fault, {})[scale] = row
    scales = sorted({scale for row in cells.values() for scale in row})
    return _table(
        "Detected, by fault and fitted terms",
        ("fault", *scales),
        (
            (fault, *(_part(row[scale].detected) if scale in row else "-" for scale in scales))
            for fault, row in cells.items()
        ),
    )


def _monitors(summary: Summary) -> Table:
    return _table(
        "Monitors, each alone",
        ("monitor", "alarms", "per hour", "95 %", "faults detected", "95 %"),
        (
            (row.name, str(row.rate.count), *_rate(row.rate), _part(row.detected), _interval(row.detected))
            for row in summary.monitors
        ),
    )


def _answers(summary: Summary) -> Table:
    return _table(
        "Answers after the onset",
        ("group", "cause", "flights", "answers", "early", "right", "95 %", "rotor named"),
        (
            (
                row.group,
                row.cause,
                str(row.flights),
                ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in row.answers),
                str(row.early),
                _part(row.right),
                _interval(row.right),
                str(row.named),
            )
            for row in summary.answers
        ),
    )


def _level(factor: str, level: str) -> str:
    return level if factor in ("all", "fault", "flight") else f"{factor} {level}"


def _interval(share: Share) -> str:
    return f"{share.low:.2f}-{share.high:.2f}"


def _part(share: Share) -> str:
    return f"{share.hits}/{share.of}" if share.of else "-"


def _rate(rate: Rate) -> tuple[str, str]:
    if rate.high is None:
        return "-", "-"
    return f"{rate.count / rate.hours:.2f}", f"{rate.low:.2f}-{rate.high:.2f}"


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
