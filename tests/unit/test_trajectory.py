"""Paths: closed, smooth where they should be, flown at the speed asked for."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.trajectory import Path, Shape, path, reference


def at(p: Path, t: float) -> FloatArray:
    out = np.empty(8)
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
