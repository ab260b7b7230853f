"""SRIV's rows over all segments at once, against filters of each column of each one; fits that begin near."""

import numpy as np
import pytest
from scipy.signal import lfilter

from mavdiag.identify.arx import polynomials
from mavdiag.identify.data import Segment, triangle
from mavdiag.identify.model import Order
from mavdiag.identify.sriv import _filtered, sriv
from mavdiag.identify.together import together, triangle_of
from mavdiag.telemetry import FloatArray

A, B = np.array([1.0, -1.9, 0.905]), np.array([0.0, 0.01, -0.006])


def flown(seed: int, n: int, noise: float = 0.05) -> Segment:
    """A segment that begins in motion."""
    rng = np.random.default_rng(seed)
    u = np.cumsum(rng.normal(0.0, 0.1, n + 50))
    u -= lfilter([0.01], [1.0, -0.99], u)
    y = lfilter(B, A, u) + noise * lfilter([0.2], [1.0, -0.8], rng.normal(size=n + 50))
    return Segment(u[50:], np.asarray(y[50:]))


@pytest.mark.parametrize("order", [(2, 2, 1), (1, 1, 2), (3, 3, 1), (2, 3, 0)])
def test_the_products_are_those_of_every_filtered_column(order: Order) -> None:
    segments = [flown(seed, n) for seed, n in enumerate((900, 900, 700, 321, 900))]
    na, nb, nk = order
    a = np.concatenate(([1.0], np.poly([0.9, 0.8, -0.3][:na])[1:]))
    b = np.concatenate((np.zeros(nk), [0.02, -0.015, 0.004][:nb]))
    expected = triangle(np.concatenate([_filtered(one, order, a, b) for one in segments]))
    found = triangle_of(together(segments), order, a, b)
    assert found is not None
    scale = np.linalg.norm(expected, axis=0)
    np.testing.assert_allclose(found.T @ found / np.outer(scale, scale), products(expected, scale), atol=1e-9)


def products(R: FloatArray, scale: FloatArray) -> FloatArray:
    return np.asarray(R.T @ R / np.outer(scale, scale))


def test_without_noise_there_is_no_basis_and_the_columns_are_filtered_one_by_one() -> None:
    segments = (flown(1, 800, 0.0), flown(2, 800, 0.0))
    assert triangle_of(together(segments), (2, 2, 1), A, B) is None
    np.testing.assert_allclose(sriv(segments, (2, 2, 1)).theta, [-1.9, 0.905, 0.01, -0.006], rtol=1e-5)


def test_a_fit_that_begins_near_ends_where_the_other_one_does() -> None:
    segments = tuple(flown(seed, 700) for seed in range(8))
    whole = sriv(segments, (2, 2, 1))
    for left_out in range(8):
        rest = tuple(one for i, one in enumerate(segments) if i != left_out)
        far, near = sriv(rest, (2, 2, 1)), sriv(rest, (2, 2, 1), False, whole.theta)
        assert near.converged
        assert near.iterations <= far.iterations
        errors = np.sqrt(np.diag(far.covariance))
        assert np.abs((near.theta - far.theta) / errors).max() < 0.01
        assert np.isnan(near.covariance).all()


def test_a_start_that_is_not_near_does_no_harm() -> None:
    segments = tuple(flown(seed, 700) for seed in range(4))
    expected = sriv(segments, (2, 2, 1), False)
    found = sriv(segments, (2, 2, 1), False, np.array([0.99, 0.5, -3.0, 4.0]))
    errors = np.abs(found.theta - expected.theta) / np.abs(expected.theta)
    assert errors.max() < 1e-3
    assert np.all(np.abs(np.roots(polynomials(found.theta, (2, 2, 1))[0])) < 1.0)
