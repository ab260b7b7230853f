"""Motion capture: the rigid-body fit against scipy, and the journey of a pose."""

import numpy as np
import pytest

from mavdiag.telemetry import FloatArray, IntArray
from sitl_plant.physics.dynamics import RIGID
from sitl_plant.physics.mocap import fit_pose
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
