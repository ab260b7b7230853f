"""Lines that a daemon would give the live page's server: vehicles, figures, events."""

import json
import math
from collections.abc import Iterator, Mapping

from detector.states import State
from mavdiag.airframe.layout import layout_named
from mavdiag.decision.diagnosis import Stage
from mavdiag.report.drawing import airframe_svg
from mavdiag.telemetry import Axis

#: Of fleets of several sizes the vehicles that are not quiet: level and rotor.
FLEETS: Mapping[int, Mapping[int, tuple[Stage, int | None]]] = {
    0: {},
    1: {1: (Stage.QUIET, None)},
    3: {2: (Stage.FAULT, 2)},
    20: {4: (Stage.INSPECT, 1), 7: (Stage.FAULT, 3), 12: (Stage.SUSPECTED, None), 15: (Stage.NOT_JUDGED, None)},
}


def entry(number: int, text: str = "PROP monitoring", severity: int = 6, vehicle: int = 1) -> str:
    content = {"kind": "text", "utc": "2026-05-01T10:00:00.000Z", "vehicle": vehicle, "severity": severity}
    return f"J {number} {json.dumps(content | {'text': text})}"


def fleet(
    *vehicles: int, sentence: str = "No fault found.", levels: Mapping[int, tuple[Stage, int | None]] = {}
) -> str:
    """The vehicles, all quiet but those of `levels`, each with its level and rotor."""
    found = {one: levels.get(one, (Stage.QUIET, None)) for one in vehicles}
    lines = [
        {"vehicle": one, "state": "monitoring", "level": level, "rotor": rotor, "sentence": sentence, "advice": ""}
        for one, (level, rotor) in found.items()
    ]
    link = {"address": "udpin:0.0.0.0:14550", "connected": bool(vehicles), "sent": 1, "dropped": 0, "overflowed": 0}
    told = {"vehicles": lines, "links": [link], "late": 0, "cpu_s": 1.0, "uptime_s": 10.0, "refused": []}
    return f"F {json.dumps(told)}"


def about(vehicle: int, name: str = "QDrone 2") -> str:
    names = ("name", "label", "axis", "unit", "threshold", "decides", "margin")
    slots = (
        ("fsd", "FSD", "roll", "s", 0.12, False, 0.05),
        ("rotor_trim", "rotor trim", "", "fraction of hover", 0.06, True, None),
        ("vibration_level", "vibration", "", "m/s^2", 1.5, True, None),
    )
    told = {"vehicle": vehicle, "airframe": name, "profile": "qdrone2", "layout": "rotor layout x"}
    told |= {"drawing": airframe_svg(layout_named("x"), title=name)}
    return f"A {vehicle} {json.dumps(told | {'slots': [dict(zip(names, slot, strict=True)) for slot in slots]})}"


def now(vehicle: int, first: int, level: Stage = Stage.QUIET, rotor: int | None = None, sentence: str = "") -> str:
    bins = list(range(first, first + 4))
    high = [0.03 * ((number * 7) % 5 - 2) / 2 for number in bins]
    strip = {"axis": Axis.ROLL, "bins": bins, "low": [value - 0.01 for value in high], "high": high}
    values = ((0.02, ""), (0.11 if rotor else 0.01, ""), (None, "no VIBRATION"))
    shown = {
        "vehicle": vehicle,
        "level": level,
        "sentence": sentence or "2 of 3 monitors judge; nearest to its threshold is rotor trim, with 17 %.",
        "advice": "Land, then look at the propeller of motor 2 first." if rotor else "",
        "since_s": 12.0 if rotor else None,
        "rotor": rotor,
        "rises": (0.0, 0.11, -0.05, -0.06) if rotor else (0.0, 0.01, -0.01, 0.0),
        "state": State.MONITORING,
        "reason": "monitoring",
        "judged_s": 9.0,
        "flight_s": 14.0,
        "events": 0,
        "slots": [{"value": value, "reason": reason} for value, reason in values],
        "strips": [strip | {"fsd_s": [0.02] * 4, "judged": [True] * 4}],
        "track": [place for k in range(0, first, 4) for place in (round(8 * math.sin(k / 40), 2), round(k / 20, 2))],
        "link": {
            "received": 1000,
            "lost": 3,
            "silent_s": 0.0,
            "round_trip_s": 0.04,
            "drift_ppm": None,
            "rates": (("gyro", 200.0), ("VIBRATION", 0.0)),
        },
    }
    return f"N {vehicle} {json.dumps(shown)}"


def alarms(first: int, count: int) -> list[str]:
    """Alarms of a monitor that decides, one a second, each with its beginning and its end."""
    lines = []
    for number in range(count):
        alarm = {"vehicle": 1, "monitor": "rotor_trim", "axis": None, "t_s": 10.0 + number, "threshold": 0.1}
        alarm |= {"utc": "2026-05-01T10:00:00.000Z", "statistic": 0.1 + 0.01 * number}
        lines.append({"kind": "opened", "end_s": None} | alarm)
        lines.append({"kind": "event", "end_s": 11.0 + number} | alarm)
    return [f"J {number} {json.dumps(line)}" for number, line in enumerate(lines, start=first)]


def flown() -> Iterator[str]:
    """What a page shows after 20 s of a flight of vehicle 1: its strips, a text of vehicle 2, a monitor's alarms."""
    yield about(1)
    yield from (entry(1, "PROP FAULT motor 2 weak 11%", 2, 2), entry(2, "PROP monitoring"), *alarms(3, 12))
    yield from (now(1, 4 * k) for k in range(100))
