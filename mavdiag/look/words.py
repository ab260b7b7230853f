"""A first look as text: a paragraph of short lines for one log, one line each for several."""

import math
from collections.abc import Sequence

from mavdiag.look.figures import VIBRATION_HIGH, VIBRATION_USUAL, OutputLoad, RotorLine, Vibration
from mavdiag.look.first_look import FirstLook
from mavdiag.telemetry import Signal

__all__ = ["CLOSING", "in_full", "in_one_line"]

NOTABLE = 0.05  # of the mean output: a rotor that is told in the one line of a log (our choice)
CLOSING = "this is no verdict: that takes a baseline of flights with sound propellers (mavdiag identify)"


def in_full(look: FirstLook) -> list[str]:
    """The lines about one log."""
    flight = f"{look.flight_s:.1f} s of flight that can be judged" if not look.no_flight else look.no_flight
    lines = [f"{look.log}: profile {look.profile}, {look.span_s:.1f} s long, {flight}"]
    lines += [f"  note: {note}" for note in look.notes]
    lines += [f"  upset: {look.upset}"] if look.upset else []
    lines.append(f"  link: {_link(look)}")
    lines.append(f"  units: {_units(look)}")
    lines.append(f"  {look.rotors}")
    lines += _loads(look.loads)
    if look.trim is not None:
        shown = ", ".join(f"{axis} {getattr(look.trim, axis):+.3f}" for axis in ("roll", "pitch", "yaw"))
        lines.append(f"  trim: {shown} of the hover command; payload, balance point and wind are in it, too")
    lines.append(f"  VIBRATION: {_vibration(look.vibration)}")
    if look.line is not None:
        lines.append(f"  rotor line: {_line(look.line)}")
    works = ", ".join(look.works) or "none"
    lines.append(f"  with a baseline of such logs these monitors could judge: {works}")
    lines += [f"    {one.monitor}: {why}" for one in look.monitors for why in one.missing]
    lines.append(f"  {CLOSING}")
    return lines


def in_one_line(look: FirstLook) -> str:
    """The most that one line can say of a log."""
    if look.no_flight:
        return f"{look.log}: {look.profile}, {look.span_s:.0f} s, {look.no_flight}"
    parts = [look.profile, f"{look.flight_s:.0f} s of flight", f"{_rate(look):.0f} Hz", *filter(None, (look.upset,))]
    busiest = max(look.loads, key=lambda one: one.over_mean, default=None)
    if busiest is not None and busiest.over_mean >= NOTABLE:
        parts.append(f"motor {busiest.number} {100 * busiest.over_mean:+.1f} %")
    if look.trim is not None and not look.loads:
        parts.append(f"trim {look.trim.roll:+.3f}, {look.trim.pitch:+.3f}, {look.trim.yaw:+.3f}")
    full = max((one.full_share for one in look.loads), default=0.0)
    if full > 0:
        parts.append(f"an output at its end for {100 * full:.1f} %")
    if look.vibration is not None:
        parts.append(f"VIBRATION {max(look.vibration.high):.0f} m/s^2")
    if look.line is not None and not look.line.reason:
        parts.append(f"line at {look.line.hz:.0f} Hz")
    parts.append(f"{len(look.works)} of {len(look.monitors)} monitors could judge")
    return f"{look.log}: {', '.join(parts)}"


def _rate(look: FirstLook) -> float:
    return next((one.rate_hz or 0.0 for one in look.signals if one.signal == Signal.BODY_RATE), 0.0)


def _link(look: FirstLook) -> str:
    gyro = next((one for one in look.signals if one.signal == Signal.BODY_RATE), None)
    if gyro is None or gyro.rate_hz is None:
        return "no gyro"
    jitter = "" if gyro.jitter_ms is None else f", jitter {gyro.jitter_ms:.2f} ms"
    gaps = f"{look.gyro_gaps} gaps too long to bridge, {look.lost_s:.1f} s in all" if look.gyro_gaps else "no long gap"
    return f"gyro at {gyro.rate_hz:.1f} Hz{jitter}, {gaps}"


def _units(look: FirstLook) -> str:
    felt = "" if look.units.gravity_g is None else f"{look.units.gravity_g:.2f} g, "
    gyro = ", ".join(f"gyro {one.axis} {one.verdict}" for one in look.units.gyro)
    return f"gravity {felt}{look.units.gravity}" + (f"; {gyro}" if gyro else "")


def _loads(loads: Sequence[OutputLoad]) -> list[str]:
    if not loads:
        return ["  outputs: none in the log; no trim asymmetry by rotor and no saturation can be told"]
    shares = ", ".join(f"{one.number}: {100 * one.over_mean:+.1f} %" for one in loads)
    ends = [
        f"{one.number} at its {end} end for {100 * share:.1f} % of the flight"
        for one in loads
        for end, share in (("upper", one.full_share), ("lower", one.idle_share))
        if share > 0
    ]
    level = 100 * sum(one.mean for one in loads) / len(loads)
    return [
        f"  motors beside their mean of {level:.0f} %: {shares}",
        f"  saturation: {'; '.join(ends) if ends else 'no output reached an end'}",
    ]


def _vibration(found: Vibration | None) -> str:
    if found is None:
        return "not in the log"
    high = ", ".join(f"{axis} {level:.1f}" for axis, level in zip("xyz", found.high, strict=True))
    text = f"{high} m/s^2 (95 % of the time below)"
    if found.above_high > 0:
        text += f"; {100 * found.above_high:.1f} % above {VIBRATION_HIGH:.0f}, where ArduPilot expects trouble"
    elif found.above_usual > 0:
        text += f"; {100 * found.above_usual:.1f} % above {VIBRATION_USUAL:.0f}, up to which ArduPilot accepts it"
    else:
        text += f"; never above {VIBRATION_USUAL:.0f}, up to which ArduPilot accepts it"
    return text


def _line(found: RotorLine) -> str:
    told = "" if math.isnan(found.told_hz) else f"; the rotors turn at {found.told_hz:.0f} Hz by their own telemetry"
    if found.reason:
        return f"not heard: {found.reason}{told}"
    also = "".join(f", and at {n} times that" for n in found.harmonics)
    where = f"looked for from {found.from_hz:.0f} to {found.to_hz:.0f} Hz"
    return f"{found.hz:.0f} Hz, {found.db:.0f} dB above its neighbourhood{also} ({where}){told}"
