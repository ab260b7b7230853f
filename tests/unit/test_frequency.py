"""The measured frequency response meets the model that made the data."""

import numpy as np
import pytest
from identification_data import WELL, record
from numpy.testing import assert_allclose

from mavdiag.errors import IdentificationError
from mavdiag.identify import ArxModel, Method, fit
from mavdiag.identify.lab.frequency import compare, estimate_response, model_response


def test_model_response_equals_python_control() -> None:
    transfer = WELL.to_control()
    frequency = np.array([0.0, 1.0, 10.0, 50.0])
    z = np.exp(2j * np.pi * frequency * 0.01)
    assert_allclose(model_response(WELL, frequency), [transfer(complex(one)) for one in z], rtol=1e-12)


def test_estimate_lies_within_its_stated_error() -> None:
    data = record(WELL, 60_000, 0.3, 1)
    measured = estimate_response(data.u, data.y, dt=0.01, segment=512)
    truth = model_response(WELL, measured.frequency_hz)
    use = measured.frequency_hz > 0.5
    z = (np.abs(measured.response[use] / truth[use]) - 1.0) / measured.relative_error[use]
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.3)
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


def test_flights_are_averaged_and_short_ones_left_out() -> None:
    one, two, short = (record(WELL, n, 0.1, n) for n in (4096, 2048, 300))
    both = estimate_response([one.u, two.u, short.u], [one.y, two.y, short.y], dt=0.01, segment=512)
    assert both.averages == pytest.approx(9 / 11 * (15 + 7))
    alone = estimate_response(one.u, one.y, dt=0.01, segment=512)
    assert alone.averages < both.averages


def test_what_it_refuses() -> None:
    data = record(WELL, 400, 0.1, 3)
    with pytest.raises(IdentificationError, match="two windows"):
        estimate_response(data.u, data.y, dt=0.01, segment=512)
    noise = np.random.default_rng(4).standard_normal(20_000)
    unrelated = np.random.default_rng(5).standard_normal(20_000)
    with pytest.raises(IdentificationError, match="coherence"):
        compare(estimate_response(noise, unrelated, dt=0.01, segment=256), WELL)
