"""The rate pair: equal delays, body rates, and validity of whole windows."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavdiag.rows.block import Block
from mavdiag.rows.rates import RateSpec
from mavdiag.telemetry import FloatArray
from mavdiag.testing import example_rows

DT_S = 0.001
SPEC = RateSpec.of(DT_S, 101)


def block(setpoint: FloatArray) -> Block:
    return example_rows(len(setpoint), DT_S, setpoint=setpoint).block


def leaning_turn(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Roll, pitch, yaw of a vehicle that leans and turns its nose along a path, and their derivatives, (n, 3)."""
    angles = np.column_stack((0.5 * np.sin(1.1 * t), 0.4 * np.cos(0.7 * t) - 0.1, 0.8 * t + 0.6 * np.sin(0.9 * t)))
    slopes = np.column_stack((0.55 * np.cos(1.1 * t), -0.28 * np.sin(0.7 * t), 0.8 + 0.54 * np.cos(0.9 * t)))
    return angles, slopes


def test_a_quadratic_setpoint_has_an_exact_slope_at_the_right_time() -> None:
    t = np.arange(2000) * 1e-3
    rows = block(np.outer(0.3 * t**2, [1.0, 0.0, 0.0]))
    out = SPEC.step(SPEC.start(), rows)
    assert len(out) == 2000 - 100
    at = (out.t_ns - rows.t_ns[0]) / 1e9
    np.testing.assert_allclose(out.u[:, 0], 0.6 * at, atol=1e-9)


def test_l1_u_is_the_body_rate_of_a_vehicle_that_turns_and_leans() -> None:
    """Truth from rotations, whose logarithm of the change over one step is the body rate, and no formula of W."""
    t = np.arange(12_000, dtype=np.float64) * DT_S
    angles, slopes = leaning_turn(t)
    out = SPEC.step(SPEC.start(), block(angles))
    at = np.round(out.t_ns / 1e9 / DT_S).astype(int)

    def attitude(offset: float) -> Rotation:
        return Rotation.from_euler("ZYX", leaning_turn(np.asarray(t[at] + offset, dtype=np.float64))[0][:, ::-1])

    truth = (attitude(-1e-5).inv() * attitude(1e-5)).as_rotvec() / 2e-5
    np.testing.assert_allclose(out.u, truth, atol=2e-3)  # the window of 0.1 s bends a curve a little
    assert np.abs(slopes[at] - truth).max() > 0.3  # the slopes of the angles are no body rates


@pytest.mark.parametrize("lean", [0.0, 0.3])
def test_l1_a_level_turn_yaws_and_a_leaning_turn_pitches_too(lean: float) -> None:
    """A heading rate of 2 rad/s at a roll angle `lean` gives q = 2 sin(roll) and r = 2 cos(roll)."""
    t = np.arange(500) * DT_S
    out = SPEC.step(SPEC.start(), block(np.column_stack((np.full(500, lean), 0 * t, 2.0 * t))))
    np.testing.assert_allclose(out.u, np.tile([0, 2 * np.sin(lean), 2 * np.cos(lean)], (400, 1)), atol=1e-9)


def test_a_row_is_valid_and_commanded_only_with_its_whole_window() -> None:
    rows = block(np.zeros((1000, 3)))
    valid, setpoint_valid = np.arange(1000) >= 200, np.arange(1000) != 600
    out = SPEC.step(SPEC.start(), dataclasses.replace(rows, valid=valid, setpoint_valid=setpoint_valid))
    at = np.round(out.t_ns / 1e9 / DT_S).astype(int)
    np.testing.assert_array_equal(out.valid, at >= 250)
    np.testing.assert_array_equal(out.commanded, (at >= 250) & (np.abs(at - 600) > 50))


def test_a_new_segment_starts_the_filters_afresh() -> None:
    rows = block(np.ones((300, 3)))
    state = SPEC.start()
    SPEC.step(state, rows)
    out = SPEC.step(state, rows.rows(0, 50, segment=7))
    assert len(out) == 0
    assert state.segment == 7
