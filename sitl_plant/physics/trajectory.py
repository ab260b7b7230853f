"""Reference paths at constant altitude: square (T 5.2, Fig 5.3), hover, circle, figure-8; take-off and landing.

A path is a function of time: position and velocity in the horizontal plane, constant speed along the path (the
figure-8 excepted), then turned by the heading. Before t = 0 the vehicle hovers at the first point of the path, or it
stands there on the ground: then it arms, idles, climbs and begins the path at `Path.start`. At `Path.land` it stops
where it is and descends. The figures of take-off and landing, and of the turning nose, are our choice.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.attitude import wrapped
from sitl_plant.physics.jit import jit

__all__ = ["REFERENCE", "Nose", "Path", "Shape", "landing_time", "path", "reference"]

HOVER, SQUARE, CIRCLE, FIGURE8 = 0, 1, 2, 3
FIXED, ALONG, SPIN = 0, 1, 2
REFERENCE = 9  # length of a reference row
DISARMED, IDLE, FLYING, LANDING, SHUTDOWN = 0.0, 1.0, 2.0, 3.0, 4.0  # what the motors are to do
ARM_S, LIFT_S = 2.0, 4.0  # from the ground: when the motors arm, when they lift
CLIMB_M_S, DESCENT_M_S = 0.5, 0.3
SETTLE_S = 2.0  # hover between the climb and the path
BELOW_M = 0.1  # a landing vehicle is led so far below the ground, then its motors idle where it stands
IDLE_S = 2.0  # after a landing, before the motors disarm
TURN_S = 1.5  # a turn of the nose by a right angle; peak 1.6 rad/s


class Shape(StrEnum):
    """What the vehicle flies."""

    SQUARE = "square"
    HOVER = "hover"
    CIRCLE = "circle"
    FIGURE8 = "figure8"


_CODES = {Shape.HOVER: HOVER, Shape.SQUARE: SQUARE, Shape.CIRCLE: CIRCLE, Shape.FIGURE8: FIGURE8}


class Nose(StrEnum):
    """Where the nose points while the vehicle flies."""

    FIXED = "fixed"  # along the heading
    PATH = "path"  # along the path; corners are turned in `TURN_S`
    SPIN = "spin"  # it turns steadily, whatever the path, as fast as the circle does


_NOSES = {Nose.FIXED: FIXED, Nose.PATH: ALONG, Nose.SPIN: SPIN}


class Path(NamedTuple):
    """A path for the compiled loop.

    size: side or diameter [m].
    speed: along the path [m/s].
    altitude: above the origin, up [m].
    start: flight time at which the path begins [s]; above 0 for a start on the ground.
    land: flight time at which the descent begins [s].
    """

    shape: int
    size: float
    speed: float
    heading: float
    altitude: float
    nose: int = FIXED
    start: float = 0.0
    land: float = np.inf


def path(
    shape: Shape,
    size_m: float,
    speed_m_s: float,
    heading_rad: float,
    altitude_m: float,
    nose: Nose = Nose.FIXED,
    takeoff: bool = False,
    land_s: float = np.inf,
) -> Path:
    """Make a path. `speed_m_s` is the speed along it; on the figure-8 it is the speed at the crossing."""
    numbers = float(size_m), float(speed_m_s), float(heading_rad), float(altitude_m)
    start = LIFT_S + altitude_m / CLIMB_M_S + SETTLE_S if takeoff else 0.0
    return Path(_CODES[shape], *numbers, _NOSES[nose], float(start), float(land_s))


def landing_time(altitude_m: float) -> float:
    """How long before the end of a flight the descent must begin for the motors to be disarmed at the end [s]."""
    return (altitude_m + BELOW_M) / DESCENT_M_S + IDLE_S + 1.0


@jit
def reference(path: Path, t: float, out: FloatArray) -> None:
    """Write the reference at time t [s] into out: (9,) = position_N, velocity_N, yaw, yaw rate, motors."""
    now = max(min(t, path.land) - path.start, 0.0)
    x, y, u, v = _along(path, 0.0 if path.shape == HOVER else now)
    yaw, turn = path.heading, 0.0
    if path.nose != FIXED:
        yaw, turn = _nose(path, u, v, now)
    if t < path.start or t >= path.land:
        u = v = turn = 0.0
    elif path.shape == HOVER:
        u = v = 0.0
    c, s = np.cos(path.heading), np.sin(path.heading)
    out[0], out[1], out[2] = c * x - s * y, s * x + c * y, -path.altitude
    out[3], out[4], out[5] = c * u - s * v, s * u + c * v, 0.0
    out[6], out[7], out[8] = yaw, turn, FLYING
    if path.start > 0.0:
        _vertical(path, t, out)


@jit
def _vertical(path: Path, t: float, out: FloatArray) -> None:
    """Height and motors of a flight from the ground: disarmed, idle, climb, path, descent, idle, disarmed."""
    if t < LIFT_S:
        out[2], out[8] = 0.0, DISARMED if t < ARM_S else IDLE
    elif t < LIFT_S + path.altitude / CLIMB_M_S:
        out[2], out[5] = -CLIMB_M_S * (t - LIFT_S), -CLIMB_M_S
    elif t >= path.land:
        below = DESCENT_M_S * (t - path.land) - path.altitude
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
    """x, y, dx/dt, dy/dt on the unturned path."""
    if path.shape == SQUARE:
        return _square(path.size, path.speed, t)
    radius = 0.5 * path.size
    rate = path.speed / radius
    a = rate * t
    if path.shape == CIRCLE:
        return radius * (1.0 - np.cos(a)), radius * np.sin(a), path.speed * np.sin(a), path.speed * np.cos(a)
    # Figure-8 (Gerono): the crossing is passed at `speed`, which is sqrt(2) radius rate here.
    a /= np.sqrt(2.0)
    rate /= np.sqrt(2.0)
    return (
        radius * np.sin(a),
        0.5 * radius * np.sin(2.0 * a),
        radius * rate * np.cos(a),
        radius * rate * np.cos(2.0 * a),
    )


@jit
def _square(side: float, speed: float, t: float) -> tuple[float, float, float, float]:
    """Ahead, right, back, left; the corners are sharp, so the velocity jumps there (T 5.2)."""
    distance = (speed * t) % (4.0 * side)
    leg = int(distance / side) % 4
    along = distance - leg * side
    if leg == 0:
        return along, 0.0, speed, 0.0
    if leg == 1:
        return side, along, 0.0, speed
    if leg == 2:
        return side - along, side, -speed, 0.0
    return 0.0, side - along, 0.0, -speed
