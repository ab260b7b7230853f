"""SRIV finds the truth under output noise, where least squares does not, and knows how well."""

import json

import numpy as np
import pytest
from identification_data import ROLL, WELL, record
from scipy.signal import lfilter
from shared_data import shared

from mavdiag.identify import ArxModel, Method, fit
from mavdiag.identify.arx import Segment, polynomials
from mavdiag.identify.estimate import nrmse_percent
from mavdiag.identify.sriv import sriv
from mavdiag.rows.savgol import coefficients


@pytest.mark.parametrize(
    ("noise", "sriv_fit", "ls_fit"),
    [(0.05, 99.8, 60.0), (0.20, 99.4, 12.0)],
)
@pytest.mark.parametrize("seed", range(2))
def test_the_thesis_roll_model_under_output_noise(noise: float, sriv_fit: float, ls_fit: float, seed: int) -> None:
    data = record(ROLL, 20_000, noise, seed)
    refined, plain = (fit(data.u, data.y, dt=0.001, method=method) for method in ("sriv", "ls"))
    assert refined.converged
    assert nrmse_percent(data.clean, refined.simulate(data.u)) > sriv_fit
    assert nrmse_percent(data.clean, plain.simulate(data.u)) < ls_fit


@pytest.mark.parametrize("column", ["y_out5", "y_out20"])
def test_octaves_noisy_records_give_the_true_model(column: str) -> None:
    folder = shared("reference/octave")
    table = np.genfromtxt(folder / "data_well.csv", delimiter=",", names=True)
    truth = json.loads((folder / "true_models.json").read_text())["well"]
    model = fit(table["u"], table[column], dt=0.001)
    error = model.theta - np.array([*truth["a"][1:], *truth["b"][1:]])
    assert np.all(np.abs(error) < 3.5 * model.standard_errors)
    assert nrmse_percent(table["y_clean"], model.simulate(table["u"])) > (99.7 if column == "y_out5" else 98.9)
    plain = fit(table["u"], table[column], dt=0.001, method="ls")
    assert nrmse_percent(table["y_clean"], plain.simulate(table["u"])) < (97.0 if column == "y_out5" else 85.0)


@pytest.mark.parametrize(("model", "n", "noise"), [(WELL, 1500, 0.2), (WELL, 1500, 0.5), (ROLL, 5000, 0.2)])
def test_standard_errors_are_right(model: ArxModel, n: int, noise: float) -> None:
    normalised = []
    for seed in range(40):
        data = record(model, n, noise, seed)
        found = fit(data.u, data.y, dt=model.dt)
        normalised.append((found.theta - model.theta) / found.standard_errors)
    rms = np.sqrt(np.mean(np.square(normalised), axis=0))
    # 40 trials: the rms of a parameter has a standard deviation of 0.11
    assert np.all((rms > 0.7) & (rms < 1.3)), rms


@pytest.mark.parametrize(("window", "hold"), [(5, 3), (101, 400)])
def test_standard_errors_hold_behind_a_smoothing_filter(window: int, hold: int) -> None:
    # The white-noise formula is wrong by a factor of 6 at 101 samples.
    slow = ArxModel(
        np.array([1.0, -1.98, 0.9805]), np.array([0.0, -0.0059, 0.0061]), 0.001, (2, 2, 1), Method.PUBLISHED
    )
    normalised = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.standard_normal(15_000 // hold), hold)
        clean = slow.simulate(u)
        y = clean + 0.2 * clean.std() * rng.standard_normal(len(u))
        value = coefficients(window)[0]
        found = fit(np.correlate(u, value, "valid"), np.correlate(y, value, "valid"), dt=0.001)
        normalised.append((found.theta - slow.theta) / found.standard_errors)
    rms = np.sqrt(np.mean(np.square(normalised), axis=0))
    assert np.all((rms > 0.6) & (rms < 1.5)), rms


def test_flights_that_begin_in_motion_do_not_bias_it() -> None:
    normalised = []
    for seed in range(40):
        data = record(ROLL, 6000, 0.2, seed)
        parts = [slice(2000, 3000), slice(3500, 4700), slice(4800, 6000)]
        found = fit([data.u[part] for part in parts], [data.y[part] for part in parts], dt=0.001)
        normalised.append((found.theta - ROLL.theta) / found.standard_errors)
    rms = np.sqrt(np.mean(np.square(normalised), axis=0))
    assert np.all(rms < 1.4), rms


@pytest.mark.parametrize("order", [(1, 1, 1), (2, 5, 0), (3, 2, 1), (2, 1, 4)])
def test_every_order_recovers_its_own_model(order: tuple[int, int, int]) -> None:
    na, nb, nk = order
    rng = np.random.default_rng(11)
    poles = np.array([0.9, 0.5, -0.3])[:na]
    a = np.real(np.atleast_1d(np.poly(poles)))
    truth = ArxModel(a, np.r_[np.zeros(nk), 0.3 + rng.random(nb)], 0.01, order, Method.PUBLISHED)
    data = record(truth, 8000, 0.1, 12)
    found = fit(data.u, data.y, order, dt=0.01)
    assert np.all(np.abs(found.theta - truth.theta) < 4.5 * found.standard_errors)
    assert nrmse_percent(data.clean, found.simulate(data.u)) > 99.0


def flown(seed: int, n: int) -> Segment:
    """A segment that begins in motion."""
    rng = np.random.default_rng(seed)
    u = np.cumsum(rng.normal(0.0, 0.1, n + 50))
    u -= lfilter([0.01], [1.0, -0.99], u)
    y = lfilter([0.0, 0.01, -0.006], [1.0, -1.9, 0.905], u)
    y += 0.05 * lfilter([0.2], [1.0, -0.8], rng.normal(size=n + 50))
    return Segment(u[50:], np.asarray(y[50:]))


def test_a_fit_that_begins_near_ends_where_the_other_one_does_and_a_bad_start_does_no_harm() -> None:
    segments = tuple(flown(seed, 700) for seed in range(8))
    whole, bad = sriv(segments, (2, 2, 1)), np.array([0.99, 0.5, -3.0, 4.0])
    for left_out in range(8):
        rest = tuple(one for i, one in enumerate(segments) if i != left_out)
        far, near, lost = (sriv(rest, (2, 2, 1), start is None, start) for start in (None, whole.theta, bad))
        assert near.converged
        assert near.iterations <= far.iterations
        errors = np.sqrt(np.diag(far.covariance))
        assert np.abs((near.theta - far.theta) / errors).max() < 0.01
        assert np.abs((lost.theta - far.theta) / errors).max() < 0.01
        assert np.all(np.abs(np.roots(polynomials(lost.theta, (2, 2, 1))[0])) < 1.0)
        assert np.isnan(near.covariance).all()
