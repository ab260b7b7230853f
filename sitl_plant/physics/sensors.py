"""The IMUs: what they feel, what lies between them and the airframe, noise, bias, injected faults, on-chip filters.

The specific force at a point r from the centre of gravity is

    f = R^T (dv/dt - g) + domega/dt × r + omega × (omega × r)

The thesis's vehicle has one IMU behind a second-order Butterworth low-pass. Between it and the airframe there may be a
soft mount, or an arm that resonates: one mode driven by its base, bilinear, prewarped at w0, the same for translation,
roll and pitch (our choice). Yaw passes as it is: behind a mode at 50 or 25 Hz the yaw loop of the QDrone 2 oscillates.

    H(s) = (2 zeta w0 s + w0^2) / (s^2 + 2 zeta w0 s + w0^2)

A vehicle as it was recorded has two IMUs, with

    felt    = what an ideal sensor at its place reads + bias + white noise
            + line:  sum over rotors and h = 1, 2 of (w / w_hover)^2 (A cos h theta + B sin h theta)
            + broad: high-passed white noise, times the mean of (w / w_hover)^2
    reading = steps( clip( hold( low-pass3( felt ) ) ) )

Line and broad part are *levels set to the recordings*, not mechanics: they do not grow with damage. The gyro is sampled
at 500 Hz and held: its low-pass runs here at 1 kHz and every second value is kept, so 300 Hz comes out at 200 Hz.
"""

import math
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.jit import jit
from mavdiag.telemetry import FloatArray
from sitl_plant.physics.dynamics import GRAVITY, rotate_to_body
from sitl_plant.physics.rotors import RotorState

CHANNELS = 6  # gyro x, y, z [rad/s], accelerometer x, y, z [m/s^2]
YAW_RATE = 2  # among them
IMUS, HARMONICS = 2, 2  # of a vehicle as it was recorded

Biquad: TypeAlias = tuple[float, float, float, float, float]
"""b0, b1, b2, a1, a2 of a second-order section, a0 = 1."""


RIGID: Biquad = (1.0, 0.0, 0.0, 0.0, 0.0)  # a mount that passes everything


class Imu(NamedTuple):
    """Constants. position: (3,) from the centre of gravity. bias, noise: (6,), noise as rms per sample."""

    position: FloatArray
    bias: FloatArray
    noise: FloatArray
    filter: Biquad
    mount: Biquad = RIGID


class SensorCondition(NamedTuple):
    """Injected sensor faults, (6,) each: factor, offset, offset per second, extra noise rms. Healthy: 1, 0, 0, 0."""

    scale: FloatArray
    offset: FloatArray
    drift: FloatArray
    noise: FloatArray


class ImuState(NamedTuple):
    """Filter memory (6, 2), accumulated drift (6,), latest reading (6,), memory of the mount (6, 2)."""

    memory: FloatArray
    drifted: FloatArray
    reading: FloatArray
    mounted: FloatArray


class TwinImu(NamedTuple):
    """Both IMUs: constants, whose arrays begin with the IMU, then the channel, and from `shaped` on what changes."""

    position: FloatArray  # (2, 3) from the centre of gravity
    bias: FloatArray  # (2, 6)
    white: FloatArray  # (2, 6) rms per sample, as of the next
    broad: FloatArray  # (2, 6)
    line: FloatArray  # (2, 6, 2, n, 2) by harmonic, rotor, cosine and sine, at the hover speed
    hover: float  # [rad/s]
    shape: Biquad  # high-pass of the broad part
    filters: FloatArray  # (6, 2, 5) third-order Butterworth low-pass of each channel: two sections, one after the other
    span: FloatArray  # (6,)
    lsb: FloatArray  # (6,)
    gyro_period: int  # steps of the plant from one gyro sample to the next
    shaped: FloatArray  # (12, 2) memory of the high-pass
    memory: FloatArray  # (12, 4) of the low-pass
    drifted: FloatArray  # (6,) of IMU 0
    reading: FloatArray  # (2, 6) the latest
    turns: FloatArray  # (2, n, 2) cosine and sine of each harmonic of each rotor, times (w / w_hover)^2


def butterworth(corner_hz: float, dt_s: float, kind: Literal["lowpass", "highpass"] = "lowpass") -> Biquad:
    """Second-order Butterworth filter by the bilinear transform: `mode` with a damping of 1/sqrt(2) has its poles.

    A corner at or above half the sample rate is held at 0.499 of that rate. scipy.signal has the same, and every start
    of the plant would take a second more to load it.
    """
    k = math.tan(math.pi * min(corner_hz * dt_s, 0.499))
    lossy = math.sqrt(2.0) * k
    a0 = 1.0 + lossy + k * k
    b0, b1 = (k * k / a0, 2.0 * k * k / a0) if kind == "lowpass" else (1.0 / a0, -2.0 / a0)
    return b0, b1, b0, 2.0 * (k * k - 1.0) / a0, (1.0 - lossy + k * k) / a0


