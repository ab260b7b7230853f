"""Reference paths: square (T 5.2, Fig 5.3), hover, circle, figure-8, the recorded t1 to t5; take-off and landing.

A path is a function of time: position and velocity in the horizontal plane, constant speed along the path, then turned
by the heading. Before t = 0 the vehicle hovers at its first point, or stands there on the ground: then it arms, idles,
climbs and begins the path at `Path.start`; at `Path.land` it stops and descends. A commanded path is led along one
`Leg` after another. Figures of take-off and landing, and of the turning nose, are our choice.

The five trajectories of DronePropA are set-points that step every 10 s, and a limiter that moves towards them (SP1: 2
m/s and 3.14 rad/s, SP2: 0.333 m/s and 0.52 rad/s). Order of the corners, way back and repetition are our choice.

    t1  diagonals of a square, corners at +-1 m            t3  climb from 0.2 to 0.8 m in steps of 0.2 m
    t2  its edges (the same square: inferred)              t4  climb from 0.2 to 0.8 m at once
    t5  yaw by 45, -45, 90, -90 degrees
"""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mavdiag.jit import cached_loop, jit
from mavdiag.telemetry import FloatArray
from sitl_plant.physics.dynamics import wrapped

SQUARE, HOVER, CIRCLE, FIGURE8, COMMANDED, RECORDED = range(6)  # places in `Shape`, the last of t1 at SP1
FIXED, ALONG, SPIN = range(3)  # places in `Nose`
REFERENCE = 9  # length of a reference row
DISARMED, IDLE, FLYING, LANDING, SHUTDOWN = 0.0, 1.0, 2.0, 3.0, 4.0  # what the motors are to do
ARM_S, LIFT_S = 2.0, 4.0  # from the ground: when the motors arm, when they lift
CLIMB_M_S, DESCENT_M_S = 0.5, 0.3
SETTLE_S = 2.0  # hover between the climb and the path
BELOW_M = 0.1  # a landing vehicle is led so far below the ground, then its motors idle where it stands
IDLE_S = 2.0  # after a landing, before the motors disarm
TURN_S = 1.5  # a turn of the nose by a right angle; peak 1.6 rad/s

DWELL_S = 10.0  # from set-point to set-point
LIMITS = {1: (2.0, 3.14), 2: (0.333, 0.52)}  # SP: m/s, rad/s
LOW_M, HIGH_M = 0.2, 0.8  # of t3 and t4
_EIGHTH = math.pi / 4
# set-points of t1 to t5: ahead, right [half sides], up [m; 0 if it does not climb], yaw [rad]; and how many of them
_LENGTHS = np.array([6, 4, 6, 2, 5])
_SETPOINTS = np.zeros((5, 6, 4))
_SETPOINTS[0, :, :2] = [[0, 0], [1, 1], [-1, -1], [0, 0], [1, -1], [-1, 1]]
_SETPOINTS[1, :4, :2] = [[1, 1], [-1, 1], [-1, -1], [1, -1]]
_SETPOINTS[2, :, 2] = [0.2, 0.4, 0.6, 0.8, 0.6, 0.4]
_SETPOINTS[3, :2, 2] = [LOW_M, HIGH_M]
_SETPOINTS[4, :5, 3] = [0.0, _EIGHTH, -_EIGHTH, 2 * _EIGHTH, -2 * _EIGHTH]


class Shape(StrEnum):
    """What the vehicle flies."""

    SQUARE = "square"
    HOVER = "hover"
    CIRCLE = "circle"
    FIGURE8 = "figure8"
    COMMANDED = "commanded"  # stand on the ground and wait for commands
    T1_SP1, T1_SP2 = "t1-sp1", "t1-sp2"
    T2_SP1, T2_SP2 = "t2-sp1", "t2-sp2"
    T3_SP1, T3_SP2 = "t3-sp1", "t3-sp2"
    T4_SP1, T4_SP2 = "t4-sp1", "t4-sp2"
    T5_SP1, T5_SP2 = "t5-sp1", "t5-sp2"

    @property
    def recorded(self) -> tuple[int, int] | None:
        """Number and speed level of a recorded trajectory: (2, 1) is t2 at SP1. None for the others."""
        return (int(self[1]), int(self[-1])) if "-sp" in self else None

    @property
    def climbs(self) -> bool:
        """Whether it is t3 or t4, which have heights of their own."""
        return self.startswith(("t3", "t4"))


class Nose(StrEnum):
    """Where the nose points while the vehicle flies."""

    FIXED = "fixed"  # along the heading
    PATH = "path"  # along the path; corners are turned in `TURN_S`
    SPIN = "spin"  # it turns steadily, whatever the path, as fast as the circle does


