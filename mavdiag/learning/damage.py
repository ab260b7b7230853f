"""The least damage that a baseline would notice, and what it is worth for that: grades A to D.

A damage is put into the healthy flights by what the monitors are made of, and held against their thresholds. A rotor
that loses the share e of its thrust is commanded more (`airframe.trim.rise_of`), and the rise of this rotor that a
monitor of the trim shows is so much higher. An unbalance that was not there adds to the vibration as power does, for
its phase is any:

    v^2 = v_healthy^2 + x^2,   x = U Omega^2/m      [m/s^2] of an unbalance U

So the least e and U need no search: of the healthy values, one a second (`guards.Course`), 95 % are above the 5 %
quantile q, and what lifts q to the threshold is noticed in 95 % of the seconds of flight. Thresholds are those of
another session. What a monitor cannot reach (`Monitor.reach`) is not noticed.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.trim import MOST_LOSS, loss_of
from mavdiag.baseline import Baseline
from mavdiag.baseline_parts import Grade, LeastDamage
from mavdiag.errors import IdentificationError
from mavdiag.learning.guards import TRIMS, Course
from mavdiag.monitors import monitor_of
from mavdiag.units import G_MM_PER_KG_M

__all__ = ["accepted", "grade_of", "least_damage"]

MISSED = 0.05  # share of the seconds in which it may go unnoticed
LOSS_LIMITS = (0.10, 0.20, MOST_LOSS)  # of a rotor's thrust: grades A, B (both our choice), C
VIBRATION_LIMITS_M_S2 = (3.0, 10.0, 30.0)  # A, B, C (our choice); above 30 ArduPilot calls it too much to fly with
GRADES: tuple[Grade, ...] = ("A", "B", "C", "D")


def least_damage(found: Sequence[Course], limits: Mapping[str, float], airframe: Airframe) -> LeastDamage:
    """The least damage that is noticed in 95 % of the time. limits: thresholds of the monitors, by name."""
    rises, vibration = [], [math.inf]
    for name, limit in limits.items():
        same = [one for one in found if one.name == name and len(one.t_s)]
        if not same or limit >= monitor_of(same[0].spec).reach:
            continue
        if name in TRIMS:
            rises.append(limit - np.quantile(np.concatenate([one.rises for one in same]), MISSED, axis=0))
        elif name in ("unbalance", "vibration_level"):
            scale = same[0].spec.scale if name == "unbalance" else 1.0
            usual = float(np.quantile(np.concatenate([one.value for one in same]), MISSED))
            vibration.append(math.sqrt(max(limit**2 - usual**2, 0.0)) / scale)
    least = np.maximum(np.min(rises, axis=0), 0.0) if rises else np.empty(0)
    m_s2 = min(vibration)
    return LeastDamage(
        thrust_loss=tuple(float(f"{loss_of(a):.3g}") for a in least.tolist()),
        vibration_m_s2=float(f"{m_s2:.3g}") if math.isfinite(m_s2) else None,
        unbalance_g_mm=_unbalance(m_s2, airframe),
    )


def _unbalance(m_s2: float, airframe: Airframe) -> float | None:
    if airframe.mass_kg is None or airframe.hover_rad_s is None or not math.isfinite(m_s2):
        return None
    return float(f"{G_MM_PER_KG_M * m_s2 * airframe.mass_kg / airframe.hover_rad_s**2:.3g}")


def grade_of(least: LeastDamage, *, weak: bool, blind: Sequence[str] = ()) -> Grade:
    """A: a rotor's loss of 10 % or a vibration of 3 m/s^2 is noticed; B: 20 %, 10 m/s^2; C: a third, 30 m/s^2; else D.

    The better of the two counts, and is B at most where the other is not seen at all. C where the link shows neither:
    such a baseline judges by motion alone. weak: its flights speak against it, which is D. blind: monitors that were
    fitted and cannot reach their threshold; where no monitor of the trim can, the trim scattered too much for any, D.

    >>> grade_of(LeastDamage(thrust_loss=(0.05, 0.08, 0.05, 0.05), vibration_m_s2=1.0), weak=False)
    'A'
    >>> grade_of(LeastDamage(), weak=False, blind=("rotor_trim",)), grade_of(LeastDamage(), weak=False)
    ('D', 'C')
    """
    seen = []
    if least.thrust_loss:
        seen.append(_place(max(least.thrust_loss), LOSS_LIMITS))
    if least.vibration_m_s2 is not None:
        seen.append(_place(least.vibration_m_s2, VIBRATION_LIMITS_M_S2))
    if weak or (set(blind) & set(TRIMS) and not least.thrust_loss):
        return "D"
    if not seen:
        return "C"
    found = min(seen)
    return GRADES[max(found, 1) if len(seen) == 1 or max(seen) == len(GRADES) - 1 else found]


def _place(size: float, limits: Sequence[float]) -> int:
    return sum(size > limit for limit in limits)


def accepted(baseline: Baseline, how: str) -> Baseline:
    """The baseline, if it is worth to judge by. how: what takes it all the same.

    Raises IdentificationError for one of grade D, with the reason.
    """
    if baseline.grade != "D":
        return baseline
    blind = "; ".join(f"{one.monitor}: {one.reason}" for one in baseline.not_judgeable if "be reached" in one.reason)
    reason = baseline.weak or blind or f"it notices only {baseline.least_damage}"
    raise IdentificationError(f"baseline of grade D: {reason}; teach with other flights, or take it with {how}")
