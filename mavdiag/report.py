"""Verdicts and events as the JSON objects of the public contract. Non-finite numbers become null."""

import math
from typing import TypedDict

from mavdiag.decision.events import Event
from mavdiag.judging import JudgedEvent, LogVerdict, MonitorSummary

__all__ = ["EventJson", "MonitorJson", "VerdictJson", "event_json", "verdict_json"]


class EventJson(TypedDict):
    """One alarm. t_s, end_s: of the vehicle's clock [s]; fsd_s, fml_s: of the thesis rule, else null."""

    t_s: float
    end_s: float | None
    monitor: str
    axis: str | None
    statistic: float | None
    threshold: float | None
    fsd_s: float | None
    fml_s: float | None
    rotor: int | None
    fault_type: str | None
    severity: int | None
    confidence: float | None


class MonitorJson(TypedDict):
    """One monitor over a log, on the axis where it came nearest to its threshold."""

    max: float | None
    threshold: float | None
    unit: str
    alarms: int
    axis: str | None


class VerdictJson(TypedDict):
    """One log."""

    log: str
    verdict: str
    reason: str
    judged_s: float
    profile: str
    rate_hz: float
    monitors: dict[str, MonitorJson]
    events: list[EventJson]


def event_json(t_s: float, end_s: float | None, event: Event) -> EventJson:
    """An event of the contract."""
    thesis = event.monitor == "latency"
    return EventJson(
        t_s=round(t_s, 6),
        end_s=None if end_s is None else round(end_s, 6),
        monitor=event.monitor,
        axis=None if event.axis is None else event.axis.value,
        statistic=_number(event.statistic),
        threshold=_number(event.threshold),
        fsd_s=_number(event.statistic) if thesis else None,
        fml_s=_number(event.threshold) if thesis else None,
        rotor=event.rotor,
        fault_type=None if event.fault_type is None else event.fault_type.value,
        severity=event.severity,
        confidence=None if event.confidence is None else round(event.confidence, 3),
    )


def verdict_json(verdict: LogVerdict) -> VerdictJson:
    """A verdict of the contract."""
    return VerdictJson(
        log=verdict.log,
        verdict=verdict.verdict.value,
        reason=verdict.reason,
        judged_s=round(verdict.judged_s, 3),
        profile=verdict.profile,
        rate_hz=round(verdict.rate_hz, 3),
        monitors={monitor.name: _monitor(monitor) for monitor in verdict.monitors},
        events=[_judged(one) for one in verdict.events],
    )


def _judged(one: JudgedEvent) -> EventJson:
    return event_json(one.t_s, one.end_s, one.event)


def _monitor(monitor: MonitorSummary) -> MonitorJson:
    return MonitorJson(
        max=_number(monitor.maximum),
        threshold=_number(monitor.threshold),
        unit=monitor.unit,
        alarms=monitor.alarms,
        axis=None if monitor.axis is None else monitor.axis.value,
    )


def _number(value: float) -> float | None:
    return float(f"{value:.9g}") if math.isfinite(value) else None
