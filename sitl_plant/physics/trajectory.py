"""Reference paths at constant altitude: square (T 5.2, Fig 5.3), hover, circle, figure-8.

A path is a function of time: position and velocity in the horizontal plane, constant speed along the path (the
figure-8 excepted), then turned by the heading. Before t = 0 the vehicle hovers at the first point of the path.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.jit import jit

__all__ = ["Path", "Shape", "path", "reference"]

HOVER, SQUARE, CIRCLE, FIGURE8 = 0, 1, 2, 3
TAU = 2.0 * np.pi


class Shape(StrEnum):
    """What the vehicle flies."""

    SQUARE = "square"
    HOVER = "hover"
    CIRCLE = "circle"
    FIGURE8 = "figure8"


_CODES = {Shape.HOVER: HOVER, Shape.SQUARE: SQUARE, Shape.CIRCLE: CIRCLE, Shape.FIGURE8: FIGURE8}


class Path(NamedTuple):
    """A path for the compiled loop. size: side or diameter [m]; altitude above the origin, up [m]."""

    shape: int
    size: float
    speed: float
    heading: float
    altitude: float


def path(shape: Shape, size_m: float, speed_m_s: float, heading_rad: float, altitude_m: float) -> Path:
    """Make a path. `speed_m_s` is the speed along it; on the figure-8 it is the speed at the crossing."""
    return Path(_CODES[shape], float(size_m), float(speed_m_s), float(heading_rad), float(altitude_m))


@jit
def reference(path: Path, t: float, out: FloatArray) -> None:
    """Write the reference at time t [s] into out: (8,) = position_N, velocity_N, yaw, yaw rate."""
    if t < 0.0 or path.shape == HOVER:
        x, y, u, v = _along(path, 0.0)
        u = v = 0.0
    else:
        x, y, u, v = _along(path, t)
    c, s = np.cos(path.heading), np.sin(path.heading)
    out[0], out[1], out[2] = c * x - s * y, s * x + c * y, -path.altitude
    out[3], out[4], out[5] = c * u - s * v, s * u + c * v, 0.0
    out[6], out[7] = path.heading, 0.0


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
