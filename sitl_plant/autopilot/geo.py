"""Local and geographic coordinates: a plane that touches the earth at the vehicle's home."""

import math

import numpy as np

from mavdiag.telemetry import FloatArray

# PX4's home in simulation, near Zurich: the emulated vehicle flies indoors and could be anywhere.
HOME_LAT_DEG, HOME_LON_DEG, HOME_ALT_M = 47.397742, 8.545594, 488.0
EARTH_M = 6_371_000.0

_NORTH_M = EARTH_M * math.pi / 180  # of one degree
_EAST_M = _NORTH_M * math.cos(math.radians(HOME_LAT_DEG))


def to_global(position: FloatArray) -> FloatArray:
    """Latitude, longitude [deg] and altitude above the sea [m] of positions (n, 3) in world NED."""
    home = np.array([HOME_LAT_DEG, HOME_LON_DEG, HOME_ALT_M])
    return np.asarray(home + position / np.array([_NORTH_M, _EAST_M, -1.0]))


def to_local(latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """North and east of home [m]."""
    return (latitude_deg - HOME_LAT_DEG) * _NORTH_M, (longitude_deg - HOME_LON_DEG) * _EAST_M
