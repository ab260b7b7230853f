"""What can be made to go wrong in flight, as data: a cause, where, and from when on (T 1.2); T's nine propellers.

A plant holds a tuple of `Injection`s. Between two onsets nothing changes, so their effect is a pair of constant
tables for the compiled loop. Thrust loss and drag increase are from T or estimated from it; the unbalance is what T
Table 3.2 *prints*; what does not agree in T's tables is listed in `mavdiag.airframe.propellers`.

Phenomenology, **fitted, not derived**: T's own flights show residuals far above what the physics alone gives, since the
line at one per revolution hardly passes the 0.1 s smoothing window. A damaged propeller is therefore also given a slow
random fluctuation of its thrust (Ornstein-Uhlenbeck) and, for cracks, a lag of it, fitted so that T Fig 5.9, 5.10 and
Table 5.2 come out: F1 short with a low margin, F2 long with a high one, F3 long with a margin that grows with
severity (in 23 of 24 trials). `phenomenology` scales rms and lag; with 0 only the physics is left. Report all three.
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from mavdiag.airframe.propellers import PROPELLERS
from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from mavdiag.units import G_MM_PER_KG_M
from sitl_plant.physics.airframe import NEVER, Airframe, step_at
from sitl_plant.physics.rotors import Condition
from sitl_plant.physics.sensors import CHANNELS, SensorCondition

G_MM = 1.0 / G_MM_PER_KG_M  # kg m


@dataclass(frozen=True, slots=True)
class RotorDamage:
    """What happens to one rotor, as factors and additions to the healthy one.

    The unbalance adds as a vector to the rotor's own, at an angle that the injection gives or the plant draws. Half the
    thrust belongs to each blade, so a loss on one shifts the centre of lift by (1 - thrust_factor) x effective radius.
    """

    thrust_factor: float = 1.0
    drag_factor: float = 1.0
    unbalance_g_mm: float = 0.0
    fluctuation_rms: float = 0.0
    fluctuation_corner_hz: float = 1.0
    thrust_lag_s: float = 0.0
    speed_factor: float = 1.0
    ejected: bool = False

    def __post_init__(self) -> None:
        values = (self.thrust_factor, self.drag_factor, self.fluctuation_rms, self.thrust_lag_s, self.speed_factor)
        if not all(math.isfinite(value) and value >= 0.0 for value in values) or self.fluctuation_corner_hz <= 0.0:
            raise UsageError("rotor damage needs finite factors of zero or more and a positive corner frequency")

    def fitted(self, phenomenology: float) -> Self:
        """With this share of the fitted terms, 0 (physics only) to 1. Raises UsageError outside."""
        if not 0.0 <= phenomenology <= 1.0:
            raise UsageError(f"phenomenology must be 0 to 1, not {phenomenology:g}")
        rms, lag_s = phenomenology * self.fluctuation_rms, phenomenology * self.thrust_lag_s
        return replace(self, fluctuation_rms=rms, thrust_lag_s=lag_s)


@dataclass(frozen=True, slots=True)
class SensorFault:
    """reading = scale x truth + offset + drift x time since onset + noise, in SI units, on one axis of one sensor."""

    sensor: str
    axis: int
    scale: float = 1.0
    offset: float = 0.0
    drift_per_s: float = 0.0
    noise_rms: float = 0.0

    def __post_init__(self) -> None:
        if self.sensor not in ("gyro", "accel") or self.axis not in (0, 1, 2):
            raise UsageError(f"no sensor {self.sensor!r} axis {self.axis}: give gyro or accel and axis 0, 1 or 2")


@dataclass(frozen=True, slots=True)
class Injection:
    """A cause, present from onset_s of flight time on. rotor: 1..n as in T Eq 2.2-2.4; unused for sensors."""

    cause: RotorDamage | SensorFault
    rotor: int = 1
    onset_s: float = 0.0
    angle_rad: float | None = None  # of the damage in the rotor's frame; None lets the plant draw it
    name: str | None = None  # what the truth file calls it, as the code of a fault; None for a cause without a name

    def __post_init__(self) -> None:
        if not math.isfinite(self.onset_s):
            raise UsageError(f"onset_s must be a finite time, not {self.onset_s:g}")
        if self.angle_rad is not None and not math.isfinite(self.angle_rad):
            raise UsageError("angle_rad must be a finite angle")

    def first_step(self, dt_s: float) -> int:
        """First step of presence. What begins at or before 0 is present before the flight, too."""
        return -NEVER if self.onset_s <= 0.0 else step_at(self.onset_s, dt_s)


# thrust loss %, drag factor | fitted: rms %, corner Hz, lag ms
_TABLE = (
    (0.8, 1.010, 2.0, 6.0, 0.0),
    (4.3, 1.040, 2.1, 6.0, 0.0),
    (5.8, 1.060, 2.2, 6.0, 0.0),
    (0.4, 1.010, 6.0, 1.0, 4.0),
    (0.8, 1.020, 6.2, 1.0, 8.0),
    (1.2, 1.030, 6.4, 1.0, 12.0),
    (0.7, 1.010, 2.4, 1.0, 0.0),
    (1.1, 1.015, 3.8, 1.0, 0.0),
    (1.5, 1.020, 5.6, 1.0, 0.0),
)
FAULTS: Mapping[str, RotorDamage] = {
    row.code: RotorDamage(1.0 - loss / 100, drag, row.printed_g_mm, rms / 100, corner_hz, lag_ms / 1000)
    for row, (loss, drag, rms, corner_hz, lag_ms) in zip(PROPELLERS, _TABLE, strict=True)
}
"""What the nine faults do, with all of the fitted terms; by T's codes, "F1/SV1" to "F3/SV3", in T's order."""


def fault_injection(code: str, rotor: int, onset_s: float = 0.0, phenomenology: float = 1.0) -> Injection:
    """A fault of the thesis as a cause; its code may be written "f2-sv2" or "F2\\SV2". Raises UsageError otherwise."""
    match = re.fullmatch(r"F([123])\s*[/\\_-]?\s*SV([123])", code.strip(), re.IGNORECASE)
    if match is None:
        raise UsageError(f"no fault {code!r}: give F1, F2 or F3 with SV1, SV2 or SV3, as in F2/SV2")
    return Injection(FAULTS[f"F{match[1]}/SV{match[2]}"].fitted(phenomenology), rotor, onset_s, name=code)


def rotor_condition(airframe: Airframe, injections: Iterable[Injection], dt_s: float) -> Condition:
    """The rotors' condition under these causes. An injection without an angle acts at 0."""
    n = len(airframe.vehicle.rotors)
    healthy, unbalance, decay = np.ones(n), airframe.unbalance_g_mm * G_MM, np.full(n, math.exp(-2.0 * math.pi * dt_s))
    gains = healthy.copy(), healthy.copy(), healthy.copy()
    condition = Condition(*gains, unbalance, np.zeros((n, 2)), np.zeros(n), decay, np.zeros(n))
    for injection in injections:
        damage, i, angle = injection.cause, injection.rotor - 1, injection.angle_rad or 0.0
        if not isinstance(damage, RotorDamage):
            continue
        direction = np.array([math.cos(angle), math.sin(angle)])
        shift = (1.0 - damage.thrust_factor) * airframe.vehicle.propulsion.effective_radius_m
        condition.thrust_gain[i] *= damage.thrust_factor
        condition.drag_gain[i] *= damage.drag_factor
        condition.speed_gain[i] *= damage.speed_factor
        condition.unbalance[i] += damage.unbalance_g_mm * G_MM * direction
        condition.lift_offset[i] += shift * direction
        if damage.fluctuation_rms > 0.0:
            condition.fluctuation_rms[i] = math.hypot(condition.fluctuation_rms[i], damage.fluctuation_rms)
            condition.fluctuation_decay[i] = math.exp(-2.0 * math.pi * damage.fluctuation_corner_hz * dt_s)
        condition.thrust_lag[i] += damage.thrust_lag_s
        if damage.ejected:
            condition.unbalance[i] = condition.lift_offset[i] = 0.0
    usual = airframe.thrust_coefficient_n_s2 / airframe.vehicle.propulsion.thrust_coefficient_n_s2
    condition.speed_gain[:] *= loaded(condition.drag_gain * usual, airframe.vehicle.propulsion.load_share)
    return condition


