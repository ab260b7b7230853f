"""What a flight controller also needs and the plant has no model of: compass, barometer, GPS.

The home, and the field there, are those of PX4's own simulators (Zurich). The GPS has no error but its rounding. The
noises are our choice, so that no reading stands still.
"""

import math
from dataclasses import dataclass

import numpy as np

from mavdiag.telemetry import FloatArray

HOME_DEG, HOME_M = (47.397742, 8.545594), 488.0
FIELD_N = np.array([0.21523, 0.00771, 0.42741])  # gauss, NED
EARTH_M = 6_371_000.0
COMPASS_RMS, PRESSURE_RMS_HPA = 0.001, 0.01
SEA_HPA, TEMPERATURE_C = 1013.25, 20.0


@dataclass(frozen=True, slots=True)
class Fix:
    """A place: degrees, and metres above the sea."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


def fix_at(position: FloatArray) -> Fix:
    """Where (3,) NED from home [m] is, on a plane that touches the sphere at home."""
    north, east, down = position.tolist()
    latitude, longitude = HOME_DEG
    across = EARTH_M * math.cos(math.radians(latitude))
    return Fix(latitude + math.degrees(north / EARTH_M), longitude + math.degrees(east / across), HOME_M - down)


class Instruments:
    """Readings with noise; equal seeds and equal calls give equal readings."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 0x1175])

    def compass(self, quaternion: FloatArray) -> FloatArray:
        """The field (3,) in body axes [gauss]; quaternion: (4,) body to world, w first."""
        w, v = quaternion[0], quaternion[1:]
        turned = FIELD_N - 2.0 * w * np.cross(v, FIELD_N) + 2.0 * np.cross(v, np.cross(v, FIELD_N))
        return np.asarray(turned + COMPASS_RMS * self._rng.standard_normal(3))

    def pressure_hpa(self, altitude_m: float) -> float:
        """Static pressure by the standard atmosphere (ISO 2533)."""
        true = SEA_HPA * math.pow(1.0 - 2.25577e-5 * altitude_m, 5.25588)
        return true + PRESSURE_RMS_HPA * float(self._rng.standard_normal())
