"""Recursive least squares ends at the batch solution, does not care for blocks, and follows a change."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from identification_data import WELL, record
from numpy.testing import assert_allclose

from mavdiag.errors import IdentificationError
from mavdiag.identify import ArxModel, Method, fit
from mavdiag.identify.lab.recursive import RecursiveSpec, new_segment, snapshot, start, step


@pytest.mark.parametrize("order", [(1, 1, 1), (2, 2, 1), (2, 5, 0), (3, 2, 2)])
def test_without_forgetting_it_is_batch_least_squares(order: tuple[int, int, int]) -> None:
    one, two = record(WELL, 600, 0.2, 1), record(WELL, 500, 0.2, 2)
    spec = RecursiveSpec(order, forgetting=1.0, initial_spread=1e8)
    state = step(spec, start(spec), one.u, one.y)
    state = step(spec, new_segment(state), two.u, two.y)
    batch = fit([one.u, two.u], [one.y, two.y], order, dt=0.01, method="ls")
    tracked = snapshot(spec, state, 0.01)
    assert_allclose(tracked.theta, batch.theta, atol=1e-6)
    assert_allclose(tracked.standard_errors, batch.standard_errors, rtol=0.05)
    assert tracked.method is Method.RLS


@given(blocks=st.lists(st.integers(0, 30), max_size=8), seed=st.integers(0, 1000))
def test_blocks_do_not_matter(blocks: list[int], seed: int) -> None:
    data = record(WELL, sum(blocks), 0.1, seed) if sum(blocks) else record(WELL, 1, 0.0, seed)
    n = sum(blocks)
    spec = RecursiveSpec(forgetting=0.99)
    whole = step(spec, start(spec), data.u[:n], data.y[:n])
    state, position = start(spec), 0
    for size in blocks:
        state = step(spec, state, data.u[position : position + size], data.y[position : position + size])
        position += size
    assert np.array_equal(state.theta, whole.theta)
    assert np.array_equal(state.P, whole.P)
    assert (state.loss, state.weight) == (whole.loss, whole.weight)


def test_forgetting_follows_a_change() -> None:
    before = record(WELL, 3000, 0.0, 3)
    weaker = ArxModel(WELL.a, 0.7 * WELL.b, 0.01, (2, 2, 1), Method.PUBLISHED)
    after = record(weaker, 3000, 0.0, 4)
    spec = RecursiveSpec(forgetting=0.99)
    state = step(spec, start(spec), before.u, before.y)
    assert_allclose(snapshot(spec, state, 0.01).theta, WELL.theta, atol=1e-6)
    state = step(spec, new_segment(state), after.u, after.y)
    assert_allclose(snapshot(spec, state, 0.01).theta, weaker.theta, atol=1e-6)


def test_a_long_hover_does_not_wind_it_up() -> None:
    data = record(WELL, 2000, 0.05, 5)
    spec = RecursiveSpec(forgetting=0.99, max_spread=1e8)
    state = step(spec, start(spec), data.u, data.y)
    hover = np.zeros(20_000)
    state = step(spec, state, hover, hover)
    assert np.all(np.isfinite(state.P))
    assert np.max(np.diag(state.P)) <= 1e8 / 0.99
    state = step(spec, new_segment(state), data.u, data.y)
    assert_allclose(snapshot(spec, state, 0.01).a, fit(data.u, data.y, dt=0.01, method="ls").a, atol=0.2)


def test_what_it_refuses() -> None:
    spec = RecursiveSpec()
    with pytest.raises(IdentificationError, match="forgetting"):
        RecursiveSpec(forgetting=0.0)
    with pytest.raises(IdentificationError, match="spreads"):
        RecursiveSpec(initial_spread=-1.0)
    with pytest.raises(IdentificationError, match="whole numbers"):
        RecursiveSpec(order=(0, 1, 1))
    with pytest.raises(IdentificationError, match="one length"):
        step(spec, start(spec), np.zeros(3), np.zeros(4))
    with pytest.raises(IdentificationError, match="NaN"):
        step(spec, start(spec), np.zeros(3), np.array([0.0, np.nan, 0.0]))
    with pytest.raises(IdentificationError, match="too few"):
        snapshot(spec, step(spec, start(spec), np.ones(4), np.ones(4)), 0.01)
