"""Bring a baseline of schema /1 or /2 to the present one. What the old one did not know is left unknown.

Its thresholds are kept: those of /1 were set with block counts that overstated the evidence, and its fits knew nothing
of yaw turns; neither knew sessions or conditions. The rotor signature has become another statistic, so it is left out.
So the result says that it was upgraded, and a baseline that is made anew is worth more.
"""

from typing import Any

from mavdiag.airframe.layout import layout_named
from mavdiag.baseline import OLD_SCHEMAS, SCHEMA, Baseline, sealed, validated
from mavdiag.errors import BaselineError, UsageError

__all__ = ["upgrade"]

FIRST, SECOND = OLD_SCHEMAS
CHANGED = "rotor_signature"
KINDS = {
    "latency": "fsd",
    "innovation": "innovation",
    "energy": "rotor_signature",
    "vibration": "unbalance",
    "shake": "vibration_level",
    "effort": "rotor_trim",
}


def upgrade(raw: dict[str, Any]) -> Baseline:
    """The baseline in the present schema. Raises BaselineError, naming what does not fit."""
    found = raw.get("schema")
    if found not in OLD_SCHEMAS:
        raise BaselineError(f"schema: {found!r} is none of {', '.join(OLD_SCHEMAS)}; only these can be upgraded")
    try:
        new = _third(_second(raw) if found == FIRST else raw, found)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, UsageError) as error:
        raise BaselineError(f"not a whole baseline of its schema ({error}); make it anew") from error
    return sealed(validated(new))


def _third(raw: dict[str, Any], found: str) -> dict[str, Any]:
    """/3 from /2: thresholds name their sessions, and the rotor signature is left out."""
    flights = len(raw["provenance"]["logs"])
    known = {"session_allowance": 0.0, "sessions": flights}
    monitors = [
        {"spec": entry["spec"], "threshold": {**entry["threshold"], **known}}
        for entry in raw["monitors"]
        if entry["spec"]["kind"] != CHANGED
    ]
    refusals = list(raw["not_judgeable"])
    if len(monitors) < len(raw["monitors"]):
        refusals.append({"monitor": CHANGED, "reason": "its statistic has changed since; learn a baseline anew"})
    source = dict(raw["provenance"])
    source["tool"] = f"{source['tool']}, upgraded from schema {found.removeprefix('mavdiag.baseline')}"
    new = {name: value for name, value in raw.items() if name != "digest"}
    return {**new, "schema": SCHEMA, "monitors": monitors, "not_judgeable": refusals, "provenance": source}


def _second(raw: dict[str, Any]) -> dict[str, Any]:
    """/2 from /1."""
    frame = raw["airframe"]
    airframe = {"name": frame["name"], "scope": frame["scope"], "layout": _layout(frame["frame"])}
    kept = ("link", "window", "healthy_hours")
    return {
        **{name: raw[name] for name in kept},
        "schema": SECOND,
        "airframe": airframe,
        "monitors": [{"spec": _spec(entry["spec"], raw), "threshold": entry["threshold"]} for entry in raw["monitors"]],
        "not_judgeable": [
            {**one, "monitor": KINDS.get(one["monitor"], one["monitor"])} for one in raw["not_judgeable"]
        ],
        "provenance": raw["provenance"],
    }


def _spec(old: dict[str, Any], raw: dict[str, Any]) -> dict[str, Any]:
    spec = {**old, "kind": KINDS[old["kind"]]}
    delay_s = raw["window"]["samples"] // 2 * raw["link"]["dt_s"]
    if "frame" in spec:
        spec["layout"] = _layout(spec.pop("frame"))
    if spec["kind"] == "fsd":
        spec.pop("longest_run_s")
        model = {one["axis"]: one for one in raw["models"]}[spec["axis"]]
        spec["model"] = {**{key: model[key] for key in model if key not in ("axis", "rows")}, "samples": model["rows"]}
        spec["model"]["dt_s"] = raw["link"]["dt_s"]
    if spec["kind"] in ("fsd", "innovation"):
        spec["delay_s"] = delay_s
    if spec["kind"] == "rotor_signature":
        motion = dict(spec["motion"])
        for name in ("roll", "pitch", "heave"):
            a, b = motion[name]["a"], motion[name]["b"]
            dt_s = motion["dt_s"] * motion["stride"]
            motion[name] = {"a": a, "b": b, "dt_s": dt_s, "order": (len(a) - 1, len(b), 0), "method": "published"}
        spec["motion"] = motion
    return spec


def _layout(name: str | None) -> dict[str, Any] | None:
    if name is None:
        return None
    layout = layout_named(name)
    return {"name": layout.name, "signs": layout.signs, "torque_gain": layout.torque_gain}
