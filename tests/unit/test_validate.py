"""Fit figures and residual tests against Octave and against known noise."""

import numpy as np
import pytest
from identification_data import ROLL, octave, record
from numpy.testing import assert_allclose

from mavdiag.errors import IdentificationError
from mavdiag.identify import fit
from mavdiag.identify.estimate import examine_residual, one_step_report, validate


@pytest.mark.parametrize("index", range(24))
def test_octave_residual_figures(index: int) -> None:
    case, u, y = octave(index)
    model = fit(u, y, (case["na"], case["nb"], case["nk"]), dt=0.001, method="ls")
    error = y[model.lag :] - model.predict(u, y)
    simulation_error = y - model.simulate(u)
    for q, e, simulated_e in zip(case["prct_p"], case["prct_e"], case["prct_es"], strict=True):
        assert np.percentile(error, q, method="hazen") == pytest.approx(e, abs=1e-9)
        assert np.percentile(simulation_error, q, method="hazen") == pytest.approx(simulated_e, abs=1e-9)
    if case["ls_loss"] < 1e-20:
        return  # the residual is rounding only
    report = one_step_report(model, u, y)
    assert report.acf_band99 == pytest.approx(case["conf99_band"], rel=1e-4)
    assert_allclose(report.acf, case["res_acf"], atol=1e-9)
    assert_allclose(report.ccf, case["res_ccf_pos"], atol=1e-9)


def test_only_the_true_structure_leaves_a_white_independent_residual() -> None:
    u, y = next((u, y) for case, u, y in map(octave, range(24)) if case["output"] == "y_eqnoise")
    peaks = []  # of the correlations over their bands
    for order in ((2, 2, 1), (2, 2, 2), (1, 1, 1)):  # true, late, low
        report = one_step_report(fit(u, y, order, dt=0.001, method="ls"), u, y)
        bands = (report.acf[1:], report.acf_band99), (report.ccf, report.ccf_band99)
        peaks.append([float(np.abs(values).max()) / band for values, band in bands])
    assert max(peaks[0]) < 1.3
    assert peaks[1][1] > 2.0
    assert peaks[2][0] > 2.0


def test_the_bands_hold_99_percent_of_what_a_true_model_shows() -> None:
    inside = np.zeros(2)
    for seed in range(200):
        rng = np.random.default_rng(seed)
        u = np.convolve(rng.standard_normal(1049), np.ones(50) / 50, "valid")  # as slow as flight data
        report = examine_residual(rng.standard_normal(1000), u)
        inside += [
            np.mean(np.abs(report.acf[1:]) <= report.acf_band99),
            np.mean(np.abs(report.ccf) <= report.ccf_band99),
        ]
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
