"""Bring a baseline of schema /1 to the present one. What the old one did not know is left unknown.

Its thresholds are kept: they were set with block counts that overstated the evidence, and its fits knew nothing of yaw
turns. So the result says that it was upgraded, and a baseline that is made anew is worth more.
"""

from typing import Any

from mavdiag.airframe.layout import layout_named
from mavdiag.baseline import SCHEMA, Baseline, sealed, validated
from mavdiag.errors import BaselineError, UsageError

__all__ = ["OLD_SCHEMA", "upgrade"]

OLD_SCHEMA = "mavdiag.baseline/1"
KINDS = {
    "latency": "fsd",
    "innovation": "innovation",
    "energy": "rotor_signature",
    "vibration": "unbalance",
    "shake": "vibration_level",
    "effort": "rotor_trim",
}


def upgrade(raw: dict[str, Any]) -> Baseline:
    """The baseline as schema /2. Raises BaselineError, naming what does not fit."""
    if raw.get("schema") != OLD_SCHEMA:
        raise BaselineError(f"schema: {raw.get('schema')!r} instead of {OLD_SCHEMA!r}; only that one can be upgraded")
    try:
        new = _converted(raw)
    except (KeyError, TypeError, ValueError, IndexError, UsageError) as error:
        raise BaselineError(f"not a whole baseline of schema /1 ({error}); make it anew") from error
    return sealed(validated(new))


def _converted(raw: dict[str, Any]) -> dict[str, Any]:
    frame = raw["airframe"]
    airframe = {"name": frame["name"], "scope": frame["scope"], "layout": _layout(frame["frame"])}
    kept = ("link", "window", "healthy_hours")
    source = dict(raw["provenance"])
    source["tool"] = f"{source['tool']}, upgraded from schema /1"
    return {
        **{name: raw[name] for name in kept},
        "schema": SCHEMA,
        "airframe": airframe,
        "monitors": [{"spec": _spec(entry["spec"], raw), "threshold": entry["threshold"]} for entry in raw["monitors"]],
        "not_judgeable": [
            {**one, "monitor": KINDS.get(one["monitor"], one["monitor"])} for one in raw["not_judgeable"]
        ],
        "provenance": source,
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
