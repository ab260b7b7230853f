"""What a campaign lets go wrong, by name, and how the diagnosis ought to answer (T 1.2, Tables 3.1-3.3).

Sizes besides those of the nine faults are estimates: large enough to matter in flight, small enough to fly on.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.monitors.base import FaultKind
from sitl_plant.physics.faults import FAULTS, Fault, Injection, RotorDamage, SensorFault

__all__ = ["CAUSES", "HEALTHY", "RIGHT", "Cause", "Group", "causes_named", "injections_of"]

HEALTHY = "healthy"


class Group(StrEnum):
    """Kinds of causes, by the answer that is right."""

    FAULT = "fault"  # one of T's nine: a propeller fault
    BLADE = "blade"  # other damage to a propeller: a propeller fault
    MOTOR = "motor"  # a motor at another speed than commanded: another fault, though it feels like a propeller's
    LOSS = "loss"  # a propeller gone: a gross loss of thrust
    SENSOR = "sensor"  # a gyro or accelerometer: another fault, or nothing; never a propeller fault


RIGHT: Mapping[Group, FaultKind] = {
    Group.FAULT: FaultKind.PROPELLER,
    Group.BLADE: FaultKind.PROPELLER,
    Group.MOTOR: FaultKind.PROPELLER,  # the diagnosis does not tell a motor from its propeller
    Group.LOSS: FaultKind.GROSS_LOSS,
    Group.SENSOR: FaultKind.SENSOR,
}
"""The kind of fault that is the right answer to a group."""


@dataclass(frozen=True, slots=True)
class Cause:
    """make: the cause, from the flight's random stream and the scale of the fitted terms, if it is `fitted`."""

    group: Group
    make: Callable[[np.random.Generator, float], RotorDamage | SensorFault]
    fitted: bool = False


def _fault(fault: Fault) -> Cause:
    return Cause(Group.FAULT, lambda rng, phenomenology: fault.damage(phenomenology), fitted=True)


def _rotor(group: Group, damage: RotorDamage) -> Cause:
    return Cause(group, lambda rng, phenomenology: damage)


def _imu(sensor: str, scale: float = 1.0, offset: float = 0.0, drift: float = 0.0, noise: float = 0.0) -> Cause:
    """On an axis drawn at random; offset and drift with a random sign."""

    def make(rng: np.random.Generator, phenomenology: float) -> SensorFault:
        axis, sign = int(rng.integers(3)), float(rng.choice([-1.0, 1.0]))
        return SensorFault(sensor, axis, scale, sign * offset, sign * drift, noise)

    return Cause(Group.SENSOR, make)


CAUSES: Mapping[str, Cause] = {
    **{fault.code: _fault(fault) for fault in FAULTS},
    "chipping": _rotor(Group.BLADE, RotorDamage(1.0 - 0.03, 1.03, 0.05 * 60.0)),
    "bending": _rotor(Group.BLADE, RotorDamage(1.0 - 0.04, 1.05)),
    "added-mass": _rotor(Group.BLADE, RotorDamage(unbalance_g_mm=0.05 * 50.0)),
    "texture": _rotor(Group.BLADE, RotorDamage(0.97, 1.06)),
    "motor-speed": _rotor(Group.MOTOR, RotorDamage(speed_factor=0.97)),
    "ejection": _rotor(Group.LOSS, RotorDamage(0.0, 0.0, ejected=True)),
    "gyro-bias": _imu("gyro", offset=0.05),
    "gyro-drift": _imu("gyro", drift=0.002),
    "gyro-scale": _imu("gyro", scale=1.1),
    "gyro-noise": _imu("gyro", noise=0.1),
    "accel-bias": _imu("accel", offset=0.5),
    "accel-drift": _imu("accel", drift=0.02),
    "accel-scale": _imu("accel", scale=1.1),
    "accel-noise": _imu("accel", noise=1.0),
}
"""Causes by name. Units: g and mm; gyro in rad/s, accelerometer in m/s^2, drifts per second."""


def causes_named(names: Sequence[str]) -> tuple[str, ...]:
    """The causes of some names or groups, each once. Raises UsageError for an unknown one."""
    chosen: list[str] = []
    for name in names:
        members = [cause for cause, row in CAUSES.items() if name in (cause, row.group)]
        if not members:
            raise UsageError(f"no cause {name!r}: give {', '.join([*Group, *CAUSES])}")
        chosen += members
    return tuple(dict.fromkeys(chosen))


def injections_of(
    name: str, rotor: int, onset_s: float, phenomenology: float, rng: np.random.Generator
) -> tuple[Injection, ...]:
    """What the plant is to inject from `onset_s` on; nothing for a healthy flight."""
    if name == HEALTHY:
        return ()
    return (Injection(CAUSES[name].make(rng, phenomenology), rotor, onset_s),)
