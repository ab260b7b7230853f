"""Wind: gusts about a mean, or Dryden turbulence near the ground (MIL-F-8785C 3.7.3.4; MIL-STD-1797A appendix A).

By the wind W20 at 20 ft, with h the height in feet, held between 10 and 1000, and V the airspeed of the eddies:

    sigma_w = 0.1 W20                       sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4
    L_w     = h                             L_u     = L_v     = h       / (0.177 + 0.000823 h)^1.2     [ft]

    Phi_u(w)      = sigma_u^2 (2 T_u / pi) / (1 + (T_u w)^2)                        T = L / V, w > 0 [rad/s]
    Phi_v,w(w)    = sigma^2   (T / pi) (1 + 3 (T w)^2) / (1 + (T w)^2)^2

The lengths are those of MIL-F-8785C; MIL-STD-1797A writes 2 L_v and 2 L_w for the same numbers. Each spectrum is white
noise of unit intensity behind a forming filter, discretised exactly:

    G_u(s) = sigma_u sqrt(2 T_u) / (1 + T_u s)          G_v,w(s) = sigma sqrt(T) (1 + sqrt(3) T s) / (1 + T s)^2

u blows along the mean wind, v to its right, w down.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.jit import cached_loop, jit
from mavdiag.telemetry import FloatArray

M_PER_FT = 0.3048
HEIGHT_FT = (10.0, 1000.0)  # where the low-altitude model holds; below, its lowest height is used
TRANSPORT_FLOOR_M_S = 3.0  # added to the mean wind (our choice): about the wind at 3 m of which W20 = 3 to 8 tells
STRONGEST_M_S = 30.0  # W20; MIL-F-8785C calls 45 kt (23 m/s) severe


class Air(NamedTuple):
    """mean: (3,) wind, world NED [m/s]. gust_rms: each axis. decay: exp(-2 pi f_c dt).

    With decay 0 and gust_rms 1 the numbers drawn for the wind are the gusts themselves [m/s].
    """

    mean: FloatArray
    gust_rms: float
    decay: float


@jit
def advance_wind(wind: FloatArray, air: Air, normals: FloatArray, row: int) -> None:
    """Advance the wind (3,) by one step, exactly: an Ornstein-Uhlenbeck gust about the mean. normals: (steps, 3)."""
    for i in range(3):
        gust = wind[i] - air.mean[i]
        wind[i] = air.mean[i] + air.decay * gust + air.gust_rms * np.sqrt(1.0 - air.decay**2) * normals[row, i]


@dataclass(frozen=True, slots=True)
class Dryden:
    """The figures of the model: rms of u, v, w [m/s], and the time in which an eddy passes, L / V [s]."""

    rms_m_s: tuple[float, float, float]
    passing_s: tuple[float, float, float]


def dryden(w20_m_s: float, height_m: float, mean_wind_m_s: float = 0.0) -> Dryden:
    """The turbulence under a wind of `w20_m_s` at 20 ft. Raises UsageError for a wind outside 0 to 30 m/s.

    A hovering vehicle has no airspeed of its own: V is the mean wind and `TRANSPORT_FLOOR_M_S`.

    >>> [round(value, 3) for value in dryden(5.0, 1.0).rms_m_s]
    [0.981, 0.981, 0.5]
    """
    if not 0.0 <= w20_m_s <= STRONGEST_M_S:
        raise UsageError(f"turbulence must be a wind W20 of 0 to {STRONGEST_M_S:g} m/s, not {w20_m_s:g}")
    height_ft = min(max(height_m / M_PER_FT, HEIGHT_FT[0]), HEIGHT_FT[1])
    shape = 0.177 + 0.000823 * height_ft
    vertical, across = 0.1 * w20_m_s, 0.1 * w20_m_s / shape**0.4
    airspeed = abs(mean_wind_m_s) + TRANSPORT_FLOOR_M_S
    low, long = height_ft * M_PER_FT / airspeed, height_ft / shape**1.2 * M_PER_FT / airspeed
    return Dryden((across, across, vertical), (long, long, low))


class Turbulence:
    """The gusts of one flight, in order of time: how they are cut into blocks changes nothing.

    towards_rad: where the mean wind blows to; 0 is north.
    """

    def __init__(self, model: Dryden, towards_rad: float, dt_s: float, rng: np.random.Generator) -> None:
        self._rng = rng
        self._along, self._right = math.cos(towards_rad), math.sin(towards_rad)
        u, v, w = zip(model.rms_m_s, model.passing_s, strict=True)
        self._u, self._v, self._w = _First(*u, dt_s, rng), _Second(*v, dt_s, rng), _Second(*w, dt_s, rng)

    def draw(self, count: int) -> FloatArray:
        """The gusts of the next `count` steps, (count, 3) world NED [m/s]."""
        normals = self._rng.standard_normal((count, 5))
        if not count:
            return np.empty((0, 3))
        u, v, down = self._u.step(normals[:, 0]), self._v.step(normals[:, 1:3]), self._w.step(normals[:, 3:])
        return np.column_stack([self._along * u - self._right * v, self._right * u + self._along * v, down])


class _First:
    """sigma sqrt(2 T) / (1 + T s): an Ornstein-Uhlenbeck process, x' = a x + sqrt(1 - a^2) n, times sigma."""

    def __init__(self, rms: float, passing_s: float, dt_s: float, rng: np.random.Generator) -> None:
        self._rms, self._keep = rms, math.exp(-dt_s / passing_s)
        self._new = math.sqrt(-math.expm1(-2.0 * dt_s / passing_s))
        self._x = float(rng.standard_normal())
        _decayed(np.empty(0), 0.0, 0.0)  # loads it: the first gust would be late

    def step(self, normals: FloatArray) -> FloatArray:
        x = self._new * normals
        self._x = _decayed(x, self._keep, self._x)
        return self._rms * x


