"""Identification: Octave's and python-control's answers, SRIV under noise, residuals, and the laboratory's tools."""

import dataclasses
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydantic import TypeAdapter
from scipy.signal import lfilter
from shared_data import shared

from mavdiag.errors import IdentificationError
from mavdiag.identify import ArxModel, Method, ModelRecord, Order, fit
from mavdiag.identify.arx import Records, Segment, polynomials
from mavdiag.identify.estimate import ORDERS, best_row, examine_residual, sweep, validate
from mavdiag.identify.lab import estimate_response, model_figures, model_response, track
from mavdiag.identify.sriv import sriv
from mavdiag.rows.savgol import coefficients
from mavdiag.telemetry import FloatArray

#: Well-damped second order, poles 0.6 +- 0.4j.
WELL = ArxModel(np.array([1.0, -1.2, 0.52]), np.array([0.0, 0.5, 0.25]), 0.01, (2, 2, 1), Method.PUBLISHED)

#: The thesis's roll model (T Eq 5.1): a pole at 0.9985, where least squares fails.
ROLL = ArxModel(np.array([1.0, -1.5326, 0.5333]), np.array([0.0, 0.0743, 0.0616]), 0.001, (2, 2, 1), Method.PUBLISHED)
DT = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """White input u, clean output, and output with white noise of `noise` times its standard deviation, (n,) each."""

    u: FloatArray
    clean: FloatArray
    y: FloatArray


def record(model: ArxModel, n: int, noise: float, seed: int) -> Record:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    clean = model.simulate(u)
    return Record(u, clean, clean + noise * clean.std() * rng.standard_normal(n))


@cache
def octave(index: int) -> tuple[dict[str, Any], FloatArray, FloatArray]:
    folder = shared("reference/octave")
    table = np.genfromtxt(folder / "data_well.csv", delimiter=",", names=True)
    case: dict[str, Any] = json.loads((folder / "arx_reference_well.json").read_text())[index]
    return case, np.asarray(table["u"], dtype=np.float64), np.asarray(table[case["output"]], dtype=np.float64)


@pytest.mark.parametrize("index", range(24))
def test_least_squares_is_octaves(index: int) -> None:
    case, u, y = octave(index)
    model = fit(u, y, (case["na"], case["nb"], case["nk"]), dt=0.001, method="ls")
    assert_allclose(model.a, case["ls_A"], atol=1e-9)
    assert_allclose(model.b, case["ls_B"], atol=1e-9)
    # Its own nk = 0 is done by advancing u by one sample, so that case starts one row later.
    tolerance = 2e-3 if case["nk"] == 0 else 1e-9
    assert_allclose(model.a, case["octave_arx_A"], atol=tolerance)
    assert_allclose(model.b[: len(case["octave_arx_B"])], case["octave_arx_B"], atol=tolerance)
    if case["ls_loss"] >= 1e-20:  # free of noise residuals are rounding only
        assert_allclose(model.standard_errors, case["ls_se"], rtol=1e-8)
    y_sim = model.simulate(u)
    assert_allclose(abs(model.poles[0]), case["max_pole"], atol=1e-9)
    assert_allclose(y_sim[:10], case["sim_first10"], atol=1e-9)
    assert_allclose(y_sim[-5:], case["sim_last5"], atol=1e-9)
    assert_allclose(model.nrmse_fit, case["fit_nrmse_pct"], atol=1e-8)
    assert_allclose(model.r2t, case["RT2"], atol=1e-10)


