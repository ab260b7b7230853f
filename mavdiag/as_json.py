"""Values as JSON, by one rule: a number that is not finite becomes null. Verdicts and events are public contract."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

from mavdiag.decision.diagnosis import Event, RotorSpan
from mavdiag.units import NS_PER_S

if TYPE_CHECKING:
    from mavdiag.judging import LogVerdict

DIGITS = 9  # of a figure, where it is not given to its last bit


def plain(value: Any, digits: int | None = None) -> Any:
    """The value as JSON has it: dataclasses and mappings are objects. digits: that a number keeps; None for all."""
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name), digits) for field in fields(value)}
    if isinstance(value, Mapping):
        return {key: plain(part, digits) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part, digits) for part in value]
    if not isinstance(value, float):
        return value
    known = value if digits is None else float(f"{value:.{digits}g}")
    return known if math.isfinite(value) else None


def json_line(value: Any) -> str:
    """`plain` of the value in one line of ASCII."""
    return json.dumps(plain(value), allow_nan=False)


def number(value: float | None) -> float | None:
    """Nine digits of a figure; None for what is not finite."""
    return None if value is None else plain(float(value), DIGITS)


def seconds(t_ns: int | None) -> float | None:
    """A time in seconds, to a microsecond."""
    return None if t_ns is None else round(t_ns / NS_PER_S, 6)


def spans_json(rotors: Iterable[RotorSpan]) -> list[dict[str, Any]]:
    """The rotors that were named."""
    return [{"rotor": one.rotor, "since_s": seconds(one.since_ns), "end_s": seconds(one.end_ns)} for one in rotors]


def event_json(event: Event) -> dict[str, Any]:
    """An event. Times are of the vehicle's clock; fsd_s, fml_s: of the thesis's monitor, else null."""
    figures = {"statistic": number(event.statistic), "threshold": number(event.threshold)}
    thesis = event.monitor == "fsd"
    return {
        "t_s": seconds(event.start_ns),
        "end_s": seconds(event.end_ns),
        "monitor": event.monitor,
        "axis": event.axis,
        **figures,
        "fsd_s": figures["statistic"] if thesis else None,
        "fml_s": figures["threshold"] if thesis else None,
        "rotor": event.rotor,
        "fault_type": event.fault_type,
        "severity": event.severity,
        "confidence": None if event.confidence is None else round(event.confidence, 3),
        "fault_kind": event.kind,
    }


def verdict_json(verdict: "LogVerdict") -> dict[str, Any]:
    """A verdict. Of a monitor on two axes it has the one that came nearest to its threshold."""
    return {
        "log": verdict.log,
        "verdict": verdict.verdict,
        "kind": verdict.kind,
        "since_s": None if verdict.since_s is None else round(verdict.since_s, 6),
        "rotor": verdict.rotor,
        "rotors": spans_json(verdict.rotors),
        "reason": verdict.reason,
        "notes": list(verdict.notes),
        "judged_s": round(verdict.judged_s, 3),
        "flown_s": round(verdict.flown_s, 3),
        "profile": verdict.profile,
        "rate_hz": round(verdict.rate_hz, 3),
        "monitors": {
            monitor.name: {
                "max": number(monitor.maximum),
                "threshold": number(monitor.threshold),
                "unit": monitor.unit,
                "alarms": monitor.alarms,
                "judged_s": round(monitor.judged_s, 3),
                "not_judged": monitor.not_judged,
                "outside_s": round(monitor.outside_s, 3),
                "axis": monitor.axis,
            }
            for monitor in verdict.monitors
        },
        "events": [event_json(event) for event in verdict.events],
    }
