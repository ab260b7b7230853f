"""Verdicts and events as the JSON objects of the public contract. Numbers that are not finite become null."""

import math
from typing import Any

from mavdiag.decision.alarm import Event
from mavdiag.judging import LogVerdict, MonitorSummary

__all__ = ["event_json", "verdict_json"]


def event_json(t_s: float, end_s: float | None, event: Event) -> dict[str, Any]:
    """An event. t_s, end_s: of the vehicle's clock [s]; fsd_s, fml_s: of the thesis's monitor, else null."""
    thesis = event.monitor == "fsd"
    return {
        "t_s": round(t_s, 6),
        "end_s": _rounded(end_s),
        "monitor": event.monitor,
        "axis": event.axis,
        "statistic": _number(event.statistic),
        "threshold": _number(event.threshold),
        "fsd_s": _number(event.statistic) if thesis else None,
        "fml_s": _number(event.threshold) if thesis else None,
        "rotor": event.rotor,
        "fault_type": event.fault_type,
        "severity": event.severity,
        "confidence": None if event.confidence is None else round(event.confidence, 3),
        "fault_kind": event.kind,
    }


def verdict_json(verdict: LogVerdict) -> dict[str, Any]:
    """A verdict. Of a monitor on two axes it has the one that came nearest to its threshold."""
    return {
        "log": verdict.log,
        "verdict": verdict.verdict,
        "kind": verdict.kind,
        "since_s": _rounded(verdict.since_s),
        "rotor": verdict.rotor,
        "rotors": [
            {"rotor": r.rotor, "since_s": round(r.since_s, 6), "end_s": _rounded(r.end_s)} for r in verdict.rotors
        ],
        "reason": verdict.reason,
        "notes": list(verdict.notes),
        "judged_s": round(verdict.judged_s, 3),
        "flown_s": round(verdict.flown_s, 3),
        "profile": verdict.profile,
        "rate_hz": round(verdict.rate_hz, 3),
        "monitors": {monitor.name: _monitor_json(monitor) for monitor in verdict.monitors},
        "events": [event_json(one.t_s, one.end_s, one.event) for one in verdict.events],
    }


def _monitor_json(monitor: MonitorSummary) -> dict[str, Any]:
    return {
        "max": _number(monitor.maximum),
        "threshold": _number(monitor.threshold),
        "unit": monitor.unit,
        "alarms": monitor.alarms,
        "judged_s": round(monitor.judged_s, 3),
        "not_judged": monitor.not_judged,
        "outside_s": round(monitor.outside_s, 3),
        "axis": monitor.axis,
    }


def _rounded(t_s: float | None) -> float | None:
    return None if t_s is None else round(t_s, 6)


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(f"{value:.9g}")
