"""What is shown of an airframe: sentences and drawings that keep to a width, JSON, and rows of CSV. Pure."""

import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from mavdiag.archive.figures import FlightRecord
from mavdiag.braille import ACROSS, DOWN, cells, character
from mavdiag.history.stretches import Stretch, series_of
from mavdiag.history.trend import Remaining
from mavdiag.history.warn import WARNS, Outlook, Overview, Review
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

FLIGHT_COLUMNS = (
    *("airframe", "flight", "t_ns", "log", "content", "baseline", "verdict", "flight_judged_s"),
    *("monitor", "axis", "unit", "threshold", "median", "peak", "judged_s"),
)
TREND_COLUMNS = (
    *("airframe", "flights", "monitor", "axis", "unit", "threshold", "outlook", "level", "growth", "growth_error"),
    *("remaining", "remaining_low", "remaining_high", "warned_at", "changes"),
)
LEVELS = "▁▂▃▄▅▆▇█"
HEIGHT = 7  # lines of a chart
LABEL = 6  # width of its scale
TOP = 1.15  # of the threshold, at least
MOST = 2.0  # of the threshold: what is higher is drawn there
NARROW = 60  # a narrower terminal gets no sparklines
FAR = 1000  # flights: beyond it a number is no forecast

Cell = str | int | float | None


@dataclass(frozen=True, slots=True)
class Line:
    """A line of text. loud: it asks for action."""

    text: str
    loud: bool = False


def flight_json(number: int, record: FlightRecord) -> dict[str, Any]:
    """A flight. number: in the history of its airframe, from 1. What is not finite becomes null, as in all JSON."""
    told = {name: getattr(record, name) for name in ("t_ns", "log", "content", "baseline", "verdict", "reason")}
    monitors = [{name: _number(value) for name, value in asdict(slot).items()} for slot in record.slots]
    judged = {"judged_s": _number(record.judged_s), "monitors": monitors}
    return {
        "airframe": record.airframe,
        "flight": number,
        **told,
        **judged,
        "rotor_trim": [*map(_number, record.rotor_trim)],
    }


def flight_rows(number: int, record: FlightRecord) -> Iterator[tuple[Cell, ...]]:
    """A row for each monitor and axis, and for each rotor's trim; one with neither for a flight that has none."""
    told = flight_json(number, record)
    head = (*(told[name] for name in FLIGHT_COLUMNS[:7]), told["judged_s"])
    for slot in told["monitors"]:
        yield (*head, *slot.values())
    for rotor, trim in enumerate(told["rotor_trim"], 1):
        yield *head, f"trim of rotor {rotor}", None, "fraction of hover", None, trim, None, None
    if not told["monitors"]:
        yield *head, *(None,) * (len(FLIGHT_COLUMNS) - len(head))


def overview_json(overview: Overview) -> dict[str, Any]:
    """What is found of an airframe; levels and growth in shares of the threshold."""
    return {
        "airframe": overview.airframe,
        "flights": len(overview.flights),
        "last_verdict": overview.flights[-1].verdict if overview.flights else None,
        "warned": [found.series.name for found in overview.warned],
        "stretches": [
            {"first": cut.first, "began": cut.began, "flights": len(cut.flights)} for cut in overview.stretches
        ],
        "trends": [_trend_json(found) for found in overview.found],
        "rotor_growth": [*map(_number, overview.rotor_growth)],
    }


def trend_rows(overview: Overview) -> Iterator[tuple[Cell, ...]]:
    """A row for each statistic of the present stretch."""
    for found in overview.found:
        changes = " ".join(f"{change.number}:{change.step:+.3f}" for change in found.changes)
        told = _trend_json(found) | {
            "airframe": overview.airframe,
            "flights": len(overview.flights),
            "changes": changes,
        }
        yield tuple(told[name] for name in TREND_COLUMNS)


def _trend_json(found: Review) -> dict[str, Any]:
    series, trend, remaining = found.series, found.trend, found.remaining
    return {
        "monitor": series.monitor,
        "axis": series.axis,
        "unit": series.unit,
        "threshold": _number(series.threshold),
        "outlook": found.outlook.name.lower(),
        "level": _number(trend and trend.level),
        "growth": _number(trend and trend.slope),
        "growth_error": _number(trend and math.sqrt(trend.slope_variance)),
        "remaining": _number(remaining and remaining.flights),
        "remaining_low": _number(remaining and remaining.low),
        "remaining_high": _number(remaining and remaining.high),
        "warned_at": found.warned_at,
        "changes": [
            {"flight": change.number, "step": _number(change.step), "t": _number(change.t)} for change in found.changes
        ],
    }


def _number(value: Any) -> Any:
    if not isinstance(value, float):
        return value
    return float(f"{value:.9g}") if math.isfinite(value) else None


def lines_of(overview: Overview, width: int | None = None) -> tuple[Line, ...]:
    """What is said of an airframe. width: of the terminal; None for plain lines without drawings."""
    lines = [Line(_headline(overview), overview.faulty)]
    if unknown := sum(not flight.started_ns for flight in overview.flights):
        lines.append(Line(f"  {unknown} without a clock in the log, placed by when they were added; --at tells when"))
    lines += [Line(f"  {_began(stretch, n)}") for n, stretch in enumerate(overview.stretches, 1) if stretch.began]
    for found in (found for found in overview.found if found.trend is not None):
        loud = found.outlook in WARNS
        lines.append(Line(f"  {sentence(found)}", loud))
        if width is not None and width >= NARROW:
            lines.append(Line(f"    {sparkline(found.series.share, width - 4)}", loud))
    if few := [found.series.name for found in overview.found if found.trend is None]:
        lines.append(Line(f"  {Outlook.TOO_FEW.value}: {', '.join(few)}"))
    if overview.rotor_growth:
        rises = ", ".join(f"rotor {n} {rise:+.4f}" for n, rise in enumerate(overview.rotor_growth, 1))
        lines.append(Line(f"  trim since the stretch began [fraction of hover]: {rises}"))
    if width is not None and overview.found:
        lines += [Line(text) for text in _drawing(overview, width)]
    return tuple(lines) if width is None else tuple(part for line in lines for part in _wrapped(line, width))


