"""The IMU (IIM-42652): lever arm, bias, noise, injected sensor faults and the on-chip filter.

    specific force at the sensor = f / m + alpha × r + omega × (omega × r)
    reading = low-pass( scale truth + bias + drift + noise )

Gyro and accelerometer pass the same second-order Butterworth low-pass, so that they share one delay.
"""

from typing import NamedTuple

import numpy as np

from mavdiag.quantities import FloatArray
from sitl_plant.jit import jit

__all__ = ["CHANNELS", "Imu", "ImuState", "SensorCondition", "advance_imu", "butterworth", "lever_arm"]

CHANNELS = 6  # gyro x, y, z [rad/s], accelerometer x, y, z [m/s^2]


class Imu(NamedTuple):
    """Constants. position: (3,) from the centre of gravity. bias, noise: (6,), noise as rms per sample. filter: (5,)."""

    position: FloatArray
    bias: FloatArray
    noise: FloatArray
    filter: FloatArray


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


def butterworth(corner_hz: float, dt_s: float) -> FloatArray:
    """Second-order Butterworth low-pass by the bilinear transform with prewarping: (5,) = b0, b1, b2, a1, a2.

    Raises nothing; a corner at or above the Nyquist frequency is held at 0.499 of the sample rate.
    """
    k = np.tan(np.pi * min(corner_hz * dt_s, 0.499))
    a0 = 1.0 + np.sqrt(2.0) * k + k * k
    return np.array([k * k, 2.0 * k * k, k * k, 2.0 * (k * k - 1.0), 1.0 - np.sqrt(2.0) * k + k * k]) / a0


@jit
def lever_arm(dx: FloatArray, x: FloatArray, force: FloatArray, r: FloatArray, out: FloatArray) -> None:
    """Specific force (3,) at a point r of the body (FRD, from the centre of gravity) into `out`.

    force: (3,) specific force at the centre of gravity. x, dx: state row and its derivative.
    """
    p, q, s = x[10], x[11], x[12]
    dp, dq, ds = dx[10], dx[11], dx[12]
    v_x, v_y, v_z = q * r[2] - s * r[1], s * r[0] - p * r[2], p * r[1] - q * r[0]
    out[0] = force[0] + dq * r[2] - ds * r[1] + q * v_z - s * v_y
    out[1] = force[1] + ds * r[0] - dp * r[2] + s * v_x - p * v_z
    out[2] = force[2] + dp * r[1] - dq * r[0] + p * v_y - q * v_x


@jit
def advance_imu(
    state: ImuState,
    imu: Imu,
    condition: SensorCondition,
    truth: FloatArray,
    normals: FloatArray,
    dt: float,
) -> None:
    """Read the sensors once. truth, normals: (6,). The reading is left in `state.reading`."""
    b0, b1, b2, a1, a2 = imu.filter
    for i in range(CHANNELS):
        noise = np.sqrt(imu.noise[i] * imu.noise[i] + condition.noise[i] * condition.noise[i])
        state.drifted[i] += condition.drift[i] * dt
        value = condition.scale[i] * truth[i] + imu.bias[i] + condition.offset[i] + state.drifted[i]
        value += noise * normals[i]
        # Direct form II, transposed.
        result = b0 * value + state.memory[i, 0]
        state.memory[i, 0] = b1 * value - a1 * result + state.memory[i, 1]
        state.memory[i, 1] = b2 * value - a2 * result
        state.reading[i] = result