class _Second:
    """sigma sqrt(T) (1 + sqrt(3) T s) / (1 + T s)^2, as two equal lags z_1, z_2 in a row:

    dz_1/dt = -z_1 / T + n / sqrt(T)    dz_2/dt = (z_1 - z_2) / T    y = sigma (sqrt(3) z_1 + (1 - sqrt(3)) z_2)
    Over a step of d = dt / T:  z_1' = a z_1 + e_1,  z_2' = a (z_2 + d z_1) + e_2,  a = exp(-d), and
    cov e_i e_j = integral from 0 to d of s^(i + j - 2) exp(-2 s) ds,    stationary: [[1/2, 1/4], [1/4, 1/4]]
    """

    def __init__(self, rms: float, passing_s: float, dt_s: float, rng: np.random.Generator) -> None:
        from scipy.special import gammainc

        d = dt_s / passing_s
        self._rms, self._d, self._keep = rms, d, math.exp(-d)
        one, two, three = (float(gammainc(k, 2.0 * d)) / 2.0**k for k in (1, 2, 3))
        self._new = np.linalg.cholesky(np.array([[one, two], [two, 2.0 * three]]))
        self._z = np.linalg.cholesky(np.array([[0.5, 0.25], [0.25, 0.25]])) @ rng.standard_normal(2)

    def step(self, normals: FloatArray) -> FloatArray:
        z1, z2 = self._new[:, :1] * normals[:, 0] + self._new[:, 1:] * normals[:, 1]
        first = self._z[0]
        self._z[0] = _decayed(z1, self._keep, first)
        z2 += self._keep * self._d * np.append(first, z1[:-1])
        self._z[1] = _decayed(z2, self._keep, self._z[1])
        return np.asarray(self._rms * (math.sqrt(3.0) * z1 + (1.0 - math.sqrt(3.0)) * z2))


@cached_loop
def _decayed(x: FloatArray, keep: float, last: float) -> float:  # x_k += keep x_(k-1), and its last
    for k in range(len(x)):
        x[k] = last = keep * last + x[k]
    return last
