"""The rate pair: Savitzky-Golay filters that run, equal delays, body rates, and validity of whole windows."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import savgol_coeffs, savgol_filter
from scipy.spatial.transform import Rotation

from mavdiag.rows.block import Block
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.savgol import coefficients, window_samples
from mavdiag.telemetry import FloatArray
from mavdiag.testing import changed, example_rows

DT_S = 0.001
SPEC = RateSpec.of(DT_S, 101)


def block(setpoint: FloatArray, rate: FloatArray | None = None) -> Block:
    return example_rows(len(setpoint), DT_S, setpoint=setpoint, rate=rate).block


def leaning_turn(t: FloatArray) -> FloatArray:
    """(n, 3) roll, pitch, yaw of a vehicle that leans and turns its nose along a path."""
    return np.column_stack((0.5 * np.sin(1.1 * t), 0.4 * np.cos(0.7 * t) - 0.1, 0.8 * t + 0.6 * np.sin(0.9 * t)))


@pytest.mark.parametrize(("window", "order"), [(5, 2), (11, 1), (101, 2)])
def test_running_moments_are_the_filters_of_scipy(window: int, order: int) -> None:
    """After 100,000 rows, too, of which the first ones are large."""
    rng, m = np.random.default_rng(1), window // 2
    rate, roll = rng.normal(0, 1, (100_000, 3)), np.cumsum(rng.normal(0, 0.01, (100_000, 1)), axis=0)
    rate[:200] += 1e3
    spec = RateSpec.of(DT_S, window, order)
    out = spec.step(spec.start(), block(roll * (1, 0, 0), rate)).rates
    np.testing.assert_allclose(out.y, savgol_filter(rate, window, order, axis=0)[m:-m], atol=1e-9)
    slope = savgol_filter(roll[:, 0], window, order, deriv=1, delta=DT_S)[m:-m]
    np.testing.assert_allclose(out.u[:, 0], slope, atol=1e-9 * np.abs(slope).max())
    np.testing.assert_array_equal(out.gyro, rate[m:-m])


def test_l1_u_is_the_body_rate_of_a_vehicle_that_turns_and_leans() -> None:
    """Truth from rotations, whose logarithm of the change over one step is the body rate, and no formula of W."""
    t = np.arange(12_000, dtype=np.float64) * DT_S
    out = SPEC.step(SPEC.start(), block(leaning_turn(t))).rates
    at = np.round(out.t_ns / 1e9 / DT_S).astype(int)

    def attitude(offset: float) -> Rotation:
        return Rotation.from_euler("ZYX", leaning_turn(np.asarray(t[at] + offset, dtype=np.float64))[:, ::-1])

    truth = (attitude(-1e-5).inv() * attitude(1e-5)).as_rotvec() / 2e-5
    np.testing.assert_allclose(out.u, truth, atol=2e-3)  # the window of 0.1 s bends a curve a little
    slopes = np.gradient(leaning_turn(t), DT_S, axis=0)[at]
    assert np.abs(slopes - truth).max() > 0.3  # the slopes of the angles are no body rates


def test_a_row_is_valid_and_commanded_only_with_its_whole_window_and_a_segment_begins_afresh() -> None:
    rows, state = block(np.zeros((1000, 3))), SPEC.start()
    valid, setpoint_valid = np.arange(1000) >= 200, np.arange(1000) != 600
    out = SPEC.step(state, changed(rows, valid=valid, setpoint_valid=setpoint_valid)).rates
    at = np.round(out.t_ns / 1e9 / DT_S).astype(int)
    np.testing.assert_array_equal(out.valid, at >= 250)
    np.testing.assert_array_equal(out.commanded, (at >= 250) & (np.abs(at - 600) > 50))
    assert len(SPEC.step(state, rows.rows(0, 50, segment=7)).rates) == 0
    again = SPEC.step(state, rows.rows(50, 101, segment=7)).rates
    assert (len(again), int(again.t_ns[0])) == (1, int(rows.t_ns[50]))


@pytest.mark.parametrize(("window", "order"), [(5, 2), (11, 2), (25, 3), (101, 2), (101, 4), (401, 2)])
def test_coefficients_equal_scipy(window: int, order: int) -> None:
    C = coefficients(window, order)
    for degree, factor in enumerate((1, 1, 2)):
        assert_allclose(factor * C[degree], savgol_coeffs(window, order, deriv=degree, use="dot"), atol=1e-14)


@pytest.mark.parametrize(
    ("dt_s", "window_s", "expected"),
    [(0.001, 0.1, 101), (1 / 999, 0.1, 101), (1 / 1002, 0.1, 101), (1 / 270, 0.1, 27), (0.005, 0.1, 21), (0.1, 0.1, 5)],
)
def test_window_samples(dt_s: float, window_s: float, expected: int) -> None:
    assert window_samples(dt_s, window_s) == expected