def test_flights_are_stacked_and_never_joined() -> None:
    one, two = record(WELL, 300, 0.1, 1), record(WELL, 200, 0.1, 2)
    found = fit([one.u, two.u], [one.y, two.y], dt=0.01, method="ls")
    # [ y(t) ] = [ -y(t-1) -y(t-2) u(t-1) u(t-2) ] @ theta, written out here row by row
    rows, target = [], []
    for data in (one, two):
        for t in range(2, len(data.y)):
            rows.append([-data.y[t - 1], -data.y[t - 2], data.u[t - 1], data.u[t - 2]])
            target.append(data.y[t])
    expected, *_ = np.linalg.lstsq(np.array(rows), np.array(target), rcond=None)
    assert_allclose(found.theta, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("a", "b", "dt", "order", "match"),
    [
        ([1.0, -0.5], [0.0, 1.0, 2.0], 0.01, (1, 1, 1), "needs 2 a, 2 b"),
        ([2.0, -0.5], [0.0, 1.0], 0.01, (1, 1, 1), r"a\[0\] = 1"),
        ([1.0, -0.5], [0.5, 1.0], 0.01, (1, 1, 1), "leading zeros"),
        ([1.0, np.nan], [0.0, 1.0], 0.01, (1, 1, 1), "finite"),
        ([1.0, -0.5], [0.0, 1.0], 0.0, (1, 1, 1), "sample time"),
        ([1.0, -0.5], [0.0, 1.0], 0.01, (0, 1, 1), "order"),
    ],
)
def test_an_impossible_model_is_refused(
    a: list[float], b: list[float], dt: float, order: tuple[int, int, int], match: str
) -> None:
    with pytest.raises(IdentificationError, match=match):
        ArxModel(np.array(a), np.array(b), dt, order, Method.PUBLISHED)
    with pytest.raises(IdentificationError, match=match):
        ModelRecord(a=tuple(a), b=tuple(b), dt_s=dt, order=order, method=Method.PUBLISHED)


@pytest.mark.parametrize("order", [(2, 2, 1), (1, 3, 2), (3, 1, 0), (1, 1, 0)])
def test_python_control_agrees(order: tuple[int, int, int]) -> None:
    na, nb, nk = order
    a = np.real(np.atleast_1d(np.poly([0.8, -0.4, 0.2][:na])))
    model = ArxModel(a, np.r_[np.zeros(nk), np.arange(1.0, nb + 1)], 0.02, order, Method.PUBLISHED)
    transfer = model.to_control()
    assert transfer.dt == 0.02
    assert transfer.dcgain() == pytest.approx(model.dc_gain)
    nonzero = np.sort(transfer.poles()[np.abs(transfer.poles()) > 1e-9].real)
    assert_allclose(nonzero, np.sort(model.poles.real), atol=1e-9)
    u = np.random.default_rng(1).standard_normal(80)
    response = control.forced_response(transfer, 0.02 * np.linspace(0.0, 79.0, 80), u)
    assert_allclose(np.ravel(response.outputs), model.simulate(u), atol=1e-9)


def good() -> tuple[FloatArray, FloatArray]:
    data = record(WELL, 400, 0.1, 8)
    return data.u, data.y


@pytest.mark.parametrize("method", ["ls", "sriv"])
def test_bad_data_are_refused_with_one_line(method: str) -> None:
    u, y = good()
    plain, tall = (fit(u, scale * y, dt=0.01, method=method).dc_gain for scale in (1.0, 1e9))  # in whatever unit
    assert tall == pytest.approx(1e9 * plain)
    holed, sine = np.where(np.arange(400) == 10, np.nan, y), np.sin(0.3 * np.arange(400))
    cases: list[tuple[Records, Records, str]] = [
        (u[:2], y[:2], "too short"),
        (u[:30], y[:30], "too short"),
        (u, y[:-1], "400 samples and y has 399"),
        (u, holed, "NaN"),
        (np.full_like(u, np.inf), y, "infinite"),
        (np.ones_like(u), y, "u is constant"),
        (u, np.ones_like(y), "y is constant"),
        (np.r_[np.ones(200), 2 * np.ones(200)][:, None] * [1, 1], y, "one-dimensional"),
        ([u, u], [y], "one of each"),
        ([], [], "one of each"),
        ([u, u[:2]], [y, y[:2]], "segment 2 is too short"),
        (sine, WELL.simulate(sine) + 1e-3 * y, "persistently exciting of order 2, this model needs 4"),
    ]
    for case_u, case_y, match in cases:
        with pytest.raises(IdentificationError, match=match) as caught:
            fit(case_u, case_y, dt=0.01, method=method)
        assert "\n" not in str(caught.value)


def test_results_that_are_no_models_are_refused() -> None:
    u = np.random.default_rng(9).standard_normal(300)
    growing = ArxModel(np.array([1.0, -1.02]), np.array([0.0, 1.0]), 0.01, (1, 1, 1), Method.PUBLISHED)
    with pytest.raises(IdentificationError, match="unstable"):
        fit(u, growing.simulate(u), (1, 1, 1), dt=0.01, method="ls")
    data = record(WELL, 400, 0.0, 8)
    with pytest.raises(IdentificationError, match="linearly dependent"):
        fit(data.u, data.y, (3, 3, 1), dt=0.01, method="ls")


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        *(({"order": order}, "whole numbers") for order in [(0, 2, 1), (2, 2, -1), (2, 2), (2.0, 2, 1), (True, 2, 1)]),
        *(({"method": method}, "use 'sriv' or 'ls'") for method in ("arx", Method.RLS)),
        *(({"dt": dt}, "sample time") for dt in (0.0, -1.0, float("nan"))),
    ],
)
def test_bad_arguments_are_refused(wrong: dict[str, Any], match: str) -> None:
    with pytest.raises(IdentificationError, match=match):
        fit(*good(), **{"dt": 0.01, **wrong})


