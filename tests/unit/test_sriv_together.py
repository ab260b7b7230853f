"""SRIV's rows are reduced in two ways that agree; fits that begin near end where the others do."""

import numpy as np
import pytest
from scipy.signal import lfilter

from mavdiag.identify.arx import Segment, polynomials
from mavdiag.identify.sriv import sriv

A, B = np.array([1.0, -1.9, 0.905]), np.array([0.0, 0.01, -0.006])


def flown(seed: int, n: int, noise: float = 0.05) -> Segment:
    """A segment that begins in motion."""
    rng = np.random.default_rng(seed)
    u = np.cumsum(rng.normal(0.0, 0.1, n + 50))
    u -= lfilter([0.01], [1.0, -0.99], u)
    y = lfilter(B, A, u) + noise * lfilter([0.2], [1.0, -0.8], rng.normal(size=n + 50))
    return Segment(u[50:], np.asarray(y[50:]))


def test_without_a_basis_the_columns_are_reduced_by_reflections(monkeypatch: pytest.MonkeyPatch) -> None:
    segments = tuple(flown(seed, n) for seed, n in enumerate((900, 900, 700, 321, 900)))
    by_cholesky = sriv(segments, (2, 2, 1))
    monkeypatch.setattr("mavdiag.identify.sriv._by_cholesky", lambda *_: None)
    by_reflections = sriv(segments, (2, 2, 1))
    np.testing.assert_allclose(by_cholesky.theta, by_reflections.theta, rtol=1e-8)
    np.testing.assert_allclose(by_cholesky.covariance, by_reflections.covariance, rtol=1e-6)


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
