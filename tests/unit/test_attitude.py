"""The attitude estimate: tilt from gravity, filters and time constants in closed form."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.control import ESTIMATE, Estimator, advance_estimate, low_pass_transition, tilt_from_accel
from sitl_plant.physics.dynamics import wrapped

DT = 0.001


def estimator(complementary_s: float = 8.0) -> Estimator:
    return Estimator(low_pass_transition(60.0, DT), 1 - math.exp(-2 * math.pi * 10.0 * DT), DT / complementary_s)


def run(reading: FloatArray, seconds: float, sensor: Estimator, yaw: float = 0.0) -> FloatArray:
    estimate, filtered = np.zeros(ESTIMATE), np.asarray(reading[3:].copy())
    for _ in range(round(seconds / DT)):
        advance_estimate(estimate, filtered, sensor, reading, yaw, DT)
    return estimate


def resting(roll: float, pitch: float) -> FloatArray:
    """What a still IMU reads at this attitude, by scipy's rotations."""
    from scipy.spatial.transform import Rotation

    up = Rotation.from_euler("ZYX", [0.4, pitch, roll]).inv().apply([0.0, 0.0, -9.81])
    return np.concatenate([np.zeros(3), up])


@given(st.floats(-3.0, 3.0), st.floats(-1.5, 1.5))
def test_gravity_gives_roll_and_pitch(roll: float, pitch: float) -> None:
    reading = resting(roll, pitch)
    np.testing.assert_allclose(tilt_from_accel(*reading[3:]), [roll, pitch], atol=1e-9)


def test_weightless_sensor_has_no_direction() -> None:
    """T Eq 2.30: below epsilon the vector is replaced by level."""
    assert tilt_from_accel(1e-5, 0.0, 0.0) == (0.0, 0.0)


def test_static_tilt_is_found_with_the_time_constant_of_the_filter() -> None:
    """From level, the estimate goes as 1 - exp(-t / tau)."""
    tau = 2.0
    estimate = run(resting(0.2, -0.1), 3.0, estimator(tau), yaw=0.3)
    share = 1 - math.exp(-3.0 / tau)
    np.testing.assert_allclose(estimate[:3], [0.2 * share, -0.1 * share, 0.3 * share], rtol=2e-3)
    np.testing.assert_allclose(estimate[3:], 0.0, atol=1e-12)


def test_short_turn_is_followed_by_the_gyro() -> None:
    reading = resting(0.0, 0.0)
    reading[0] = 0.5
    estimate = run(reading, 0.4, estimator(1e6))
    delay = math.sqrt(2) / (2 * math.pi * 60.0) - 0.5 * DT  # of the low-pass, less half a step of the integration
    assert estimate[0] == pytest.approx(0.5 * (0.4 - delay), rel=1e-5)


def test_rate_filter_is_a_second_order_butterworth_step() -> None:
    """1 - exp(-a t) (cos a t + sin a t), a = w / sqrt 2; the acceleration state is its slope."""
    reading = resting(0.0, 0.0)
    reading[1] = 1.0
    a = 2 * math.pi * 60.0 / math.sqrt(2)
    for t in (0.004, 0.008, 0.016):
        estimate = run(reading, t, estimator())
        expected = 1 - math.exp(-a * t) * (math.cos(a * t) + math.sin(a * t))
        slope = 2 * a * math.exp(-a * t) * math.sin(a * t)
        assert estimate[4] == pytest.approx(expected, abs=1e-9)
        assert estimate[7] == pytest.approx(slope, abs=1e-6)


@given(st.floats(-50.0, 50.0))
def test_wrapped_angle_is_the_same_direction(angle: float) -> None:
    assert -math.pi <= wrapped(angle) < math.pi + 1e-12
    assert math.cos(wrapped(angle)) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped(angle)) == pytest.approx(math.sin(angle), abs=1e-9)