def test_the_record_of_a_model_gives_the_model_back_also_through_json() -> None:
    model = fit(*good(), dt=0.01)
    stored = json.dumps(dataclasses.asdict(ModelRecord.of(model)), allow_nan=False)
    back = TypeAdapter(ModelRecord).validate_json(stored).model()
    for name in ("a", "b", "standard_errors", "covariance"):
        assert_array_equal(getattr(back, name), getattr(model, name))
    assert (back.r2t, back.mse, back.samples, back.order) == (model.r2t, model.mse, 400, (2, 2, 1))
    bare = ModelRecord.of(WELL)
    assert (bare.r2t, bare.standard_errors, bare.covariance) == (None, (), ())
    assert math.isnan(bare.model().r2t)


def rms(truth: ArxModel, fits: Iterable[ArxModel]) -> FloatArray:
    """Of the errors of each parameter over their stated standard errors."""
    errors = np.array([(one.theta - truth.theta) / one.standard_errors for one in fits])
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0)))


@pytest.mark.parametrize(("model", "n", "noise"), [(WELL, 1500, 0.2), (WELL, 1500, 0.5), (ROLL, 5000, 0.2)])
def test_standard_errors_are_right(model: ArxModel, n: int, noise: float) -> None:
    flights = [record(model, n, noise, seed) for seed in range(40)]
    found = rms(model, (fit(one.u, one.y, dt=model.dt) for one in flights))
    # 40 trials: the rms of a parameter has a standard deviation of 0.11
    assert np.all((found > 0.7) & (found < 1.3)), found