class Leg(NamedTuple):
    """A straight line at constant speed, with a turn of the nose beside it; the vehicle then waits at its end."""

    begin: float = 0.0  # flight time at which it starts [s]
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)  # world NED [m]
    end: tuple[float, float, float] = (0.0, 0.0, 0.0)
    speed: float = CLIMB_M_S  # along the line [m/s]
    yaw: float = 0.0  # of the nose at the start [rad]
    turn: float = 0.0  # by how much the nose turns, positive to the right [rad]
    turn_speed: float = 1.0  # [rad/s]
    motors: float = DISARMED  # what they are to do on the way
    then: float = DISARMED  # and at the end


class Path(NamedTuple):
    """A path for the compiled loop; times are flight times [s]."""

    shape: int
    size: float  # side or diameter [m]; of t1 and t2 half the side
    speed: float  # along the path [m/s]
    heading: float
    altitude: float  # above the origin, up [m]; of t3 and t4 that of the first set-point
    nose: int = FIXED
    start: float = 0.0  # the path begins; above 0 for a start on the ground
    land: float = np.inf  # the descent begins
    arm: float = ARM_S  # the motors start, if it begins on the ground
    lift: float = LIFT_S  # they lift
    turn: float = 0.0  # speed of the nose on t5 [rad/s]
    leg: Leg = Leg()  # of a commanded path, the present one


def path(
    shape: Shape,
    size_m: float,
    speed_m_s: float,
    heading_rad: float,
    altitude_m: float,
    nose: Nose = Nose.FIXED,
    takeoff: bool = False,
    land_s: float = np.inf,
    ground_s: tuple[float, float] = (ARM_S, LIFT_S),
) -> Path:
    """Make a path. `speed_m_s` is the speed along it; on the figure-8 it is the speed at the crossing.

    A recorded trajectory has its own speed, and t3 and t4 their own heights. ground_s: when the motors start and lift.
    """
    turn = 0.0
    if shape.recorded is not None:
        speed_m_s, turn = LIMITS[shape.recorded[1]]
        altitude_m = LOW_M if shape.climbs else altitude_m
    numbers = float(size_m), float(speed_m_s), float(heading_rad), float(altitude_m)
    arm, lift = ground_s
    start = lift + altitude_m / CLIMB_M_S + SETTLE_S if takeoff else 0.0
    code, look = list(Shape).index(shape), list(Nose).index(nose)
    return Path(code, *numbers, look, float(start), float(land_s), float(arm), float(lift), turn)


def landing_time(altitude_m: float, shape: Shape = Shape.HOVER) -> float:
    """How long before the end of a flight the descent must begin for the motors to be disarmed at the end [s]."""
    return ((HIGH_M if shape.climbs else altitude_m) + BELOW_M) / DESCENT_M_S + IDLE_S + 1.0


