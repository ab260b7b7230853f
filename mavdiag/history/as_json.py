"""The history as the objects of its JSON and the rows of its CSV. Numbers that are not finite become null. Pure."""

import math
from collections.abc import Iterator
from typing import Any

from mavdiag.history.overview import Found, Overview
from mavdiag.history.records import FlightRecord

__all__ = ["FLIGHT_COLUMNS", "TREND_COLUMNS", "flight_json", "flight_rows", "overview_json", "trend_rows"]

FLIGHT_COLUMNS = (
    *("airframe", "flight", "t_ns", "log", "content", "baseline", "verdict", "flight_judged_s"),
    *("monitor", "axis", "unit", "threshold", "median", "peak", "judged_s"),
)
TREND_COLUMNS = (
    *("airframe", "flights", "monitor", "axis", "unit", "threshold", "outlook", "level", "growth", "growth_error"),
    *("remaining", "remaining_low", "remaining_high", "warned_at", "changes"),
)

Cell = str | int | float | None


def flight_json(number: int, record: FlightRecord) -> dict[str, Any]:
    """A flight. number: in the history of its airframe, from 1."""
    return {
        "airframe": record.airframe,
        "flight": number,
        "t_ns": record.t_ns,
        "log": record.log,
        "content": record.content,
        "baseline": record.baseline,
        "verdict": record.verdict,
        "reason": record.reason,
        "judged_s": _number(record.judged_s),
        "monitors": [
            {
                "monitor": one.monitor,
                "axis": one.axis,
                "unit": one.unit,
                "threshold": _number(one.threshold),
                "median": _number(one.median),
                "peak": _number(one.peak),
                "judged_s": _number(one.judged_s),
            }
            for one in record.slots
        ],
        "rotor_trim": [_number(one) for one in record.rotor_trim],
    }


def flight_rows(number: int, record: FlightRecord) -> Iterator[tuple[Cell, ...]]:
    """A row for each monitor and axis, and for each rotor's trim; one with neither for a flight that has none."""
    told = (record.airframe, number, record.t_ns, record.log, record.content, record.baseline, record.verdict.value)
    head = (*told, _number(record.judged_s))
    for one in record.slots:
        figures = (_number(one.threshold), _number(one.median), _number(one.peak), _number(one.judged_s))
        yield *head, one.monitor, one.axis, one.unit, *figures
    for rotor, trim in enumerate(record.rotor_trim, 1):
        yield *head, f"trim of rotor {rotor}", None, "fraction of hover", None, _number(trim), None, None
    if not record.slots:
        yield *head, *(None,) * (len(FLIGHT_COLUMNS) - len(head))


def overview_json(overview: Overview) -> dict[str, Any]:
    """What is found of an airframe; levels and growth in shares of the threshold."""
    return {
        "airframe": overview.airframe,
        "flights": len(overview.flights),
        "last_verdict": overview.flights[-1].verdict if overview.flights else None,
        "warned": [one.series.name for one in overview.warned],
        "stretches": [
            {"first": one.first, "began": one.began, "flights": len(one.flights)} for one in overview.stretches
        ],
        "trends": [_trend_json(one) for one in overview.found],
        "rotor_growth": [_number(one) for one in overview.rotor_growth],
    }


def trend_rows(overview: Overview) -> Iterator[tuple[Cell, ...]]:
    """A row for each statistic of the present stretch."""
    for one in overview.found:
        found = _trend_json(one)
        changes = " ".join(f"{change.number}:{change.step:+.3f}" for change in one.review.changes)
        told = {**found, "airframe": overview.airframe, "flights": len(overview.flights), "changes": changes}
        yield tuple(told[name] for name in TREND_COLUMNS)


def _trend_json(found: Found) -> dict[str, Any]:
    series, trend, remaining = found.series, found.review.trend, found.review.remaining
    return {
        "monitor": series.monitor,
        "axis": series.axis,
        "unit": series.unit,
        "threshold": _number(series.threshold),
        "outlook": found.review.outlook.name.lower(),
        "level": None if trend is None else _number(trend.level),
        "growth": None if trend is None else _number(trend.slope),
        "growth_error": None if trend is None else _number(math.sqrt(trend.slope_variance)),
        "remaining": None if remaining is None else _number(remaining.flights),
        "remaining_low": None if remaining is None else _number(remaining.low),
        "remaining_high": None if remaining is None else _number(remaining.high),
        "warned_at": found.review.warned_at,
        "changes": [
            {"flight": one.number, "step": _number(one.step), "t": _number(one.t)} for one in found.review.changes
        ],
    }


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(f"{value:.9g}")
