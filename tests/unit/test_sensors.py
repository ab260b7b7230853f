"""The IMU: rigid-body kinematics, filter, noise level, injected sensor faults."""

import math

import numpy as np
import pytest

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.dynamics import GRAVITY, RIGID
from sitl_plant.physics.faults import Injection, SensorFault, sensor_condition
from sitl_plant.physics.sensors import CHANNELS, Imu, ImuState, SensorCondition, advance_imu, butterworth, feel

HEALTHY = sensor_condition(())


def imu(noise: float = 0.0) -> Imu:
    return Imu(np.zeros(3), np.zeros(CHANNELS), np.full(CHANNELS, noise), butterworth(250.0, 0.001))


def read(sensor: Imu, condition: SensorCondition, truth: FloatArray, normals: FloatArray) -> FloatArray:
    state = ImuState(np.zeros((CHANNELS, 2)), np.zeros(CHANNELS), np.zeros(CHANNELS))
    out = np.empty((len(normals), CHANNELS))
    for row in range(len(normals)):
        advance_imu(state, sensor, condition, truth, normals, row, 0.001)
        out[row] = state.reading
    return out


def test_resting_sensor_reads_minus_g() -> None:
    x, dx, truth = np.zeros(RIGID), np.zeros((1, RIGID)), np.empty(6)
    x[6] = 1.0
    feel(x, dx, np.array([0.01, 0.005, 0.0]), truth)
    np.testing.assert_allclose(truth, [0, 0, 0, 0, 0, -GRAVITY])


def test_lever_arm_is_the_acceleration_of_a_point_on_the_body() -> None:
    """Oracle: a body at rest in the middle that nods as theta(t) = A sin w t; its point is differentiated twice."""
    amplitude, w, t, h = 0.4, 7.0, 0.3, 1e-4
    r = np.array([0.01, 0.005, -0.02])

    def pitch(at: float) -> float:
        return amplitude * math.sin(w * at)

    def place(at: float) -> FloatArray:
        c, s = math.cos(pitch(at)), math.sin(pitch(at))
        return np.array([c * r[0] + s * r[2], r[1], -s * r[0] + c * r[2]])  # R_y(theta) r, world NED

    acceleration = (place(t + h) - 2 * place(t) + place(t - h)) / h**2
    c, s = math.cos(pitch(t)), math.sin(pitch(t))
    in_body = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) @ (acceleration - [0, 0, GRAVITY])

    x, dx, truth = np.zeros(RIGID), np.zeros((1, RIGID)), np.empty(6)
    x[6], x[8] = math.cos(pitch(t) / 2), math.sin(pitch(t) / 2)
    x[11] = amplitude * w * math.cos(w * t)
    dx[0, 11] = -amplitude * w**2 * math.sin(w * t)
    feel(x, dx, r, truth)
    np.testing.assert_allclose(truth[3:], in_body, atol=1e-5)
    np.testing.assert_allclose(truth[:3], [0.0, x[11], 0.0])


def test_filter_is_the_second_order_butterworth_of_scipy() -> None:
    from scipy.signal import butter

    for corner in (30.0, 98.0, 250.0):
        b, a = butter(2, corner, fs=1000.0)
        b0, b1, b2, a1, a2 = butterworth(corner, 0.001)
        np.testing.assert_allclose([b0, b1, b2, 1.0, a1, a2], [*b, *a], atol=1e-12)


@pytest.mark.parametrize("seed", [5])
def test_noise_has_the_density_of_the_data_sheet(seed: int) -> None:
    """3.8 mdps/sqrt(Hz), one-sided, below the filter corner; 3 dB less at 250 Hz."""
    from scipy.signal import welch

    density = 3.8e-3 * math.pi / 180
    normals = np.random.default_rng(seed).standard_normal((40_000, CHANNELS))
    out = read(imu(density * math.sqrt(500.0)), HEALTHY, np.zeros(CHANNELS), normals)
    f, power = welch(out, fs=1000.0, nperseg=500, axis=0)
    power = power.mean(axis=1)
    assert power[(f > 5) & (f < 60)].mean() == pytest.approx(density**2, rel=0.05)
    assert power[(f > 245) & (f < 255)].mean() == pytest.approx(density**2 / 2, rel=0.1)


def test_sensor_faults_act_as_written() -> None:
    """reading = scale truth + offset + drift t, once the filter has settled; the other axes are untouched."""
    faults = (
        Injection(SensorFault("gyro", 1, scale=2.0, offset=0.1, drift_per_s=0.5)),
        Injection(SensorFault("accel", 2, scale=0.5)),
    )
    truth = np.array([0.3, 0.3, 0.3, 1.0, 1.0, 1.0])
    out = read(imu(), sensor_condition(faults), truth, np.zeros((1000, CHANNELS)))
    assert out[-1, 1] == pytest.approx(2 * 0.3 + 0.1 + 0.5, abs=0.002)
    np.testing.assert_allclose(out[-1, [0, 2, 3, 4, 5]], [0.3, 0.3, 1.0, 1.0, 0.5], atol=1e-9)
