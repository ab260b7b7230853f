"""Motion capture: the rigid-body fit against scipy, and the journey of a pose."""

import math

import numpy as np
import pytest

from mavdiag.telemetry import FloatArray, IntArray
from sitl_plant.physics.dynamics import RIGID
from sitl_plant.physics.mocap import Mocap, MocapState, deliver_pose, fit_pose, hold_if_lost, observe
from sitl_plant.vehicle import qdrone2

MARKERS = np.array(qdrone2().mocap.markers_m)
ALL: IntArray = np.ones(len(MARKERS), dtype=np.int64)


def scipy_fit(model: FloatArray, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    from scipy.spatial.transform import Rotation

    rotation, _ = Rotation.align_vectors(seen - seen.mean(axis=0), model - model.mean(axis=0))
    return np.asarray(rotation.as_matrix()), seen.mean(axis=0) - rotation.apply(model.mean(axis=0))


def as_matrix(q: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(np.roll(q, -1)).as_matrix())


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("noise_m", [0.0, 0.00015, 0.01])
def test_fit_is_the_least_squares_fit_of_scipy(seed: int, noise_m: float) -> None:
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    turn, where = Rotation.from_quat(rng.standard_normal(4)), rng.uniform(-3, 3, 3)
    seen = turn.apply(MARKERS) + where + noise_m * rng.standard_normal(MARKERS.shape)
    visible = ALL.copy()
    if seed % 2:
        visible[rng.integers(len(visible))] = 0
    fit = np.zeros(RIGID)
    assert fit_pose(MARKERS, seen, visible, fit)
    kept = visible.astype(bool)
    R, t = scipy_fit(MARKERS[kept], seen[kept])
    np.testing.assert_allclose(as_matrix(fit[6:10]), R, atol=1e-7)
    np.testing.assert_allclose(fit[:3], t, atol=1e-7)


def test_two_markers_are_not_a_pose() -> None:
    visible = ALL.copy()
    visible[2:] = 0
    fit = np.full(RIGID, 7.0)
    assert not fit_pose(MARKERS, MARKERS, visible, fit)
    np.testing.assert_array_equal(fit, 7.0)


def cameras(latency: int = 8) -> tuple[Mocap, MocapState]:
    constants = Mocap(MARKERS, np.zeros(3), 0.0, 0.5, 4, latency, 0.004, 1.0)
    n = len(MARKERS)
    state = MocapState(
        queue=np.full((latency + 1, 4), np.nan),
        pose=np.zeros(4),
        velocity=np.zeros(3),
        received=np.full(1, np.nan),
        seen=np.zeros((n, 3)),
        visible=np.zeros(n, dtype=np.int64),
        fit=np.zeros(RIGID),
    )
    return constants, state


def vehicle_at(x: float, yaw: float) -> FloatArray:
    row = np.zeros(RIGID)
    row[0], row[6], row[9] = x, math.cos(yaw / 2), math.sin(yaw / 2)
    return row


def test_after_a_gap_the_speed_is_the_way_over_the_time_that_passed() -> None:
    constants, state = cameras(latency=8)
    normals, clear, dark = np.zeros((1, len(MARKERS), 3)), np.ones((1, len(MARKERS))), np.full((1, len(MARKERS)), -1.0)
    for step in range(400):
        if step % 4 == 0:
            seen = dark if 100 <= step < 300 else clear
            observe(state, constants, vehicle_at(0.002 * step, 0.0), step, normals, seen, 0)
        deliver_pose(state, constants, step)
        assert state.velocity[0] <= 2.0 + 1e-9
        if 108 <= step < 308:
            assert state.pose[0] == pytest.approx(0.002 * 96)
    assert state.velocity[0] == pytest.approx(2.0)


def test_a_vehicle_that_is_not_seen_for_long_asks_for_its_last_pose() -> None:
    constants, state = cameras()
    asked = np.arange(9.0)
    kept = asked.copy()
    hold_if_lost(state, constants, 50, asked)  # before the first pose
    state.received[0], state.pose[:], state.velocity[:] = 1000.0, (1.0, 2.0, -3.0, 0.7), (0.4, 0.5, 0.6)
    hold_if_lost(state, constants, 1100, asked)  # 25 frames of 4 steps
    np.testing.assert_array_equal(asked, kept)
    hold_if_lost(state, constants, 1101, asked)
    np.testing.assert_array_equal(asked, [1.0, 2.0, -3.0, 0.4, 0.5, 0.6, 0.7, 0.0, 8.0])