@cached_loop
def reference(path: Path, t: float, out: FloatArray) -> None:
    """Write the reference at time t [s] into out: (9,) = position_N, velocity_N, yaw, yaw rate, motors."""
    if path.shape == COMMANDED:
        follow(path.leg, t, out)
        return
    now, holds = max(min(t, path.land) - path.start, 0.0), t < path.start or t >= path.land
    if path.shape >= RECORDED:
        waypoint((path.shape - RECORDED) // 2 + 1, path.size, path.speed, path.turn, now, out)
        x, y, up, u, v, w = out[0], out[1], out[2], out[3], out[4], out[5]
        yaw, turn = wrapped(path.heading + out[6]), out[7]
        up = up if up > 0.0 else path.altitude
    else:
        x, y, u, v = _along(path, 0.0 if path.shape == HOVER else now)
        up, w, yaw, turn = path.altitude, 0.0, path.heading, 0.0
        if path.nose != FIXED:
            yaw, turn = _nose(path, u, v, now)
    if holds:
        u = v = w = turn = 0.0
    elif path.shape == HOVER:
        u = v = 0.0
    c, s = np.cos(path.heading), np.sin(path.heading)
    out[0], out[1], out[2] = c * x - s * y, s * x + c * y, -up
    out[3], out[4], out[5] = c * u - s * v, s * u + c * v, -w
    out[6], out[7], out[8] = yaw, turn, FLYING
    if path.start > 0.0:
        _vertical(path, t, out)


@jit
def _limited(way: float, speed: float, since: float) -> tuple[float, float]:
    """Share of a way that is gone after a time, and its rate [1/s]."""
    return (speed * since / way, speed / way) if speed * since < way else (1.0, 0.0)


@cached_loop
def follow(leg: Leg, t: float, out: FloatArray) -> None:
    """The reference on a leg at time t [s], into out (9,)."""
    since, way = max(t - leg.begin, 0.0), 0.0
    for i in range(3):
        way += (leg.end[i] - leg.start[i]) ** 2
    share, rate = _limited(np.sqrt(way), leg.speed, since)
    for i in range(3):
        out[i] = leg.start[i] + share * (leg.end[i] - leg.start[i])
        out[3 + i] = rate * (leg.end[i] - leg.start[i])
    turned, out[7] = leg.turn, 0.0
    if leg.turn_speed * since < abs(leg.turn):
        out[7] = np.copysign(leg.turn_speed, leg.turn)
        turned = out[7] * since
    out[6] = wrapped(leg.yaw + turned)
    out[8] = leg.motors if share < 1.0 else leg.then


@jit
def _vertical(path: Path, t: float, out: FloatArray) -> None:
    if t < path.lift:
        out[2], out[8] = 0.0, DISARMED if t < path.arm else IDLE
    elif t < path.lift + path.altitude / CLIMB_M_S:
        out[2], out[5] = -CLIMB_M_S * (t - path.lift), -CLIMB_M_S
    elif t >= path.land:
        below = DESCENT_M_S * (t - path.land) + out[2]
        out[2], out[5] = below, DESCENT_M_S
        if below > BELOW_M:
            out[8] = LANDING if below < BELOW_M + DESCENT_M_S * IDLE_S else SHUTDOWN


@jit
def _nose(path: Path, u: float, v: float, t: float) -> tuple[float, float]:
    """Yaw in [-pi, pi) and its rate, t seconds along the path."""
    rate = 2.0 * path.speed / path.size
    if path.nose == SPIN:
        return wrapped(path.heading + rate * t), rate
    if path.shape == HOVER:
        return wrapped(path.heading), 0.0
    turn, slope = np.arctan2(v, u), 0.0
    if path.shape == CIRCLE:
        slope = -rate
    elif path.shape == FIGURE8:
        # (u dv/dt - v du/dt) / (u^2 + v^2) with u ~ cos a, v ~ cos 2a
        rate /= np.sqrt(2.0)
        c, s, c2, s2 = np.cos(rate * t), np.sin(rate * t), np.cos(2.0 * rate * t), np.sin(2.0 * rate * t)
        slope = rate * (c2 * s - 2.0 * c * s2) / (c * c + c2 * c2)
    elif path.speed * t >= path.size:  # the first side of the square needs no turn
        span = min(TURN_S, path.size / path.speed)
        along = (t % (path.size / path.speed)) / span
        if along < 1.0:
            turn -= 0.25 * np.pi * (1.0 + np.cos(np.pi * along))
            slope = 0.25 * np.pi * np.pi / span * np.sin(np.pi * along)
    return wrapped(path.heading + turn), slope


@jit
def _along(path: Path, t: float) -> tuple[float, float, float, float]:
    if path.shape == SQUARE:  # ahead, right, back, left; the corners are sharp, so the velocity jumps there (T 5.2)
        side, distance = path.size, (path.speed * t) % (4.0 * path.size)
        edge = int(distance / side) % 4
        along = distance - edge * side
        if edge == 0:
            return along, 0.0, path.speed, 0.0
        if edge == 1:
            return side, along, 0.0, path.speed
        return (side - along, side, -path.speed, 0.0) if edge == 2 else (0.0, side - along, 0.0, -path.speed)
    radius = 0.5 * path.size
    rate = path.speed / radius
    a = rate * t
    if path.shape == CIRCLE:
        return radius * (1.0 - np.cos(a)), radius * np.sin(a), path.speed * np.sin(a), path.speed * np.cos(a)
    # Figure-8 (Gerono): the crossing is passed at `speed`, which is sqrt(2) radius rate here.
    a /= np.sqrt(2.0)
    rate /= np.sqrt(2.0)
    x, y = radius * np.sin(a), 0.5 * radius * np.sin(2.0 * a)
    return x, y, radius * rate * np.cos(a), radius * rate * np.cos(2.0 * a)


@jit
def waypoint(number: int, half: float, speed: float, turn: float, t: float, out: FloatArray) -> None:
    """The limited set-point of t`number` after t seconds, into out (8,): x, y, up, their rates, yaw and its rate.

    half: from the centre of the square to a set-point, along each axis [m]. up stays 0 where the path does not climb.
    """
    index, points, length = int(t / DWELL_S), _SETPOINTS[number - 1], _LENGTHS[number - 1]
    x_0, y_0, z_0, yaw_0 = points[index % length]
    x_1, y_1, z_1, yaw_1 = points[(index + 1) % length]
    d_x, d_y, d_z, d_yaw = half * (x_1 - x_0), half * (y_1 - y_0), z_1 - z_0, yaw_1 - yaw_0
    since = t - index * DWELL_S
    share, rate = _limited(math.sqrt(d_x * d_x + d_y * d_y + d_z * d_z), speed, since)
    out[0], out[1], out[2] = half * x_0 + share * d_x, half * y_0 + share * d_y, z_0 + share * d_z
    out[3], out[4], out[5] = rate * d_x, rate * d_y, rate * d_z
    out[6], out[7] = yaw_1, 0.0
    if turn * since < abs(d_yaw):
        out[7] = math.copysign(turn, d_yaw)
        out[6] = yaw_0 + out[7] * since
