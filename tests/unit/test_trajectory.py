"""Paths: closed, smooth where they should be, flown at the speed asked for; where the recorded ones go."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.trajectory import FLYING, REFERENCE, Nose, Path, Shape, path, reference


def at(p: Path, t: float) -> FloatArray:
    out = np.empty(REFERENCE)
    reference(p, t, out)
    return out


@given(
    st.sampled_from([Shape.SQUARE, Shape.CIRCLE]),
    st.floats(0.5, 5.0),
    st.floats(0.1, 3.0),
    st.floats(-3.0, 3.0),
    st.floats(0.0, 60.0),
)
def test_speed_along_the_path_is_constant(shape: Shape, size: float, speed: float, heading: float, t: float) -> None:
    assert np.linalg.norm(at(path(shape, size, speed, heading, 1.0), t)[3:6]) == pytest.approx(speed)


@pytest.mark.parametrize("nose", list(Nose))
@pytest.mark.parametrize("shape", list(Shape))
def test_yaw_rate_is_the_slope_of_yaw_which_stays_within_pi(shape: Shape, nose: Nose) -> None:
    p, h = path(shape, 1.0, 0.5, 2.0, 1.0, nose), 1e-5
    for t in np.linspace(0.0137, 19.0, 301):
        before, here, after = at(p, t - h), at(p, t), at(p, t + h)
        slope = (after[6] - before[6] + math.pi) % (2 * math.pi) - math.pi
        assert slope / (2 * h) == pytest.approx(here[7], abs=1e-3)
        assert -math.pi <= here[6] < math.pi


RECORDED = [shape for shape in Shape if shape.recorded]
LIMITS = {1: (2.0, 3.14), 2: (0.333, 0.52)}  # DronePropA: SP1, SP2


def flown(shape: Shape, seconds: float = 60.0, dt: float = 0.01, takeoff: bool = False) -> FloatArray:
    one = path(shape, 1.0, 0.5, 0.0, 1.0, takeoff=takeoff)
    out = np.empty((round(seconds / dt), REFERENCE))
    for row in range(len(out)):
        reference(one, row * dt, out[row])
    return out


def ends(shape: Shape, count: int) -> FloatArray:
    """Where the set-point is just before each new one: after 10 s, 20 s and so on."""
    return np.asarray(flown(shape, 10.0 * count + 0.1)[999::1000][:count])


@pytest.mark.parametrize("level", [1, 2])
def test_each_goes_where_the_recordings_go(level: int) -> None:
    diagonals = ends(Shape(f"t1-sp{level}"), 6)[:, :2]
    np.testing.assert_allclose(diagonals, [[1, 1], [-1, -1], [0, 0], [1, -1], [-1, 1], [0, 0]], atol=1e-9)
    edges = ends(Shape(f"t2-sp{level}"), 4)[:, :2]
    np.testing.assert_allclose(edges, [[-1, 1], [-1, -1], [1, -1], [1, 1]], atol=1e-9)
    np.testing.assert_allclose(-ends(Shape(f"t3-sp{level}"), 3)[:, 2], [0.4, 0.6, 0.8], atol=1e-9)
    np.testing.assert_allclose(-ends(Shape(f"t4-sp{level}"), 2)[:, 2], [0.8, 0.2], atol=1e-9)
    np.testing.assert_allclose(np.degrees(ends(Shape(f"t5-sp{level}"), 4)[:, 6]), [45, -45, 90, -90], atol=1e-9)


@pytest.mark.parametrize("shape", RECORDED)
def test_the_limiter_holds_and_rates_are_slopes(shape: Shape) -> None:
    assert shape.recorded is not None
    speed, turn = LIMITS[shape.recorded[1]]
    rows = flown(shape)
    slope, nose = np.diff(rows[:, :3], axis=0) / 0.01, np.diff(np.unwrap(rows[:, 6])) / 0.01
    assert np.linalg.norm(slope, axis=1).max() <= speed * (1 + 1e-6)
    assert np.abs(nose).max() <= turn * (1 + 1e-6)
    steady = np.all(rows[1:, 3:6] == rows[:-1, 3:6], axis=1) & (rows[1:, 7] == rows[:-1, 7])
    np.testing.assert_allclose(slope[steady], rows[:-1][steady, 3:6], atol=1e-9)
    np.testing.assert_allclose(nose[steady], rows[:-1][steady, 7], atol=1e-9)
    assert np.all(rows[:, 8] == FLYING)
