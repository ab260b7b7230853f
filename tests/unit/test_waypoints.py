"""The recorded trajectories: where they go, in which order, and that the limiter holds."""

import math

import numpy as np
import pytest

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from sitl_plant.physics.trajectory import FLYING, REFERENCE, Shape, landing_time, path, reference
from sitl_plant.plant import PlantConfig

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


def test_there_are_five_at_two_speeds() -> None:
    assert sorted(shape.recorded or (0, 0) for shape in RECORDED) == [(t, sp) for t in range(1, 6) for sp in (1, 2)]


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


@pytest.mark.parametrize("shape", [Shape.T2_SP1, Shape.T3_SP2])
def test_take_off_reaches_the_first_point_and_landing_begins_where_the_path_is(shape: Shape) -> None:
    one = path(shape, 1.0, 0.5, 0.0, 1.0, takeoff=True, land_s=50.0, ground_s=(3.3, 10.5))
    out, first = np.empty(REFERENCE), np.empty(REFERENCE)
    assert one.start == pytest.approx(10.5 + (0.2 if shape is Shape.T3_SP2 else 1.0) / 0.5 + 2.0)
    reference(one, one.start, first)
    for t, motors in ((3.2, 0.0), (3.4, 1.0), (10.4, 1.0), (10.6, 2.0)):
        reference(one, t, out)
        assert out[8] == motors
        np.testing.assert_array_equal(out[:2], first[:2])
    before, after = np.empty(REFERENCE), np.empty(REFERENCE)
    reference(one, 50.0 - 1e-6, before)
    reference(one, 50.0, after)
    np.testing.assert_allclose(after[:3], before[:3], atol=1e-5)


def test_a_flight_that_is_too_short_is_refused_by_its_own_heights() -> None:
    needed = 4.0 + 0.2 / 0.5 + 2.0 + landing_time(0.8)
    assert landing_time(5.0, Shape.T4_SP1) == landing_time(0.8)
    PlantConfig(trajectory="t4-sp1", altitude_m=5.0, start="ground", landed_s=needed + 0.01)
    with pytest.raises(UsageError, match=f"needs {needed:.1f} s"):
        PlantConfig(trajectory="t4-sp1", altitude_m=5.0, start="ground", landed_s=needed - 0.01)


def test_turned_by_the_heading() -> None:
    turned, out, plain = path(Shape.T2_SP2, 1.0, 1.0, math.pi / 2, 1.0), np.empty(REFERENCE), np.empty(REFERENCE)
    reference(turned, 3.0, out)
    reference(path(Shape.T2_SP2, 1.0, 1.0, 0.0, 1.0), 3.0, plain)
    np.testing.assert_allclose(out[:2], [-plain[1], plain[0]], atol=1e-12)
    assert out[6] == pytest.approx(math.pi / 2)
