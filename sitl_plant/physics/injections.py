"""What can be made to go wrong in flight, as data: a cause, where, from when to when (T 1.2).

A plant holds a tuple of `Injection`s. Between two onsets or ends nothing changes, so their effect is a pair of constant
tables for the compiled loop: `Condition` for the rotors, `SensorCondition` for the IMU.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.units import G_MM_PER_KG_M
from sitl_plant.physics.airframe import Airframe
from sitl_plant.physics.rotors import Condition
from sitl_plant.physics.sensors import CHANNELS, SensorCondition

__all__ = [
    "NEVER",
    "Injection",
    "RotorDamage",
    "SensorFault",
    "added_mass",
    "bending",
    "chipping",
    "ejection",
    "rotor_condition",
    "sensor_condition",
    "speed_corruption",
    "texture",
]

G_MM = 1.0 / G_MM_PER_KG_M  # kg m
NEVER = 2**62  # a step that no flight reaches


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

    @property
    def channel(self) -> int:
        """Row of this sensor axis in the compiled tables."""
        return self.axis + (3 if self.sensor == "accel" else 0)


@dataclass(frozen=True, slots=True)
class Injection:
    """A cause, present from onset_s to end_s of flight time. rotor: 1..n as in T Eq 2.2-2.4; unused for sensors.

    angle_rad: direction of the damage in the rotor's frame; None lets the plant draw it from its seed.
    name: what the truth file calls it, as the code of a fault; None for a cause without a name.
    """

    cause: RotorDamage | SensorFault
    rotor: int = 1
    onset_s: float = 0.0
    end_s: float = math.inf
    angle_rad: float | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.onset_s) and self.end_s > self.onset_s):
            raise UsageError(f"onset_s must be a finite time before end_s, not {self.onset_s:g} and {self.end_s:g}")
        if self.angle_rad is not None and not math.isfinite(self.angle_rad):
            raise UsageError("angle_rad must be a finite angle")

    def span(self, dt_s: float) -> tuple[int, int]:
        """First step of presence and first step after it. An onset at or before 0 is present before the flight, too."""
        first = -NEVER if self.onset_s <= 0.0 else round(self.onset_s / dt_s)
        return first, NEVER if math.isinf(self.end_s) else round(self.end_s / dt_s)


def added_mass(mass_g: float, radius_mm: float) -> RotorDamage:
    """A mass that sticks to a blade."""
    return RotorDamage(unbalance_g_mm=mass_g * radius_mm)


def chipping(mass_g: float, radius_mm: float, thrust_loss: float, drag_factor: float = 1.0) -> RotorDamage:
    """A piece of a blade lost."""
    return RotorDamage(thrust_factor=1.0 - thrust_loss, drag_factor=drag_factor, unbalance_g_mm=mass_g * radius_mm)


def bending(thrust_loss: float, drag_factor: float) -> RotorDamage:
    """A bent blade: less lift on one side, more drag, no mass lost."""
    return RotorDamage(thrust_factor=1.0 - thrust_loss, drag_factor=drag_factor)


def texture(thrust_factor: float, drag_factor: float) -> RotorDamage:
    """A rough or iced surface: another lift and another drag."""
    return RotorDamage(thrust_factor=thrust_factor, drag_factor=drag_factor)


def speed_corruption(factor: float) -> RotorDamage:
    """A motor that turns at `factor` times its commanded speed."""
    return RotorDamage(speed_factor=factor)


def ejection() -> RotorDamage:
    """The propeller leaves: no thrust, no drag, no unbalance."""
    return RotorDamage(thrust_factor=0.0, drag_factor=0.0, ejected=True)


def rotor_condition(airframe: Airframe, injections: Iterable[Injection], dt_s: float) -> Condition:
    """The rotors' condition under these causes. An injection without an angle acts at 0."""
    n = len(airframe.vehicle.rotors)
    condition = Condition(
        thrust_gain=np.ones(n),
        drag_gain=np.ones(n),
        speed_gain=np.ones(n),
        unbalance=airframe.unbalance_g_mm * G_MM,
        lift_offset=np.zeros((n, 2)),
        fluctuation_rms=np.zeros(n),
        fluctuation_decay=np.full(n, math.exp(-2.0 * math.pi * dt_s)),
        thrust_lag=np.zeros(n),
    )
    for injection in injections:
        if isinstance(injection.cause, RotorDamage):
            _damage(condition, airframe, injection.cause, injection.rotor - 1, injection.angle_rad or 0.0, dt_s)
    return condition


def _damage(condition: Condition, airframe: Airframe, damage: RotorDamage, i: int, angle: float, dt_s: float) -> None:
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
        condition.unbalance[i] = 0.0
        condition.lift_offset[i] = 0.0


def sensor_condition(injections: Iterable[Injection]) -> SensorCondition:
    """The sensors' condition under these causes."""
    condition = SensorCondition(np.ones(CHANNELS), np.zeros(CHANNELS), np.zeros(CHANNELS), np.zeros(CHANNELS))
    for injection in injections:
        fault = injection.cause
        if isinstance(fault, SensorFault):
            condition.scale[fault.channel] *= fault.scale
            condition.offset[fault.channel] += fault.offset
            condition.drift[fault.channel] += fault.drift_per_s
            condition.noise[fault.channel] = math.hypot(condition.noise[fault.channel], fault.noise_rms)
    return condition
