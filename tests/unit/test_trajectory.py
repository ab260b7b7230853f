"""Paths: closed, smooth where they should be, flown at the speed asked for."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.trajectory import FLYING, REFERENCE, Nose, Path, Shape, landing_time, path, reference


def at(p: Path, t: float) -> FloatArray:
    out = np.empty(REFERENCE)
    reference(p, t, out)
    return out


def test_square_has_four_equal_sides_and_sharp_corners() -> None:
    p = path(Shape.SQUARE, 1.0, 0.5, 0.0, 1.5)
    corners = [at(p, t)[:3] for t in (0.0, 2.0, 4.0, 6.0, 8.0)]
    np.testing.assert_allclose(
        corners, [[0, 0, -1.5], [1, 0, -1.5], [1, 1, -1.5], [0, 1, -1.5], [0, 0, -1.5]], atol=1e-12
    )
    np.testing.assert_allclose(at(p, 1.999)[3:5], [0.5, 0.0])
    np.testing.assert_allclose(at(p, 2.001)[3:5], [0.0, 0.5])


@given(
    st.sampled_from([Shape.SQUARE, Shape.CIRCLE]),
    st.floats(0.5, 5.0),
    st.floats(0.1, 3.0),
    st.floats(-3.0, 3.0),
    st.floats(0.0, 60.0),
)
def test_speed_along_the_path_is_constant(shape: Shape, size: float, speed: float, heading: float, t: float) -> None:
    assert np.linalg.norm(at(path(shape, size, speed, heading, 1.0), t)[3:6]) == pytest.approx(speed)


@given(st.sampled_from(list(Shape)), st.floats(0.5, 5.0), st.floats(0.1, 2.0), st.floats(-3.0, 3.0), st.floats(0.1, 30))
def test_velocity_is_the_slope_of_position(shape: Shape, size: float, speed: float, heading: float, t: float) -> None:
    p, h = path(shape, size, speed, heading, 1.0), 1e-4
    before, here, after = at(p, t - h), at(p, t), at(p, t + h)
    if np.allclose(before[3:6], after[3:6], atol=0.01 * speed):  # not across a corner
        np.testing.assert_allclose((after[:3] - before[:3]) / (2 * h), here[3:6], atol=1e-3 * speed)


def test_before_the_start_it_hovers_at_the_first_point() -> None:
    for shape in Shape:
        p = path(shape, 2.0, 0.5, 0.7, 1.0)
        waiting, started = at(p, -0.5), at(p, 0.0)
        np.testing.assert_allclose(waiting[:3], started[:3], atol=1e-12)
        np.testing.assert_array_equal(waiting[3:6], 0.0)


def test_circle_and_figure8_have_the_size_asked_for() -> None:
    for shape in (Shape.CIRCLE, Shape.FIGURE8):
        track = np.array([at(path(shape, 2.0, 0.5, 0.0, 1.0), t)[:2] for t in np.arange(0.0, 20.0, 0.01)])
        assert np.ptp(track[:, 0]) == pytest.approx(2.0, abs=1e-3)
    crossing = at(path(Shape.FIGURE8, 2.0, 0.5, 0.0, 1.0), 0.0)
    assert np.linalg.norm(crossing[3:5]) == pytest.approx(0.5)


def test_heading_turns_the_path_and_the_nose() -> None:
    east = at(path(Shape.SQUARE, 1.0, 0.5, math.pi / 2, 1.0), 1.0)
    np.testing.assert_allclose(east[:2], [0.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(east[3:5], [0.0, 0.5], atol=1e-12)
    assert east[6] == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("nose", list(Nose))
@pytest.mark.parametrize("shape", list(Shape))
def test_yaw_rate_is_the_slope_of_yaw_which_stays_within_pi(shape: Shape, nose: Nose) -> None:
    p, h = path(shape, 1.0, 0.5, 2.0, 1.0, nose), 1e-5
    for t in np.linspace(0.0137, 19.0, 301):
        before, here, after = at(p, t - h), at(p, t), at(p, t + h)
        slope = (after[6] - before[6] + math.pi) % (2 * math.pi) - math.pi
        assert slope / (2 * h) == pytest.approx(here[7], abs=1e-3)
        assert -math.pi <= here[6] < math.pi


def test_l1_the_nose_follows_the_path_or_spins() -> None:
    for shape in (Shape.CIRCLE, Shape.FIGURE8, Shape.SQUARE):
        for t in (0.5, 3.9, 5.7, 11.8):  # on the square: after the turn at each corner
            row = at(path(shape, 1.0, 0.5, 0.4, 1.0, Nose.PATH), t)
            along = math.atan2(row[4], row[3])
            assert math.remainder(row[6] - along, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert at(path(Shape.HOVER, 1.0, 0.5, 0.4, 1.0, Nose.SPIN), 2.0)[6] == pytest.approx(0.4 + 2.0)
    assert at(path(Shape.SQUARE, 1.0, 0.5, 0.4, 1.0), 5.0)[6] == 0.4


def test_a_flight_from_the_ground_climbs_flies_and_comes_down() -> None:
    end = 60.0 - landing_time(1.0)
    p = path(Shape.SQUARE, 1.0, 0.5, 0.0, 1.0, takeoff=True, land_s=end)
    rows = np.array([at(p, t) for t in np.arange(-1.0, 60.0, 0.01)])
    height, motors = -rows[:, 2], rows[:, 8]
    assert height[:500].max() == 0.0  # until 4 s
    np.testing.assert_allclose(np.abs(np.diff(height)).max(), 0.005, rtol=1e-9)  # 0.5 m/s
    assert height.max() == 1.0
    assert [motors[0], *motors[1:][np.diff(motors) > 0]] == [0, 1, FLYING, 3, 4]
    assert motors[-100] == 4
    flown = at(path(Shape.SQUARE, 1.0, 0.5, 0.0, 1.0), 5.0)
    np.testing.assert_allclose(at(p, p.start + 5.0), flown)
    np.testing.assert_allclose(rows[-1, :2], at(path(Shape.SQUARE, 1.0, 0.5, 0.0, 1.0), end - p.start)[:2])
