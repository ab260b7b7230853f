"""The trend of an airframe as lines of text: a sentence for each statistic, and drawings that keep to a width. Pure."""

import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from mavdiag.braille import ACROSS, DOWN, cells, character
from mavdiag.history.overview import Found, Overview
from mavdiag.history.stretches import Stretch, series_of
from mavdiag.history.trend import Remaining
from mavdiag.history.warn import WARNS, Outlook
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

__all__ = ["Line", "chart", "day", "lines_of", "sentence", "sparkline"]

LEVELS = "▁▂▃▄▅▆▇█"
HEIGHT = 7  # lines of a chart
LABEL = 6  # width of its scale
TOP = 1.15  # of the threshold, at least
MOST = 2.0  # of the threshold: what is higher is drawn there
NARROW = 60  # a narrower terminal gets no sparklines
FAR = 1000  # flights: beyond it a number is no forecast


@dataclass(frozen=True, slots=True)
class Line:
    """A line of text. loud: it asks for action."""

    text: str
    loud: bool = False


def lines_of(overview: Overview, width: int | None = None) -> tuple[Line, ...]:
    """What is said of an airframe. width: of the terminal; None for plain lines without drawings."""
    lines = [Line(_headline(overview), overview.faulty)]
    if unknown := sum(not one.started_ns for one in overview.flights):
        lines.append(Line(f"  {unknown} without a clock in the log, placed by when they were added; --at tells when"))
    lines += [Line(f"  {_stretch(one, place)}") for place, one in enumerate(overview.stretches, 1) if one.began]
    few = [one.series.name for one in overview.found if one.review.trend is None]
    for one in (one for one in overview.found if one.review.trend is not None):
        loud = one.review.outlook in WARNS
        lines.append(Line(f"  {sentence(one)}", loud))
        if width is not None and width >= NARROW:
            lines.append(Line(f"    {sparkline(one.series.share, width - 4)}", loud))
    if few:
        lines.append(Line(f"  {Outlook.TOO_FEW.value}: {', '.join(few)}"))
    if overview.rotor_growth:
        rises = ", ".join(f"rotor {n} {rise:+.4f}" for n, rise in enumerate(overview.rotor_growth, 1))
        lines.append(Line(f"  trim since the stretch began [fraction of hover]: {rises}"))
    if width is not None and overview.found:
        lines += [Line(text) for text in _drawing(overview, width)]
    return tuple(lines) if width is None else tuple(part for line in lines for part in _wrapped(line, width))


def sentence(found: Found) -> str:
    """One statistic: how near it is, where it is heading, since when that is warned of, and where it jumped."""
    series, one = found.series, found.review
    if one.trend is None:
        return f"{series.name}: {one.outlook.value}"
    told = f"{series.name}: {one.outlook.value}"
    if one.warned_at is not None:
        told += f", warned of since flight {one.warned_at} of the stretch"
    unit = f" {series.unit}" if series.unit else ""
    told += f"; {one.trend.level:.2f} of the threshold {series.threshold:.3g}{unit}, {one.trend.slope:+.4f} a flight"
    if one.outlook in (Outlook.GROWN, Outlook.WARNING) and one.remaining is not None:
        told += f", there in {_flights(one.remaining)}"
    for change in one.changes:
        told += f"; jumped by {change.step:+.2f} at flight {change.number}"
    return told


def sparkline(share: FloatArray, width: int) -> str:
    """The highest share of each span of flights; a full block is the threshold. NaN is a blank.

    >>> sparkline(np.array([0.1, 0.3, 0.5, np.nan, 0.9, 1.2]), 6)
    '▁▃▄ ██'
    """
    count = min(width, len(share))
    drawn = []
    for part in np.array_split(share, count) if count else []:
        known = part[np.isfinite(part)]
        place = math.ceil(float(known.max()) * len(LEVELS)) - 1 if len(known) else -1
        drawn.append(LEVELS[min(max(place, 0), len(LEVELS) - 1)] if len(known) else " ")
    return "".join(drawn)


def chart(share: FloatArray, borders: Sequence[int], width: int, height: int = HEIGHT) -> tuple[str, ...]:
    """Shares as dots over the flights, with the threshold as a line and borders of stretches as bars.

    share: (n,), NaN where nothing was judged. borders: places in it where a stretch begins.
    """
    across, known = max(width - LABEL, 1), share[np.isfinite(share)]
    top = min(max(TOP, 1.05 * float(known.max(initial=0.0))), MOST)
    columns, rows = ACROSS * across, DOWN * height
    dots = np.zeros((rows, columns), dtype=np.bool_)
    for place in np.flatnonzero(np.isfinite(share)).tolist():
        column = min(place * columns // max(len(share), 1), columns - 1)
        row = rows - 1 - min(int(max(share[place], 0.0) / top * rows), rows - 1)
        dots[row, column] = True
    marks = cells(dots)
    at = height - 1 - min(int(1.0 / top * height), height - 1)
    bars = {border * across // len(share) for border in borders}
    lines = []
    for row in range(height):
        label = "1.00" if row == at else "0.00" if row == height - 1 else ""
        empty = ["│" if cell in bars else "┄" if row == at else " " for cell in range(across)]
        text = [character(mark, blank) for mark, blank in zip(marks[row], empty, strict=True)]
        lines.append(f"{label:>{LABEL - 1}} {''.join(text)}".rstrip())
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


def _stretch(stretch: Stretch, place: int) -> str:
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
        same = [one for one in series_of(stretch) if one.name == first.name]
        parts.append(same[0].share if same else np.full(len(stretch.flights), np.nan))
    share = np.concatenate(parts)
    borders = [one.first - 1 for one in overview.stretches if one.began and one.flights]
    numbers = f"{'':{LABEL}}1{len(share):>{max(width - LABEL - 1, 1)}}"
    return (f"  {first.name}, peak over threshold by flight", *chart(share, borders, width), numbers)


def _wrapped(line: Line, width: int) -> Iterator[Line]:
    """A line as lines of at most that width, indented as it is and further."""
    if len(line.text) <= width:
        yield line
        return
    indent = line.text[: len(line.text) - len(line.text.lstrip())]
    for part in textwrap.wrap(line.text, max(width, 1), subsequent_indent=indent + "  " if width > NARROW else ""):
        yield Line(part, line.loud)
