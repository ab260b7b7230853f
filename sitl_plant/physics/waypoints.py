"""The five recorded trajectories of DronePropA: set-points that step, and a limiter that moves towards them.

    t1  diagonals of a square, corners at +-1 m from its centre
    t2  edges of the square (that it is the same square is inferred)
    t3  climb from 0.2 to 0.8 m in steps of 0.2 m
    t4  climb from 0.2 to 0.8 m at once
    t5  yaw by 45, -45, 90, -90 degrees

SP1 limits the set-point to 2 m/s and 3.14 rad/s, SP2 to 0.333 m/s and 0.52 rad/s. A new set-point comes every 10 s, as
plots of the recordings show. The order of the corners, the way back down and the repetition until the flight ends are
our choice.
"""

import math

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.jit import jit

__all__ = ["DWELL_S", "LIMITS", "RECORDED", "heights_of", "waypoint"]

RECORDED = 10  # code of t1; t2 to t5 follow
DWELL_S = 10.0  # from set-point to set-point
LIMITS = {1: (2.0, 3.14), 2: (0.333, 0.52)}  # SP: m/s, rad/s
LOW_M, HIGH_M = 0.2, 0.8  # of t3 and t4


_EIGHTH = math.pi / 4
_T1 = np.array([[0, 0], [1, 1], [-1, -1], [0, 0], [1, -1], [-1, 1]], dtype=np.float64)
_T2 = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], dtype=np.float64)
_T3 = np.array([0.2, 0.4, 0.6, 0.8, 0.6, 0.4])
_T4 = np.array([LOW_M, HIGH_M])
_T5 = np.array([0.0, _EIGHTH, -_EIGHTH, 2 * _EIGHTH, -2 * _EIGHTH])


def heights_of(number: int, altitude_m: float) -> tuple[float, float]:
    """Height of the first set-point of t`number`, and of the highest [m]. altitude_m: of those that do not climb."""
    return (LOW_M, HIGH_M) if number in (3, 4) else (altitude_m, altitude_m)


@jit
def _target(number: int, index: int) -> tuple[float, float, float, float]:
    """Set-point `index` of t`number`: ahead, right [half sides], up [m; 0 if it does not climb], yaw [rad]."""
    if number == 1:
        k = index % len(_T1)
        return _T1[k, 0], _T1[k, 1], 0.0, 0.0
    if number == 2:
        k = index % len(_T2)
        return _T2[k, 0], _T2[k, 1], 0.0, 0.0
    if number == 3:
        return 0.0, 0.0, _T3[index % len(_T3)], 0.0
    if number == 4:
        return 0.0, 0.0, _T4[index % len(_T4)], 0.0
    return 0.0, 0.0, 0.0, _T5[index % len(_T5)]


@jit
def waypoint(number: int, half: float, speed: float, turn: float, t: float, out: FloatArray) -> None:
    """The limited set-point of t`number` after t seconds, into out (8,): x, y, up, their rates, yaw and its rate.

    half: from the centre of the square to a set-point, along each axis [m]. up stays 0 where the path does not climb.
    """
    index = int(t / DWELL_S)
    x_0, y_0, z_0, yaw_0 = _target(number, index)
    x_1, y_1, z_1, yaw_1 = _target(number, index + 1)
    d_x, d_y, d_z, d_yaw = half * (x_1 - x_0), half * (y_1 - y_0), z_1 - z_0, yaw_1 - yaw_0
    since = t - index * DWELL_S
    way = math.sqrt(d_x * d_x + d_y * d_y + d_z * d_z)
    share, rate = 1.0, 0.0
    if speed * since < way:
        share, rate = speed * since / way, speed / way
    out[0], out[1], out[2] = half * x_0 + share * d_x, half * y_0 + share * d_y, z_0 + share * d_z
    out[3], out[4], out[5] = rate * d_x, rate * d_y, rate * d_z
    out[6], out[7] = yaw_1, 0.0
    if turn * since < abs(d_yaw):
        out[7] = math.copysign(turn, d_yaw)
        out[6] = yaw_0 + out[7] * since