def sentence(found: Review) -> str:
    """One statistic: how near it is, where it is heading, since when that is warned of, and where it jumped."""
    series, trend = found.series, found.trend
    told = f"{series.name}: {found.outlook.value}"
    if trend is None:
        return told
    if found.warned_at is not None:
        told += f", warned of since flight {found.warned_at} of the stretch"
    unit = f" {series.unit}" if series.unit else ""
    told += f"; {trend.level:.2f} of the threshold {series.threshold:.3g}{unit}, {trend.slope:+.4f} a flight"
    if found.outlook in (Outlook.GROWN, Outlook.WARNING) and found.remaining is not None:
        told += f", there in {_flights(found.remaining)}"
    return told + "".join(f"; jumped by {change.step:+.2f} at flight {change.number}" for change in found.changes)


def sparkline(share: FloatArray, width: int) -> str:
    """The highest share of each span of flights; a full block is the threshold. NaN is a blank.

    >>> sparkline(np.array([0.1, 0.3, 0.5, np.nan, 0.9, 1.2]), 6)
    '▁▃▄ ██'
    """
    spans = np.array_split(share, max(min(width, len(share)), 1))
    highest = [float(span[np.isfinite(span)].max(initial=-1.0)) for span in spans]
    return "".join(
        " " if peak < 0 else LEVELS[min(max(math.ceil(peak * len(LEVELS)) - 1, 0), len(LEVELS) - 1)] for peak in highest
    )


def chart(share: FloatArray, borders: Sequence[int], width: int, height: int = HEIGHT) -> tuple[str, ...]:
    """Shares as dots over the flights, with the threshold as a line and borders of stretches as bars.

    share: (n,), NaN where nothing was judged. borders: places in it where a stretch begins.
    """
    n, across, judged = max(len(share), 1), max(width - LABEL, 1), np.flatnonzero(np.isfinite(share))
    top = min(max(TOP, 1.05 * float(share[judged].max(initial=0.0))), MOST)
    columns, rows = ACROSS * across, DOWN * height
    dots = np.zeros((rows, columns), dtype=np.bool_)
    row = (share[judged].clip(0.0) / top * rows).astype(np.int64).clip(max=rows - 1)
    dots[rows - 1 - row, judged * columns // n] = True
    at = height - 1 - min(int(1.0 / top * height), height - 1)
    bars = {border * across // n for border in borders}
    lines = []
    for number, marks in enumerate(cells(dots)):
        label = "1.00" if number == at else "0.00" if number == height - 1 else ""
        empty = ["│" if cell in bars else "┄" if number == at else " " for cell in range(across)]
        text = "".join(character(mark, blank) for mark, blank in zip(marks, empty, strict=True))
        lines.append(f"{label:>{LABEL - 1}} {text}".rstrip())
    return tuple(lines)


def day(t_ns: int) -> str:
    """The day of a time, UTC.

    >>> day(1_767_225_600_000_000_000)
    '2026-01-01'
    """
    return datetime.fromtimestamp(t_ns / NS_PER_S, UTC).date().isoformat()


def _headline(overview: Overview) -> str:
    flights = overview.flights
    if not flights:
        return f"{overview.airframe}: no flights"
    count = f"{len(flights)} flight{'' if len(flights) == 1 else 's'}"
    last = flights[-1].verdict.value.replace("_", " ")
    return f"{overview.airframe}: {count}, {day(flights[0].t_ns)} to {day(flights[-1].t_ns)}; the last one {last}"


def _began(stretch: Stretch, place: int) -> str:
    if not stretch.flights:
        return f"{stretch.began} after the last flight: no trend yet"
    return f"stretch {place} from flight {stretch.first} ({stretch.began}), {len(stretch.flights)} flights"


def _flights(remaining: Remaining) -> str:
    def number(value: float) -> str:
        return f"{value:.0f}" if value <= FAR else f"over {FAR}"

    high = number(remaining.high) if math.isfinite(remaining.high) else "no end"
    return f"{number(remaining.flights)} flights ({number(remaining.low)} to {high})"


def _drawing(overview: Overview, width: int) -> tuple[str, ...]:
    """The chart of the statistic that is nearest, over all stretches."""
    first = overview.found[0].series
    parts: list[FloatArray] = []
    for stretch in overview.stretches:
        same = (series.share for series in series_of(stretch) if series.name == first.name)
        parts.append(next(same, np.full(len(stretch.flights), np.nan)))
    share = np.concatenate(parts)
    borders = [stretch.first - 1 for stretch in overview.stretches if stretch.began and stretch.flights]
    numbers = f"{'':{LABEL}}1{len(share):>{max(width - LABEL - 1, 1)}}"
    return (f"  {first.name}, peak over threshold by flight", *chart(share, borders, width), numbers)


def _wrapped(line: Line, width: int) -> Iterator[Line]:
    if len(line.text) <= width:
        yield line
        return
    indent = line.text[: len(line.text) - len(line.text.lstrip())]
    for part in textwrap.wrap(line.text, max(width, 1), subsequent_indent=indent + "  " if width > NARROW else ""):
        yield Line(part, line.loud)
