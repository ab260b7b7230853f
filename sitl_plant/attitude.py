"""Attitude from the IMU: low-pass filters, accelerometer angles, complementary filter (T 2.3.2, Eq 2.30-2.33).

T's equations hold in a frame with y to the left and z up. In FRD the accelerometer reads (0, 0, -g) at rest, so with
a = -specific force, which points down at rest:

    phi_acc   = atan2(a_y, a_z)                                          T Eq 2.31
    theta_acc = atan2(-a_x, a_y sin phi_acc + a_z cos phi_acc)           T Eq 2.32

The estimate is the nine-vector of T Eq 2.33: roll, pitch, yaw [rad], their rates [rad/s], their accelerations
[rad/s^2]. Rates and accelerations are those about the body axes, as the rate loop uses them.
"""

from typing import NamedTuple

import numpy as np

from mavdiag.quantities import FloatArray
from sitl_plant.jit import jit

__all__ = ["ESTIMATE", "Estimator", "advance_estimate", "tilt_from_accel", "wrapped"]

ESTIMATE = 9  # length of T's attitude state
EPSILON = 1e-3  # m/s^2: below this the accelerometer has no direction (T Eq 2.30)


class Estimator(NamedTuple):
    """Constants. gyro_filter: 2 pi f [rad/s]; accel_gain: 1 - exp(-2 pi f dt); correction: dt / time constant."""

    gyro_filter: float
    accel_gain: float
    correction: float


@jit
def wrapped(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


@jit
def tilt_from_accel(f_x: float, f_y: float, f_z: float) -> tuple[float, float]:
    """Roll and pitch [rad] that a resting accelerometer reading (specific force, FRD) means, T Eq 2.30-2.32."""
    norm = np.sqrt(f_x * f_x + f_y * f_y + f_z * f_z)
    if norm < EPSILON:
        return 0.0, 0.0
    a_x, a_y, a_z = -f_x / norm, -f_y / norm, -f_z / norm
    phi = np.arctan2(a_y, a_z)
    return phi, np.arctan2(-a_x, a_y * np.sin(phi) + a_z * np.cos(phi))


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

    rate'' = w^2 (gyro - rate) - sqrt(2) w rate'                 second-order low-pass: rate and acceleration in one
    eta'   = W(eta) rate + (eta_seen - eta) / tau                gyro for the short term, accelerometer and cameras
                                                                 for the long term
    """
    for i in range(3):
        stiffness = estimator.gyro_filter * (reading[i] - estimate[3 + i]) - np.sqrt(2.0) * estimate[6 + i]
        estimate[6 + i] += dt * estimator.gyro_filter * stiffness
        estimate[3 + i] += dt * estimate[6 + i]
        accel_filtered[i] += estimator.accel_gain * (reading[3 + i] - accel_filtered[i])
    phi_acc, theta_acc = tilt_from_accel(accel_filtered[0], accel_filtered[1], accel_filtered[2])
    phi, theta, psi = estimate[0], estimate[1], estimate[2]
    p, q, r = estimate[3], estimate[4], estimate[5]
    turn = q * np.sin(phi) + r * np.cos(phi)
    estimate[0] += dt * (p + np.tan(theta) * turn) + estimator.correction * wrapped(phi_acc - phi)
    estimate[1] += dt * (q * np.cos(phi) - r * np.sin(phi)) + estimator.correction * (theta_acc - theta)
    psi += dt * turn / np.cos(theta) + estimator.correction * wrapped(yaw_seen - psi)
    estimate[2] = wrapped(psi)