@pytest.mark.parametrize(("window", "hold"), [(5, 3), (101, 400)])
def test_standard_errors_hold_behind_a_smoothing_filter(window: int, hold: int) -> None:
    # The white-noise formula is wrong by a factor of 6 at 101 samples.
    lag = ArxModel(np.array([1.0, -1.98, 0.9805]), np.array([0.0, -0.0059, 0.0061]), 0.001, (2, 2, 1), Method.PUBLISHED)
    value, fits = coefficients(window)[0], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.standard_normal(15_000 // hold), hold)
        clean = lag.simulate(u)
        y = clean + 0.2 * clean.std() * rng.standard_normal(len(u))
        fits.append(fit(np.correlate(u, value, "valid"), np.correlate(y, value, "valid"), dt=0.001))
    found = rms(lag, fits)
    assert np.all((found > 0.6) & (found < 1.5)), found


def test_flights_that_begin_in_motion_do_not_bias_it() -> None:
    parts = [slice(2000, 3000), slice(3500, 4700), slice(4800, 6000)]
    flights = [record(ROLL, 6000, 0.2, seed) for seed in range(40)]
    found = rms(ROLL, (fit([one.u[p] for p in parts], [one.y[p] for p in parts], dt=0.001) for one in flights))
    assert np.all(found < 1.4), found


@pytest.mark.parametrize("method", ["sriv", "ls"])
def test_what_is_followed_tells_the_gain_that_noise_does_not_and_is_in_no_figure(method: str) -> None:
    u, y = 0.02 * np.random.default_rng(5).standard_normal((2, 3000))
    model = fit(u, y, dt=0.01, method=method, followed=np.full(500, 0.2))
    assert model.dc_gain == pytest.approx(1.0, abs=0.05) != fit(u, y, dt=0.01, method=method).dc_gain
    assert (model.samples, model.r2t < 0.1) == (3000, True)


@pytest.mark.parametrize("order", [(1, 1, 1), (2, 5, 0), (3, 2, 1), (2, 1, 4)])
def test_every_order_recovers_its_own_model(order: tuple[int, int, int]) -> None:
    na, nb, nk = order
    rng, poles = np.random.default_rng(11), np.array([0.9, 0.5, -0.3])[:na]
    a = np.real(np.atleast_1d(np.poly(poles)))
    truth = ArxModel(a, np.r_[np.zeros(nk), 0.3 + rng.random(nb)], 0.01, order, Method.PUBLISHED)
    data = record(truth, 8000, 0.1, 12)
    found = fit(data.u, data.y, order, dt=0.01)
    assert np.all(np.abs(found.theta - truth.theta) < 4.5 * found.standard_errors)
    assert validate(found, data.u, data.clean).nrmse_fit > 99.0


def flown(seed: int, n: int) -> Segment:
    rng = np.random.default_rng(seed)
    u = np.cumsum(rng.normal(0.0, 0.1, n + 50))
    u -= lfilter([0.01], [1.0, -0.99], u)
    y = lfilter([0.0, 0.01, -0.006], [1.0, -1.9, 0.905], u)
    y += 0.05 * lfilter([0.2], [1.0, -0.8], rng.normal(size=n + 50))
    return Segment(u[50:], np.asarray(y[50:]))


def test_a_fit_that_begins_near_ends_where_the_other_one_does_and_a_bad_start_does_no_harm() -> None:
    segments = tuple(flown(seed, 700) for seed in range(8))
    whole, bad = sriv(segments, (2, 2, 1))[0], np.array([0.99, 0.5, -3.0, 4.0])
    for left_out in range(8):
        rest = tuple(one for i, one in enumerate(segments) if i != left_out)
        found = (sriv(rest, (2, 2, 1), start is None, start) for start in (None, whole, bad))
        (far, covariance, _), (near, unknown, settled), (lost, *_) = found
        assert settled
        errors = np.sqrt(np.diag(covariance))
        assert np.abs((near - far) / errors).max() < 0.01
        assert np.abs((lost - far) / errors).max() < 0.01
        assert np.all(np.abs(np.roots(polynomials(lost, (2, 2, 1))[0])) < 1.0)
        assert np.isnan(unknown).all()


@pytest.mark.parametrize("index", range(24))
def test_octave_residual_figures(index: int) -> None:
    case, u, y = octave(index)
    model = fit(u, y, (case["na"], case["nb"], case["nk"]), dt=0.001, method="ls")
    error, simulation_error = y[model.lag :] - model.predict(u, y), y - model.simulate(u)
    for q, e, simulated_e in zip(case["prct_p"], case["prct_e"], case["prct_es"], strict=True):
        assert np.percentile(error, q, method="hazen") == pytest.approx(e, abs=1e-9)
        assert np.percentile(simulation_error, q, method="hazen") == pytest.approx(simulated_e, abs=1e-9)
    if case["ls_loss"] < 1e-20:
        return  # the residual is rounding only
    report = examine_residual(error, u[model.lag :])
    assert report.acf_band99 == pytest.approx(case["conf99_band"], rel=1e-4)
    assert_allclose(report.acf, case["res_acf"], atol=1e-9)
    assert_allclose(report.ccf, case["res_ccf_pos"], atol=1e-9)


def test_the_bands_hold_99_percent_of_what_a_true_model_shows() -> None:
    inside = np.zeros(2)
    for seed in range(200):
        rng = np.random.default_rng(seed)
        u = np.convolve(rng.standard_normal(1049), np.ones(50) / 50, "valid")  # as slow as flight data
        report = examine_residual(rng.standard_normal(1000), u)
        bands = (report.acf[1:], report.acf_band99), (report.ccf, report.ccf_band99)
        inside += [np.mean(np.abs(shown) <= band) for shown, band in bands]
    assert np.all(inside / 200 > 0.98)


def test_records_that_begin_in_motion_may_settle_first() -> None:
    data = record(ROLL, 12_000, 0.0, 3)
    top = int(np.argmax(np.abs(data.y[:4000])))
    u, y = data.u[top : top + 8000], data.y[top : top + 8000]
    assert validate(ROLL, u, y).r2t < 0.99
    assert validate(ROLL, u, y, settle_s=5.0).r2t > 0.9999  # five time constants of the pole 0.9985 are 3.3 s
    found = fit(u, y, dt=0.001, settle_s=5.0)
    assert found.r2t > 0.9999
    assert found.samples == 8000
    assert_allclose(found.theta, fit(u, y, dt=0.001).theta)
    for settle_s, match in ((8.0, "lower it"), (-1.0, "0 or more"), (float("nan"), "0 or more")):
        with pytest.raises(IdentificationError, match=match):
            validate(ROLL, u, y, settle_s)


def last(*pairs: Record, order: Order = (2, 2, 1), forgetting: float = 1.0) -> ArxModel:
    u, y = [one.u for one in pairs], [one.y for one in pairs]
    return [model for _, model in track(u, y, order, dt=0.01, forgetting=forgetting, every=10_000)][-1]


@pytest.mark.parametrize("order", [(1, 1, 1), (2, 5, 0), (3, 2, 2)])
def test_without_forgetting_it_is_batch_least_squares(order: Order) -> None:
    one, two = record(WELL, 600, 0.2, 1), record(WELL, 500, 0.2, 2)
    batch, tracked = fit([one.u, two.u], [one.y, two.y], order, dt=0.01, method="ls"), last(one, two, order=order)
    assert_allclose(tracked.theta, batch.theta, atol=1e-6)
    assert_allclose(tracked.standard_errors, batch.standard_errors, rtol=0.005)
    assert tracked.method is Method.RLS


def test_forgetting_follows_a_change_and_a_long_hover_does_not_wind_it_up() -> None:
    weaker = ArxModel(WELL.a, 0.7 * WELL.b, 0.01, (2, 2, 1), Method.PUBLISHED)
    before, after = record(WELL, 3000, 0.0, 3), record(weaker, 3000, 0.0, 4)
    assert_allclose(last(before, after, forgetting=0.99).theta, weaker.theta, atol=1e-6)
    still, data = Record(np.zeros(20_000), np.zeros(20_000), np.zeros(20_000)), record(WELL, 2000, 0.05, 5)
    found = last(before, still, data, forgetting=0.99)
    assert_allclose(found.a, fit(data.u, data.y, dt=0.01, method="ls").a, atol=0.2)


def test_a_measured_response_lies_within_its_stated_error() -> None:
    data = record(WELL, 60_000, 0.3, 1)
    measured = estimate_response(data.u, data.y, dt=0.01, segment=512)
    truth, z = model_response(WELL, measured.frequency_hz), np.exp(2j * np.pi * measured.frequency_hz * 0.01)
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
    assert (len(rows), best_row(rows).order) == (3 * 5 * 5, (2, 2, 1))


def test_a_variance_below_zero_makes_no_order_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    """As rounding leaves it where the data hardly tell a parameter, on one processor and not on another."""

    def rounded(*given: Any) -> tuple[FloatArray, FloatArray, bool]:
        theta, covariance, settled = sriv(*given)
        return theta, -covariance, settled

    made = record(WELL, 500, 0.1, seed=0)
    assert fit(made.u, made.y, (2, 2, 1), dt=DT).yic < 0.0
    monkeypatch.setattr("mavdiag.identify.estimate.sriv", rounded)
    assert fit(made.u, made.y, (2, 2, 1), dt=DT).yic == math.inf


def test_figures_of_a_sampled_oscillator_are_those_of_the_textbook() -> None:
    wn, zeta = 2 * math.pi * 3.0, 0.4  # 3 Hz; poles exp((-zeta +- j sqrt(1 - zeta^2)) wn dt)
    pole = np.exp(complex(-zeta, math.sqrt(1 - zeta**2)) * wn * DT)
    a = np.real(np.poly([pole, pole.conjugate()]))
    found = model_figures(ArxModel(a, np.array([0.0, a.sum()]), DT, (2, 1, 1), Method.PUBLISHED))
    (pair,) = found.poles
    assert (pair.natural_hz.value, pair.damping.value) == pytest.approx((3.0, zeta))
    assert (pair.real.value, pair.imaginary.value) == pytest.approx((pole.real, pole.imag))
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


def test_standard_errors_by_the_delta_method_are_the_scatter_of_repeated_experiments() -> None:
    trains, table = [record(WELL, 1500, 0.1, seed) for seed in range(24)], []
    for found in (model_figures(fit(train.u, train.y, dt=DT)) for train in trains):
        pole = found.poles[0]
        chosen = (pole.natural_hz, pole.damping, found.dc_gain, found.bandwidth_hz, found.gain_margin_db)
        table.append([(one.value or math.nan, one.standard_error or math.nan) for one in chosen])
    scatter, stated = np.std(table, axis=0, ddof=1)[:, 0], np.mean(table, axis=0)[:, 1]
    assert_allclose(stated, scatter, rtol=0.35)
