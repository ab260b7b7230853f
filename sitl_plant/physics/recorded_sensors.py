"""The two IMUs of the QDrone 2 as it was recorded: mount vibration, on-chip filters, held gyro, range and steps.

    felt    = what an ideal sensor at its place reads
            + line:  sum over rotors and h = 1, 2 of (w / w_hover)^2 (A cos h theta + B sin h theta)
            + broad: high-passed white noise, times the mean of (w / w_hover)^2
            + bias + white noise
    reading = steps( clip( hold( low-pass3( felt ) ) ) )

The line and the broad part are *levels set to the recordings*, not mechanics: the two IMUs of one drone differ by 2.2
there, so the mount makes them and not the rigid body, and they do not grow with damage. The force of an unbalanced
propeller comes in beside them through the body. The gyro is sampled at 500 Hz and held: its third-order low-pass
runs here at the plant's 1 kHz and every second value is kept, so 300 Hz comes out at 200 Hz.
"""

import math
from typing import NamedTuple

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.jit import jit
from sitl_plant.physics.rotors import RotorState
from sitl_plant.physics.sensors import CHANNELS, SensorCondition

__all__ = ["HARMONICS", "IMUS", "TwinImu", "TwinImuState", "advance_imus", "butterworth3", "high_pass"]

IMUS, HARMONICS = 2, 2


class TwinImu(NamedTuple):
    """Constants of both IMUs; arrays begin with the IMU, then gyro x, y, z, accelerometer x, y, z.

    position: (2, 3) from the centre of gravity. bias, white, broad: (2, 6), the noises as rms per sample.
    line: (2, 6, 2, n, 2) by harmonic, rotor, cosine and sine, at the hover speed [rad/s].
    shape: high-pass of the broad part, b0, b1, b2, a1, a2.
    filters: (6, 7) third-order low-pass of each channel, see `butterworth3`.
    span, lsb: (6,) range and step.
    gyro_period: steps of the plant from one gyro sample to the next.
    """

    position: FloatArray
    bias: FloatArray
    white: FloatArray
    broad: FloatArray
    line: FloatArray
    hover: float
    shape: tuple[float, float, float, float, float]
    filters: FloatArray
    span: FloatArray
    lsb: FloatArray
    gyro_period: int


class TwinImuState(NamedTuple):
    """Memory of high-pass (2, 6, 2) and low-pass (2, 6, 3), drift of IMU 0 (6,), latest readings (2, 6).

    turns: (2, n, 2) cosine and sine of each harmonic of each rotor, times (w / w_hover)^2.
    """

    shaped: FloatArray
    memory: FloatArray
    drifted: FloatArray
    reading: FloatArray
    turns: FloatArray


def butterworth3(corner_hz: float, dt_s: float) -> FloatArray:
    """Third-order Butterworth low-pass, bilinear with prewarping: (7,) first order b, a, then b0, b1, b2, a1, a2.

    (s + 1) (s^2 + s + 1), s = (1 - z^-1) / (k (1 + z^-1)); the first section's b holds for z^0 and z^-1.
    """
    k = math.tan(math.pi * corner_hz * dt_s)
    b0 = k * k / (1.0 + k + k * k)
    second = [b0, 2.0 * b0, b0, 2.0 * (k * k - 1.0) / (1.0 + k + k * k), (1.0 - k + k * k) / (1.0 + k + k * k)]
    return np.array([k / (1.0 + k), (k - 1.0) / (1.0 + k), *second])


def high_pass(corner_hz: float, dt_s: float) -> tuple[float, float, float, float, float]:
    """Second-order Butterworth high-pass by the bilinear transform with prewarping: b0, b1, b2, a1, a2."""
    k = math.tan(math.pi * corner_hz * dt_s)
    a0 = 1.0 + math.sqrt(2.0) * k + k * k
    return 1.0 / a0, -2.0 / a0, 1.0 / a0, 2.0 * (k * k - 1.0) / a0, (1.0 - math.sqrt(2.0) * k + k * k) / a0


@jit
def _turn(state: TwinImuState, imu: TwinImu, rotors: RotorState) -> float:
    """Write what the lines of each rotor follow into state.turns; returns the mean of (w / w_hover)^2."""
    mean, n = 0.0, len(rotors.speed)
    for r in range(n):
        power = (rotors.speed[r] / imu.hover) ** 2
        c, s = math.cos(rotors.azimuth[r]), math.sin(rotors.azimuth[r])
        state.turns[0, r, 0], state.turns[0, r, 1] = power * c, power * s
        state.turns[1, r, 0], state.turns[1, r, 1] = power * (c * c - s * s), power * 2.0 * s * c
        mean += power / n
    return mean


@jit
def _vibration(state: TwinImuState, imu: TwinImu, k: int, i: int, white: float, power: float) -> float:
    """Line and broad part of channel i of IMU k. power: mean of (w / w_hover)^2."""
    b0, b1, b2, a1, a2 = imu.shape
    broad = b0 * white + state.shaped[k, i, 0]
    state.shaped[k, i, 0] = b1 * white - a1 * broad + state.shaped[k, i, 1]
    state.shaped[k, i, 1] = b2 * white - a2 * broad
    value = imu.broad[k, i] * broad * power
    for h in range(HARMONICS):
        for r in range(state.turns.shape[1]):
            value += imu.line[k, i, h, r, 0] * state.turns[h, r, 0] + imu.line[k, i, h, r, 1] * state.turns[h, r, 1]
    return float(value)


@jit
def _low_pass(state: TwinImuState, imu: TwinImu, k: int, i: int, value: float) -> float:
    """The third-order filter: a first-order section, then a second-order one, both transposed direct form II."""
    middle = imu.filters[i, 0] * value + state.memory[k, i, 0]
    state.memory[k, i, 0] = imu.filters[i, 0] * value - imu.filters[i, 1] * middle
    result = imu.filters[i, 2] * middle + state.memory[k, i, 1]
    state.memory[k, i, 1] = imu.filters[i, 3] * middle - imu.filters[i, 5] * result + state.memory[k, i, 2]
    state.memory[k, i, 2] = imu.filters[i, 4] * middle - imu.filters[i, 6] * result
    return float(result)


@jit
def advance_imus(
    state: TwinImuState,
    imu: TwinImu,
    condition: SensorCondition,
    truth: FloatArray,
    rotors: RotorState,
    normals: FloatArray,
    row: int,
    step: int,
    dt: float,
) -> None:
    """Read both IMUs once, into `state.reading`. Injected sensor faults act on IMU 0.

    truth: (2, 6), what ideal sensors read. normals: (steps, 24): white and broad noise of IMU 0, then of IMU 1.
    """
    power = _turn(state, imu, rotors)
    for k in range(IMUS):
        for i in range(CHANNELS):
            at = 2 * CHANNELS * k + i
            value, noise = truth[k, i], imu.white[k, i]
            if k == 0:
                state.drifted[i] += condition.drift[i] * dt
                value = condition.scale[i] * value + condition.offset[i] + state.drifted[i]
                noise = math.sqrt(noise * noise + condition.noise[i] * condition.noise[i])
            value += imu.bias[k, i] + noise * normals[row, at]
            value += _vibration(state, imu, k, i, normals[row, at + CHANNELS], power)
            result = _low_pass(state, imu, k, i, value)
            if i >= 3 or step % imu.gyro_period == 0:
                held = min(max(result, -imu.span[i]), imu.span[i])
                state.reading[k, i] = imu.lsb[i] * np.rint(held / imu.lsb[i])
