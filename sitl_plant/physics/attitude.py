"""Attitude from the IMU: low-pass filters, accelerometer angles, complementary filter (T 2.3.2, Eq 2.30-2.33).

T's equations hold in a frame with y to the left and z up. In FRD the accelerometer reads (0, 0, -g) at rest, so with
a = -specific force, which points down at rest:

    phi_acc   = atan2(a_y, a_z)                                          T Eq 2.31
    theta_acc = atan2(-a_x, a_y sin phi_acc + a_z cos phi_acc)           T Eq 2.32

The estimate is the nine-vector of T Eq 2.33: roll, pitch, yaw [rad], their rates [rad/s], their accelerations
[rad/s^2]. Rates and accelerations are those about the body axes, as the rate loop uses them.
"""

import math
from typing import NamedTuple

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.jit import jit

__all__ = ["ESTIMATE", "Estimator", "advance_estimate", "low_pass_transition", "tilt_from_accel", "wrapped"]

ESTIMATE = 9  # length of T's attitude state
EPSILON = 1e-3  # m/s^2: below this the accelerometer has no direction (T Eq 2.30)


class Estimator(NamedTuple):
    """Constants. gyro_filter: `low_pass_transition`. accel_gain: 1 - exp(-2 pi f dt). correction: dt over tau."""

    gyro_filter: tuple[float, float, float, float]
    accel_gain: float
    correction: float


def low_pass_transition(corner_hz: float, dt_s: float) -> tuple[float, float, float, float]:
    """Exact step of a second-order Butterworth low-pass whose input is held, by rows.

    [ y' - u ]   exp(-a dt) [ cos + sin     sin / a   ] [ y - u ]
    [ dy'/dt ] =            [ -2 a sin      cos - sin ] [ dy/dt ]       of the angle a dt, a = 2 pi f / sqrt 2
    """
    a = math.sqrt(2.0) * math.pi * corner_hz
    decay, c, s = math.exp(-a * dt_s), math.cos(a * dt_s), math.sin(a * dt_s)
    return decay * (c + s), decay * s / a, -2.0 * a * decay * s, decay * (c - s)


@jit
def wrapped(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    turned = angle + math.pi
    if 0.0 <= turned < 2.0 * math.pi:  # as the remainder below has it, without its division
        return turned - math.pi
    return turned % (2.0 * math.pi) - math.pi


@jit
def tilt_from_accel(f_x: float, f_y: float, f_z: float) -> tuple[float, float]:
    """Roll and pitch [rad] that a resting accelerometer reading (specific force, FRD) means, T Eq 2.30-2.32."""
    norm = math.sqrt(f_x * f_x + f_y * f_y + f_z * f_z)
    if norm < EPSILON:
        return 0.0, 0.0
    a_x, a_y, a_z = -f_x / norm, -f_y / norm, -f_z / norm
    phi = math.atan2(a_y, a_z)
    return phi, math.atan2(-a_x, a_y * math.sin(phi) + a_z * math.cos(phi))


@jit
def advance_estimate(
    estimate: FloatArray,
    accel_filtered: FloatArray,
    estimator: Estimator,
    reading: FloatArray,
    yaw_seen: float,
    dt: float,
) -> None:
    """Advance the nine states in place by one sample.

    reading: (6,) gyro and accelerometer, FRD. yaw_seen: from motion capture [rad].

    rate, acceleration = low-pass(gyro) and its slope, two states of one filter
    eta' = W(eta) rate + (eta_seen - eta) / tau      gyro for the short term, accelerometer and cameras for the long one
    """
    f11, f12, f21, f22 = estimator.gyro_filter
    for i in range(3):
        behind, slope = estimate[3 + i] - reading[i], estimate[6 + i]
        estimate[3 + i] = reading[i] + f11 * behind + f12 * slope
        estimate[6 + i] = f21 * behind + f22 * slope
        accel_filtered[i] += estimator.accel_gain * (reading[3 + i] - accel_filtered[i])
    phi_acc, theta_acc = tilt_from_accel(accel_filtered[0], accel_filtered[1], accel_filtered[2])
    phi, theta, psi = estimate[0], estimate[1], estimate[2]
    p, q, r = estimate[3], estimate[4], estimate[5]
    turn = q * math.sin(phi) + r * math.cos(phi)
    phi += dt * (p + math.tan(theta) * turn) + estimator.correction * wrapped(phi_acc - phi)
    psi += dt * turn / math.cos(theta) + estimator.correction * wrapped(yaw_seen - psi)
    theta += dt * (q * math.cos(estimate[0]) - r * math.sin(estimate[0])) + estimator.correction * (theta_acc - theta)
    estimate[0], estimate[1], estimate[2] = wrapped(phi), wrapped(theta), wrapped(psi)