def gain_of(section: Biquad | FloatArray, at_hz: float | FloatArray, dt_s: float) -> FloatArray:
    """|H| of a section at some frequencies."""
    b0, b1, b2, a1, a2 = section
    w = np.exp(-2j * np.pi * at_hz * dt_s)
    return np.asarray(np.abs((b0 + b1 * w + b2 * w * w) / (1.0 + a1 * w + a2 * w * w)))


def mode(resonance_hz: float, damping: float, dt_s: float) -> Biquad:
    """The mount with a mode at `resonance_hz`. Raises UsageError outside 0 to 0.45 of the sample rate.

    >>> round(float(gain_of(mode(100.0, 0.05, 0.001), 100.0, 0.001)), 2)    # sqrt(1 + 1 / (2 zeta)^2)
    10.05
    """
    if not (0.0 < resonance_hz <= 0.45 / dt_s and damping > 0.0):
        raise UsageError(f"a mount needs a resonance of 0 to {0.45 / dt_s:g} Hz and damping, not {resonance_hz:g} Hz")
    k = math.tan(math.pi * resonance_hz * dt_s)
    lossy = 2.0 * damping * k
    a0 = 1.0 + lossy + k * k
    b0, b2 = (lossy + k * k) / a0, (k * k - lossy) / a0
    return b0, 2.0 * k * k / a0, b2, 2.0 * (k * k - 1.0) / a0, (1.0 - lossy + k * k) / a0


def isolating_hz(line_hz: float, share: float, damping: float, dt_s: float) -> float:
    """The resonance of a mount that passes `share` (below 1) of a line at `line_hz`."""
    from scipy.optimize import brentq

    def excess(resonance_hz: float) -> float:
        return float(gain_of(mode(resonance_hz, damping, dt_s), line_hz, dt_s)) - share

    return float(brentq(excess, 1e-3 * line_hz, line_hz / math.sqrt(2.0)))


@jit
def biquad(memory: FloatArray, row: int, at: int, section: Biquad, value: float) -> float:
    """One step of a section in transposed direct form II. memory: (n, m), of which two columns from `at` are used."""
    b0, b1, b2, a1, a2 = section
    result = b0 * value + memory[row, at]
    memory[row, at] = b1 * value - a1 * result + memory[row, at + 1]
    memory[row, at + 1] = b2 * value - a2 * result
    return float(result)


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
    """Read the sensors once. truth: (6,), overwritten; normals: (steps, 6). The reading is left in `state.reading`."""
    if imu.mount[0] != RIGID[0]:
        for i in range(CHANNELS):
            if i != YAW_RATE:
                truth[i] = biquad(state.mounted, i, 0, imu.mount, truth[i])
    for i in range(CHANNELS):
        state.drifted[i] += condition.drift[i] * dt
        noise = np.sqrt(imu.noise[i] * imu.noise[i] + condition.noise[i] * condition.noise[i]) * normals[row, i]
        value = condition.scale[i] * truth[i] + imu.bias[i] + condition.offset[i] + state.drifted[i] + noise
        state.reading[i] = biquad(state.memory, i, 0, imu.filter, value)


@jit
def advance_imus(
    imu: TwinImu,
    condition: SensorCondition,
    truth: FloatArray,
    rotors: RotorState,
    normals: FloatArray,
    row: int,
    step: int,
    dt: float,
) -> None:
    """Read both IMUs once, into `imu.reading`. Injected sensor faults act on IMU 0.

    truth: (2, 6), what ideal sensors read. normals: (steps, 24): white and broad noise of IMU 0, then of IMU 1.
    """
    mean, low, turns, n = 0.0, imu.filters, imu.turns, len(rotors.speed)
    for r in range(n):
        power = (rotors.speed[r] / imu.hover) ** 2
        c, s = rotors.turn[r, 0], rotors.turn[r, 1]
        turns[0, r, 0], turns[0, r, 1] = power * c, power * s
        turns[1, r, 0], turns[1, r, 1] = power * (c * c - s * s), power * 2.0 * s * c
        mean += power / n
    for k in range(IMUS):
        for i in range(CHANNELS):
            at, j = 2 * CHANNELS * k + i, CHANNELS * k + i
            value, noise = truth[k, i], imu.white[k, i]
            if k == 0:
                imu.drifted[i] += condition.drift[i] * dt
                value = condition.scale[i] * value + condition.offset[i] + imu.drifted[i]
                noise = math.sqrt(noise * noise + condition.noise[i] * condition.noise[i])
            shaken = imu.broad[k, i] * biquad(imu.shaped, j, 0, imu.shape, normals[row, at + CHANNELS]) * mean
            for h in range(HARMONICS):
                for r in range(n):
                    shaken += imu.line[k, i, h, r, 0] * turns[h, r, 0] + imu.line[k, i, h, r, 1] * turns[h, r, 1]
            value += imu.bias[k, i] + noise * normals[row, at]
            value += shaken
            for s in range(2):
                section = (low[i, s, 0], low[i, s, 1], low[i, s, 2], low[i, s, 3], low[i, s, 4])
                value = biquad(imu.memory, j, 2 * s, section, value)
            if i >= 3 or step % imu.gyro_period == 0:
                held = min(max(value, -imu.span[i]), imu.span[i])
                imu.reading[k, i] = imu.lsb[i] * np.rint(held / imu.lsb[i])
