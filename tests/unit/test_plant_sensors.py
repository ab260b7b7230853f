"""The IMUs against kinematics, scipy and the sampling theorem; their mount; the two of the recordings."""

import math

import numpy as np
import pytest
from plant_cases import nominal_airframe
from scipy.signal import bilinear, freqz

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.airframe import draw_airframe
from sitl_plant.physics.dynamics import GRAVITY, RIGID
from sitl_plant.physics.faults import Injection, SensorFault, sensor_condition
from sitl_plant.physics.parameters import specimen_of
from sitl_plant.physics.sensors import (
    CHANNELS,
    Imu,
    ImuState,
    SensorCondition,
    advance_imu,
    butterworth,
    feel,
    gain_of,
    mode,
)
from sitl_plant.vehicle import vehicle_named


def imu(noise: float = 0.0) -> Imu:
    return Imu(np.zeros(3), np.zeros(CHANNELS), np.full(CHANNELS, noise), butterworth(250.0, 0.001))


def read(sensor: Imu, condition: SensorCondition, truth: FloatArray, normals: FloatArray) -> FloatArray:
    z = np.zeros
    state = ImuState(z((CHANNELS, 2)), z(CHANNELS), z(CHANNELS), z((CHANNELS, 2)))
    out = np.empty((len(normals), CHANNELS))
    for row in range(len(normals)):
        advance_imu(state, sensor, condition, truth, normals, row, 0.001)
        out[row] = state.reading
    return out


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


DT = 0.001


@pytest.mark.parametrize(("hz", "damping"), [(25.0, 0.1), (50.0, 0.1), (165.0, 0.05), (300.0, 1.2)])
def test_the_filter_is_the_bilinear_transform_of_a_driven_mode(hz: float, damping: float) -> None:
    warped = 2 / DT * math.tan(math.pi * hz * DT)
    b, a = bilinear([2 * damping * warped, warped**2], [1, 2 * damping * warped, warped**2], 1 / DT)
    b0, b1, b2, a1, a2 = mode(hz, damping, DT)
    np.testing.assert_allclose([b0, b1, b2], b, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose([1.0, a1, a2], a, rtol=1e-9)
    _, (still, line) = freqz(b, a, [0.0, hz], fs=1 / DT)
    assert abs(still) == pytest.approx(1.0)  # slow motion passes
    assert abs(line) == pytest.approx(math.sqrt(1 + 1 / (2 * damping) ** 2))  # Den Hartog, Mechanical Vibrations, 2.12
    assert gain_of(mode(hz, damping, DT), hz, DT) == pytest.approx(abs(line))


VEHICLE = vehicle_named("qdrone2-recorded")


def test_specimens_are_the_measured_ones_or_drawn_between_them() -> None:
    recorded = VEHICLE.recorded
    assert recorded is not None
    rng = np.random.default_rng(31)
    drawn = [draw_airframe(VEHICLE, aged=False, rng=rng) for _ in range(60)]
    levels = np.array([specimen_of(one, recorded).gyro_line for one in drawn])
    assert levels.min() >= 0.0144
    assert levels.max() <= 0.0326
    assert levels.max() / levels.min() > 2.0
    assert specimen_of(drawn[7], recorded) == specimen_of(drawn[7], recorded)
    known = [one.name for one in recorded.specimens]
    assert known == ["drone 1", "drone 2", "drone 3"]
    assert specimen_of(nominal_airframe(VEHICLE), recorded).name == "nominal"
