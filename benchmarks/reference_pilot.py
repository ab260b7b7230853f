"""A small autopilot of its own, to fly the plant from outside: for the tests and benchmarks of hardware in the loop.

Position and velocity loops on the state that it is given, attitude and rate loops on gyro and attitude. It knows the
vehicle's numbers, and neither the plant nor the bytes between them.

    velocity asked  = course + 1.0 (place asked - place)          acceleration = PI of the velocity's error
    tilt, thrust    = acceleration and weight                     rates asked  = 6 (tilt error), 2.5 (heading error)
    torque          = inertia (20 e + 15 integral of e)           motors       = pseudo-inverse of the geometry
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from sitl_plant.vehicle import Vehicle, allocation

__all__ = ["Commanded", "Course", "Pilot", "Sensed", "Target"]

GRAVITY = 9.81
CLIMB_M_S, DESCENT_M_S, TURN_RAD_S = 0.5, 0.4, 0.8
ARM_S, LIFT_S, SETTLE_S, PAUSE_S = 1.0, 2.0, 2.0, 0.5
TILT_MAX = 0.5
GYRO_HZ = 80.0

Vector: TypeAlias = Sequence[float]


@dataclass(frozen=True, slots=True)
class Sensed:
    """What the autopilot knows at one instant: time, gyro FRD, position and velocity NED, attitude w first."""

    t_s: float
    gyro: Vector
    position: Vector
    velocity: Vector
    quaternion: Vector


@dataclass(frozen=True, slots=True)
class Commanded:
    """Duties 0..1 by the autopilot's motor outputs; attitude [rad], rates [rad/s] and thrust 0..1 that it asks for."""

    duties: tuple[float, ...]
    setpoint: tuple[float, float, float]
    rates: tuple[float, float, float]
    thrust: float


@dataclass(frozen=True, slots=True)
class Target:
    """Where to be: place and velocity NED, heading, and whether the motors are off, idle or flying (0, 1, 2)."""

    position: tuple[float, float, float]
    velocity: tuple[float, float, float]
    heading: float
    motors: int


@dataclass(frozen=True, slots=True)
class Course:
    """A take-off, `loops` times round a square, a turn of the nose to the right and back after each, a landing."""

    height_m: float = 1.5
    side_m: float = 2.0
    speed_m_s: float = 0.8
    loops: int = 1
    turns: bool = True

    @property
    def leg_s(self) -> float:
        """Along one side, with the pause behind it."""
        return self.side_m / self.speed_m_s + PAUSE_S

    @property
    def turn_s(self) -> float:
        """To the right, and back."""
        return 2.0 * (0.5 * math.pi / TURN_RAD_S + PAUSE_S) if self.turns else 0.0

    @property
    def up_s(self) -> float:
        """When the square begins."""
        return LIFT_S + self.height_m / CLIMB_M_S + SETTLE_S

    @property
    def down_s(self) -> float:
        """When the descent begins."""
        return self.up_s + self.loops * (4.0 * self.leg_s + self.turn_s)

    @property
    def end_s(self) -> float:
        """When the motors are off again."""
        return self.down_s + (self.height_m + 0.3) / DESCENT_M_S + 1.5

    def at(self, t_s: float) -> Target:
        """The target at a time."""
        if t_s < LIFT_S or t_s >= self.end_s:
            return Target((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, int(ARM_S <= t_s < LIFT_S))
        if t_s < self.up_s:
            height = min(self.height_m, CLIMB_M_S * (t_s - LIFT_S))
            return Target((0.0, 0.0, -height), (0.0, 0.0, 0.0 if height == self.height_m else -CLIMB_M_S), 0.0, 2)
        if t_s >= self.down_s:
            height = max(-0.3, self.height_m - DESCENT_M_S * (t_s - self.down_s))
            return Target((0.0, 0.0, -height), (0.0, 0.0, DESCENT_M_S), 0.0, 2 if height > -0.3 else 1)
        return self._loop((t_s - self.up_s) % (4.0 * self.leg_s + self.turn_s))

    def _loop(self, t_s: float) -> Target:
        leg, since = divmod(t_s, self.leg_s)
        if leg >= 4:
            half = 0.5 * self.turn_s
            since = t_s - 4.0 * self.leg_s
            heading = min(0.5 * math.pi, TURN_RAD_S * since)
            if since > half:
                heading = max(0.0, 0.5 * math.pi - TURN_RAD_S * (since - half))
            return Target((0.0, 0.0, -self.height_m), (0.0, 0.0, 0.0), heading, 2)
        corners = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0))
        (n0, e0), (n1, e1) = corners[int(leg)], corners[int(leg) + 1]
        along = min(self.side_m, self.speed_m_s * since)
        speed = self.speed_m_s if along < self.side_m else 0.0
        place = (n0 * self.side_m + (n1 - n0) * along, e0 * self.side_m + (e1 - e0) * along, -self.height_m)
        return Target(place, ((n1 - n0) * speed, (e1 - e0) * speed, 0.0), 0.0, 2)


