"""What is shown of an airframe: sentences, and JSON. Pure."""

import math
from datetime import UTC, datetime
from typing import Any, NamedTuple

from mavdiag.archive.figures import FlightRecord
from mavdiag.as_json import DIGITS, plain
from mavdiag.history.trend import Trend
from mavdiag.history.warn import WARNS, Outlook, Overview, Review
from mavdiag.printable import counted
from mavdiag.units import NS_PER_S

FAR = 1000  # flights: beyond it a number is no forecast


class Line(NamedTuple):
    """A line of text. loud: it asks for action."""

    text: str
    loud: bool = False


def flight_json(number: int, record: FlightRecord) -> dict[str, Any]:
    """A flight. number: in the history of its airframe, from 1."""
    names = ("t_ns", "log", "content", "baseline", "verdict", "reason", "judged_s", "slots", "rotor_trim", "trim")
    told = {"monitors" if name == "slots" else name: getattr(record, name) for name in names}
    found: dict[str, Any] = plain({"airframe": record.airframe, "flight": number, **told}, DIGITS)
    return found


def overview_json(overview: Overview) -> dict[str, Any]:
    """What is found of an airframe; levels and growth in shares of the threshold."""
    return {
        "airframe": overview.airframe,
        "flights": len(overview.flights),
        "last_verdict": overview.flights[-1].verdict if overview.flights else None,
        "warned": [found.series.name for found in overview.warned],
        "stretches": [{"first": s.first, "began": s.began, "flights": len(s.flights)} for s in overview.stretches],
        "trends": [_trend_json(found) for found in overview.found],
        "rotor_growth": plain(overview.rotor_growth, DIGITS),
        "together": overview.together and overview.together.as_json(),
    }


def _trend_json(found: Review) -> dict[str, Any]:
    series, trend = found.series, found.trend
    remaining = trend and trend.remaining()
    told = {
        **{name: getattr(series, name) for name in ("monitor", "axis", "unit", "threshold")},
        "outlook": found.outlook.name.lower(),
        "level": trend and trend.level,
        "growth": trend and trend.slope,
        "growth_error": trend and math.sqrt(trend.slope_variance),
        **dict(zip(("remaining", "remaining_low", "remaining_high"), remaining or (None,) * 3, strict=True)),
        "warned_at": found.warned_at,
        "changes": [{"flight": change.number, "step": change.step, "t": change.t} for change in found.changes],
    }
    rounded: dict[str, Any] = plain(told, DIGITS)
    return rounded


def lines_of(overview: Overview) -> tuple[Line, ...]:
    """What is said of an airframe."""
    lines = [Line(_headline(overview), overview.faulty)]
    if unknown := sum(not flight.started_ns for flight in overview.flights):
        lines.append(Line(f"  {unknown} without a clock in the log, placed by when they were added (--at, --ordered)"))
    for number, stretch in enumerate(overview.stretches, 1):
        if stretch.began and stretch.flights:
            place = f"stretch {number} from flight {stretch.first} ({stretch.began})"
            lines.append(Line(f"  {place}, {counted(len(stretch.flights), 'flight')}"))
        elif stretch.began:
            lines.append(Line(f"  {stretch.began} after the last flight: no trend yet"))
    if overview.together is not None:
        lines.append(Line(f"  {overview.together}", overview.together.changed))
    trends = ((found, found.trend) for found in overview.found if found.trend is not None)
    lines += [Line(f"  {_sentence(found, trend)}", found.outlook in WARNS) for found, trend in trends]
    if few := [found.series.name for found in overview.found if found.trend is None]:
        lines.append(Line(f"  {Outlook.TOO_FEW.value}: {', '.join(few)}"))
    if overview.rotor_growth:
        rises = ", ".join(f"rotor {n} {100 * rise:+.2f}" for n, rise in enumerate(overview.rotor_growth, 1))
        lines.append(Line(f"  trim since the stretch began [% of hover]: {rises}"))
    return tuple(lines)


def _headline(overview: Overview) -> str:
    flights = overview.flights
    count, last = counted(len(flights), "flight"), flights[-1].verdict.value
    span = f"{day(flights[0].t_ns)} to {day(flights[-1].t_ns)}"
    return f"{overview.airframe}: {count}, {span}; the last one {last.replace('_', ' ')}"


def _sentence(found: Review, trend: Trend) -> str:
    series, told = found.series, f"{found.series.name}: {found.outlook.value}"
    if found.warned_at is not None:
        told += f", warned of since flight {found.warned_at} of the stretch"
    unit = f" {series.unit}" if series.unit else ""
    told += f"; {trend.level:.2f} of the threshold {series.threshold:.3g}{unit}"
    told += f", {slope:+.4f} a flight" if (slope := round(trend.slope, 4)) else ""
    if found.outlook in (Outlook.GROWN, Outlook.WARNING) and (remaining := trend.remaining()) is not None:
        best, low, high = (f"{value:.0f}" if value <= FAR else f"over {FAR}" for value in remaining)
        told += f", there in {best} flights ({low} to {high if math.isfinite(remaining.high) else 'no end'})"
    return told + "".join(f"; jumped by {change.step:+.2f} at flight {change.number}" for change in found.changes)


def day(t_ns: int) -> str:
    """The day of a time, UTC."""
    return datetime.fromtimestamp(t_ns / NS_PER_S, UTC).date().isoformat()
