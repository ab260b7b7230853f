"""The lab's tools: recursive estimates, measured responses, orders, and figures of a model with their errors."""

import math

import numpy as np
import pytest
from identification_data import WELL, Record, record
from numpy.testing import assert_allclose

from mavdiag.identify import ArxModel, Method, Order, fit
from mavdiag.identify.estimate import ORDERS, best_row, sweep
from mavdiag.identify.lab.comparison import estimate_response, model_response, track
from mavdiag.identify.lab.figures import ModelFigures, model_figures


def last(*pairs: Record, order: Order = (2, 2, 1), forgetting: float = 1.0) -> ArxModel:
    """The model at the end of these records."""
    u, y = [one.u for one in pairs], [one.y for one in pairs]
    return [model for _, model in track(u, y, order, dt=0.01, forgetting=forgetting, every=10_000)][-1]


@pytest.mark.parametrize("order", [(1, 1, 1), (2, 5, 0), (3, 2, 2)])
def test_without_forgetting_it_is_batch_least_squares(order: Order) -> None:
    one, two = record(WELL, 600, 0.2, 1), record(WELL, 500, 0.2, 2)
    batch = fit([one.u, two.u], [one.y, two.y], order, dt=0.01, method="ls")
    tracked = last(one, two, order=order)
    assert_allclose(tracked.theta, batch.theta, atol=1e-6)
    assert_allclose(tracked.standard_errors, batch.standard_errors, rtol=0.05)
    assert tracked.method is Method.RLS


def test_forgetting_follows_a_change_and_a_long_hover_does_not_wind_it_up() -> None:
    weaker = ArxModel(WELL.a, 0.7 * WELL.b, 0.01, (2, 2, 1), Method.PUBLISHED)
    before, after = record(WELL, 3000, 0.0, 3), record(weaker, 3000, 0.0, 4)
    assert_allclose(last(before, after, forgetting=0.99).theta, weaker.theta, atol=1e-6)
    still = Record(np.zeros(20_000), np.zeros(20_000), np.zeros(20_000))
    data = record(WELL, 2000, 0.05, 5)
    found = last(before, still, data, forgetting=0.99)
    assert_allclose(found.a, fit(data.u, data.y, dt=0.01, method="ls").a, atol=0.2)


def test_a_measured_response_lies_within_its_stated_error() -> None:
    data = record(WELL, 60_000, 0.3, 1)
    measured = estimate_response(data.u, data.y, dt=0.01, segment=512)
    truth = model_response(WELL, measured.frequency_hz)
    z = np.exp(2j * np.pi * measured.frequency_hz * 0.01)
    assert_allclose(truth, WELL.to_control()(z), rtol=1e-12)
    use = measured.frequency_hz > 0.5
    averages = 9 / 11 * (2 * 60_000 // 512 - 1)  # half-overlapping Hann windows are not independent (Welch 1967)
    coherence = measured.coherence[use]
    # standard deviation of |response| over |response| (Bendat and Piersol, Random Data 4e, Table 9.6)
    stated = np.sqrt((1.0 - coherence) / (2.0 * coherence * averages))
    off = (np.abs(measured.response[use] / truth[use]) - 1.0) / stated
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.0, abs=0.3)
    # coherence of y = G u + e, both white: |G|^2 / (|G|^2 + var e)
    expected = np.abs(truth) ** 2 / (np.abs(truth) ** 2 + 0.09 * data.clean.var())
    assert_allclose(measured.coherence[use], expected[use], atol=0.12)


def test_the_order_that_made_the_data_is_chosen() -> None:
    train, other = record(WELL, 1500, 0.1, 0), record(WELL, 1000, 0.1, 100)
    rows = sweep(((one, 0, (train.u, train.y), (other.u, other.y)) for one in ORDERS), dt=0.01)
    assert len(rows) == 3 * 5 * 5
    assert best_row(rows).order == (2, 2, 1)


DT = 0.01


def test_figures_of_a_sampled_oscillator_are_those_of_the_textbook() -> None:
    wn, zeta = 2 * math.pi * 3.0, 0.4  # 3 Hz; poles exp((-zeta +- j sqrt(1 - zeta^2)) wn dt)
    pole = np.exp(complex(-zeta, math.sqrt(1 - zeta**2)) * wn * DT)
    a = np.real(np.poly([pole, pole.conjugate()]))
    found = model_figures(ArxModel(a, np.array([0.0, a.sum()]), DT, (2, 1, 1), Method.PUBLISHED))
    (pair,) = found.poles
    assert pair.natural_hz.value == pytest.approx(3.0)
    assert pair.damping.value == pytest.approx(zeta)
    assert pair.real.value == pytest.approx(pole.real)
    assert pair.imaginary.value == pytest.approx(pole.imag)
    assert found.dc_gain.value == pytest.approx(1.0)
    # continuous: wb = wn sqrt(1 - 2 z^2 + sqrt((1 - 2 z^2)^2 + 1))
    share = 1 - 2 * zeta**2
    assert found.bandwidth_hz.value == pytest.approx(3.0 * math.sqrt(share + math.sqrt(share**2 + 1)), rel=0.02)
    assert found.dc_gain.standard_error is None
    assert found.errors_from.startswith("nothing")


def test_margins_are_those_of_the_loop_that_unit_feedback_closes() -> None:
    # L = k z^-1/(1 - z^-1): poles of T at 1 - k, unstable from k = 2, so the gain margin of k = 0.5 is 4
    found = model_figures(ArxModel(np.array([1.0, -0.5]), np.array([0.0, 0.5]), DT, (1, 1, 1), Method.PUBLISHED))
    assert found.gain_margin_db.value == pytest.approx(20 * math.log10(4.0))
    crossover = 2 * math.asin(0.25)  # |L| = k / (2 sin(w/2)) = 1; phase -90 - w/2 degrees
    assert found.phase_margin_deg.value == pytest.approx(90 - math.degrees(crossover / 2))
    frequency = np.linspace(0.001, math.pi, 20000)
    L = 0.5 / (np.exp(1j * frequency) - 1)
    assert found.modulus_margin.value == pytest.approx(float(np.abs(1 + L).min()), rel=1e-3)


def numbers(found: ModelFigures) -> list[tuple[float, float]]:
    pole = found.poles[0]
    chosen = (pole.natural_hz, pole.damping, found.dc_gain, found.bandwidth_hz, found.gain_margin_db)
    return [(one.value or math.nan, one.standard_error or math.nan) for one in chosen]


def test_standard_errors_by_the_delta_method_are_the_scatter_of_repeated_experiments() -> None:
    trains = [record(WELL, 1500, 0.1, seed) for seed in range(40)]
    models = [fit(train.u, train.y, dt=DT) for train in trains]
    table = np.array([numbers(model_figures(model)) for model in models])
    scatter, stated = table[:, :, 0].std(axis=0, ddof=1), table[:, :, 1].mean(axis=0)
    assert_allclose(stated, scatter, rtol=0.35)