@dataclass(slots=True)
class _Memory:
    """What the loops keep."""

    velocity: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    rate: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    gyro: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    t_s: float | None = None


class Pilot:
    """Flies one course. motors: the vehicle's rotor, from 1, at each output of the autopilot."""

    def __init__(self, vehicle: Vehicle, motors: Sequence[int], course: Callable[[float], Target]) -> None:
        self._course = course
        self._mass = vehicle.body.mass_kg
        self._inertia = vehicle.body.inertia_kg_m2
        order = np.array(motors) - 1
        self._mixer = np.linalg.pinv(allocation(vehicle)[:, order])
        full_rad_s = vehicle.battery.motor_constant_rpm_v * 2.0 * math.pi / 60.0 * vehicle.battery.nominal_v
        self._full_N = vehicle.propulsion.thrust_coefficient_n_s2 * full_rad_s**2
        self._idle = vehicle.propulsion.minimum_duty
        self._count = len(order)
        self._memory = _Memory()

    def step(self, sensed: Sensed) -> Commanded:
        """The command for what was sensed."""
        memory, target = self._memory, self._course(sensed.t_s)
        dt = 0.0 if memory.t_s is None else sensed.t_s - memory.t_s
        memory.t_s = sensed.t_s
        keep = math.exp(-2.0 * math.pi * GYRO_HZ * dt)
        memory.gyro = [keep * old + (1.0 - keep) * new for old, new in zip(memory.gyro, sensed.gyro, strict=True)]
        if target.motors < 2:
            self._memory = _Memory(gyro=memory.gyro, t_s=sensed.t_s)
            duty = self._idle if target.motors else 0.0
            return Commanded((duty,) * self._count, (0.0, 0.0, target.heading), (0.0, 0.0, 0.0), duty * duty)
        attitude, thrust_N = self._lead(sensed, target, dt)
        return self._turn(sensed, attitude, thrust_N, dt)

    def _lead(self, sensed: Sensed, target: Target, dt: float) -> tuple[tuple[float, float, float], float]:
        """Roll, pitch and heading to ask for [rad], and the thrust [N]."""
        asked, integral = [], self._memory.velocity
        for axis, (p, i) in enumerate(((2.5, 0.6), (2.5, 0.6), (4.0, 2.0))):
            wanted = target.velocity[axis] + 1.0 * (target.position[axis] - sensed.position[axis])
            error = max(-1.5, min(1.5, wanted)) - sensed.velocity[axis]
            integral[axis] = max(-3.0, min(3.0, integral[axis] + i * error * dt))
            asked.append(p * error + integral[axis])
        north, east, down = asked
        lift = max(0.3 * GRAVITY, GRAVITY - down)
        c, s = math.cos(target.heading), math.sin(target.heading)
        pitch = max(-TILT_MAX, min(TILT_MAX, math.atan2(-(c * north + s * east), lift)))
        roll = max(-TILT_MAX, min(TILT_MAX, math.atan2((c * east - s * north) * math.cos(pitch), lift)))
        _, x, y, _ = sensed.quaternion
        upright = max(0.5, 1.0 - 2.0 * (x * x + y * y))
        return (roll, pitch, target.heading), self._mass * lift / upright

    def _turn(self, sensed: Sensed, attitude: tuple[float, float, float], thrust_N: float, dt: float) -> Commanded:
        """Rates to ask for, and the motors."""
        w, x, y, z = sensed.quaternion
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        gains = (6.0, 6.0, 2.5)
        slopes = [
            gain * math.remainder(wanted - angle, 2.0 * math.pi)
            for gain, wanted, angle in zip(gains, attitude, (roll, pitch, yaw), strict=True)
        ]
        rates = (
            slopes[0] - math.sin(pitch) * slopes[2],
            math.cos(roll) * slopes[1] + math.sin(roll) * math.cos(pitch) * slopes[2],
            math.cos(roll) * math.cos(pitch) * slopes[2] - math.sin(roll) * slopes[1],
        )
        wrench, integral = [thrust_N], self._memory.rate
        for axis in range(3):
            error = rates[axis] - self._memory.gyro[axis]
            integral[axis] = max(-20.0, min(20.0, integral[axis] + 15.0 * error * dt))
            wrench.append(self._inertia[axis] * ((20.0 if axis < 2 else 8.0) * error + integral[axis]))
        shares = np.clip(self._mixer @ wrench / self._full_N, self._idle**2, 1.0)
        return Commanded(tuple(np.sqrt(shares).tolist()), attitude, rates, thrust_N / (self._count * self._full_N))