def loaded(drag: FloatArray, share: float) -> FloatArray:
    """Speed at a given voltage over that with the usual drag, of motors whose resistance takes a share of the voltage.

        (1 - e) s + e d s^2 = 1        steady state u V = w/K_v + R k_q w^2/K_t over its value in hover; d: (n,) drag

    >>> loaded(np.array([1.0, 0.96]), 0.2).round(4).tolist(), loaded(np.array([0.5]), 0.0).tolist()
    ([1.0, 1.0067], [1.0])
    """
    # s = 2/(1 - e + sqrt((1 - e)^2 + 4 e d)), the root that has a limit where e d vanishes
    return np.asarray(2.0 / (1.0 - share + np.sqrt((1.0 - share) ** 2 + 4.0 * share * drag)), dtype=np.float64)


def sensor_condition(injections: Iterable[Injection]) -> SensorCondition:
    """The sensors' condition under these causes."""
    condition = SensorCondition(np.ones(CHANNELS), np.zeros(CHANNELS), np.zeros(CHANNELS), np.zeros(CHANNELS))
    for injection in injections:
        fault = injection.cause
        if isinstance(fault, SensorFault):
            channel = fault.axis + (3 if fault.sensor == "accel" else 0)
            condition.scale[channel] *= fault.scale
            condition.offset[channel] += fault.offset
            condition.drift[channel] += fault.drift_per_s
            condition.noise[channel] = math.hypot(condition.noise[channel], fault.noise_rms)
    return condition
