"""The IMU (IIM-42652): lever arm, bias, noise, injected sensor faults and the on-chip filter.

    specific force at the sensor = f / m + alpha × r + omega × (omega × r)
    reading = low-pass( scale truth + bias + drift + noise )

Gyro and accelerometer pass the same second-order Butterworth low-pass, so that they share one delay.
"""

import math
from typing import NamedTuple

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.dynamics import GRAVITY, rotate_to_body
from sitl_plant.physics.jit import jit

__all__ = ["CHANNELS", "Imu", "ImuState", "SensorCondition", "advance_imu", "butterworth", "feel"]

CHANNELS = 6  # gyro x, y, z [rad/s], accelerometer x, y, z [m/s^2]


class Imu(NamedTuple):
    """Constants. position: (3,) from the centre of gravity. bias, noise: (6,), noise as rms per sample."""

    position: FloatArray
    bias: FloatArray
    noise: FloatArray
    filter: tuple[float, float, float, float, float]


class SensorCondition(NamedTuple):
    """Injected sensor faults, (6,) each: factor, offset, offset per second, extra noise rms. Healthy: 1, 0, 0, 0."""

    scale: FloatArray
    offset: FloatArray
    drift: FloatArray
    noise: FloatArray


class ImuState(NamedTuple):
    """Filter memory (6, 2), accumulated drift (6,), latest reading (6,)."""

    memory: FloatArray
    drifted: FloatArray
    reading: FloatArray


def butterworth(corner_hz: float, dt_s: float) -> tuple[float, float, float, float, float]:
    """Second-order Butterworth low-pass by the bilinear transform with prewarping: b0, b1, b2, a1, a2 (a0 = 1).

    A corner at or above the Nyquist frequency is held at 0.499 of the sample rate.
    """
    k = math.tan(math.pi * min(corner_hz * dt_s, 0.499))
    a0 = 1.0 + math.sqrt(2.0) * k + k * k
    b0 = k * k / a0
    return b0, 2.0 * b0, b0, 2.0 * (k * k - 1.0) / a0, (1.0 - math.sqrt(2.0) * k + k * k) / a0


@jit
def feel(x: FloatArray, dx: FloatArray, position: FloatArray, truth: FloatArray) -> None:
    """What ideal sensors at `position` read, into truth (6,): body rates and specific force.

    x: (13,) state row. dx: (k, 13), its derivative in row 0. position: (3,) FRD, from the centre of gravity.
    """
    p, q, r = x[10], x[11], x[12]
    dp, dq, dr = dx[0, 10], dx[0, 11], dx[0, 12]
    r_x, r_y, r_z = position[0], position[1], position[2]
    f_x, f_y, f_z = rotate_to_body(x, dx[0, 3], dx[0, 4], dx[0, 5] - GRAVITY)
    v_x, v_y, v_z = q * r_z - r * r_y, r * r_x - p * r_z, p * r_y - q * r_x  # omega × position
    truth[0], truth[1], truth[2] = p, q, r
    truth[3] = f_x + dq * r_z - dr * r_y + q * v_z - r * v_y
    truth[4] = f_y + dr * r_x - dp * r_z + r * v_x - p * v_z
    truth[5] = f_z + dp * r_y - dq * r_x + p * v_y - q * v_x


@jit
def advance_imu(
    state: ImuState, imu: Imu, condition: SensorCondition, truth: FloatArray, normals: FloatArray, row: int, dt: float
) -> None:
    """Read the sensors once. truth: (6,), normals: (steps, 6). The reading is left in `state.reading`."""
    b0, b1, b2, a1, a2 = imu.filter
    for i in range(CHANNELS):
        state.drifted[i] += condition.drift[i] * dt
        noise = np.sqrt(imu.noise[i] * imu.noise[i] + condition.noise[i] * condition.noise[i]) * normals[row, i]
        value = condition.scale[i] * truth[i] + imu.bias[i] + condition.offset[i] + state.drifted[i] + noise
        # Direct form II, transposed.
        result = b0 * value + state.memory[i, 0]
        state.memory[i, 0] = b1 * value - a1 * result + state.memory[i, 1]
        state.memory[i, 1] = b2 * value - a2 * result
        state.reading[i] = result
