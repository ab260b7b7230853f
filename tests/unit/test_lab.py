"""The lab's tools: a recursive estimate ends at the batch one, and a measured response meets the model of the data."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from identification_data import WELL, record
from numpy.testing import assert_allclose

from mavdiag.errors import IdentificationError
from mavdiag.identify import ArxModel, Method, fit
from mavdiag.identify.lab.frequency import compare, estimate_response, model_response
from mavdiag.identify.lab.recursive import RecursiveSpec, new_segment, snapshot, start, step


@pytest.mark.parametrize("order", [(1, 1, 1), (2, 2, 1), (2, 5, 0), (3, 2, 2)])
def test_without_forgetting_it_is_batch_least_squares(order: tuple[int, int, int]) -> None:
    one, two = record(WELL, 600, 0.2, 1), record(WELL, 500, 0.2, 2)
    spec = RecursiveSpec(order, forgetting=1.0)
    state = step(spec, start(spec), one.u, one.y)
    state = step(spec, new_segment(state), two.u, two.y)
    batch = fit([one.u, two.u], [one.y, two.y], order, dt=0.01, method="ls")
    tracked = snapshot(spec, state, 0.01)
    assert_allclose(tracked.theta, batch.theta, atol=1e-6)
    assert_allclose(tracked.standard_errors, batch.standard_errors, rtol=0.05)
    assert tracked.method is Method.RLS


@given(blocks=st.lists(st.integers(0, 30), max_size=8), seed=st.integers(0, 1000))
def test_blocks_do_not_matter(blocks: list[int], seed: int) -> None:
    data, spec = record(WELL, sum(blocks) + 1, 0.1, seed), RecursiveSpec(forgetting=0.99)
    whole = step(spec, start(spec), data.u[:-1], data.y[:-1])
    state, position = start(spec), 0
    for size in blocks:
        state = step(spec, state, data.u[position : position + size], data.y[position : position + size])
        position += size
    assert np.array_equal(state.theta, whole.theta)
    assert np.array_equal(state.P, whole.P)
    assert (state.loss, state.weight) == (whole.loss, whole.weight)


def test_forgetting_follows_a_change_and_a_long_hover_does_not_wind_it_up() -> None:
    weaker = ArxModel(WELL.a, 0.7 * WELL.b, 0.01, (2, 2, 1), Method.PUBLISHED)
    spec = RecursiveSpec(forgetting=0.99)
    state = start(spec)
    for model, seed in ((WELL, 3), (weaker, 4)):
        data = record(model, 3000, 0.0, seed)
        state = step(spec, new_segment(state), data.u, data.y)
        assert_allclose(snapshot(spec, state, 0.01).theta, model.theta, atol=1e-6)
    state = step(spec, state, np.zeros(20_000), np.zeros(20_000))
    assert np.max(np.diag(state.P)) <= 1e8 / 0.99
    data = record(WELL, 2000, 0.05, 5)
    state = step(spec, new_segment(state), data.u, data.y)
    assert_allclose(snapshot(spec, state, 0.01).a, fit(data.u, data.y, dt=0.01, method="ls").a, atol=0.2)


def test_what_a_recursive_estimate_refuses() -> None:
    spec = RecursiveSpec()
    with pytest.raises(IdentificationError, match="forgetting"):
        RecursiveSpec(forgetting=0.0)
    with pytest.raises(IdentificationError, match="whole numbers"):
        RecursiveSpec(order=(0, 1, 1))
    with pytest.raises(IdentificationError, match="one length"):
        step(spec, start(spec), np.zeros(3), np.zeros(4))
    with pytest.raises(IdentificationError, match="NaN"):
        step(spec, start(spec), np.zeros(3), np.array([0.0, np.nan, 0.0]))
    with pytest.raises(IdentificationError, match="too few"):
        snapshot(spec, step(spec, start(spec), np.ones(4), np.ones(4)), 0.01)


def test_a_measured_response_lies_within_its_stated_error() -> None:
    data = record(WELL, 60_000, 0.3, 1)
    measured = estimate_response(data.u, data.y, dt=0.01, segment=512)
    truth = model_response(WELL, measured.frequency_hz)
    z = np.exp(2j * np.pi * measured.frequency_hz * 0.01)
    assert_allclose(truth, WELL.to_control()(z), rtol=1e-12)
    use = measured.frequency_hz > 0.5
    off = (np.abs(measured.response[use] / truth[use]) - 1.0) / measured.relative_error[use]
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.0, abs=0.3)
    # coherence of y = G u + e, both white: |G|^2 / (|G|^2 + var e)
    expected = np.abs(truth) ** 2 / (np.abs(truth) ** 2 + 0.09 * data.clean.var())
    assert_allclose(measured.coherence[use], expected[use], atol=0.12)


def test_the_gap_tells_a_good_model_from_a_bad_one() -> None:
    data = record(WELL, 30_000, 0.2, 2)
    measured = estimate_response(data.u, data.y, dt=0.01, segment=256)
    good = compare(measured, fit(data.u, data.y, dt=0.01))
    assert good.gain_db < 0.6
    assert good.phase_deg < 4.0
    assert good.lines > 30
    late = ArxModel(WELL.a, np.r_[0.0, WELL.b], 0.01, (2, 2, 2), Method.PUBLISHED)
    assert compare(measured, late).phase_deg > 10 * good.phase_deg
    weak = ArxModel(WELL.a, 0.5 * WELL.b, 0.01, (2, 2, 1), Method.PUBLISHED)
    assert compare(measured, weak).gain_db == pytest.approx(20 * np.log10(2), abs=0.3)


def test_flights_are_averaged_and_what_shows_no_response_is_refused() -> None:
    one, two, short = (record(WELL, n, 0.1, n) for n in (4096, 2048, 300))
    both = estimate_response([one.u, two.u, short.u], [one.y, two.y, short.y], dt=0.01, segment=512)
    assert both.averages == pytest.approx(9 / 11 * (15 + 7))
    with pytest.raises(IdentificationError, match="two windows"):
        estimate_response(short.u, short.y, dt=0.01, segment=512)
    unrelated = [np.random.default_rng(seed).standard_normal(20_000) for seed in (4, 5)]
    with pytest.raises(IdentificationError, match="coherence"):
        compare(estimate_response(*unrelated, dt=0.01, segment=256), WELL)
