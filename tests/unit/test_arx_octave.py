"""Least squares and its fit figures against Octave, 24 cases."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from shared_data import shared

from mavdiag.identify import ArxModel, fit
from mavdiag.identify.validate import nrmse_percent, r_squared
from mavdiag.telemetry import FloatArray


@dataclass(frozen=True, slots=True)
class Case:
    reference: dict[str, Any]
    u: FloatArray
    y: FloatArray
    model: ArxModel

    @property
    def exact(self) -> bool:
        """The data are free of noise and the structure holds the truth: residuals are rounding only."""
        return bool(self.reference["ls_loss"] < 1e-20)


def load_case(index: int) -> Case:
    folder = shared("reference/octave")
    table = np.genfromtxt(folder / "data_well.csv", delimiter=",", names=True)
    reference = json.loads((folder / "arx_reference_well.json").read_text())[index]
    u, y = np.asarray(table["u"], dtype=float), np.asarray(table[reference["output"]], dtype=float)
    order = (reference["na"], reference["nb"], reference["nk"])
    return Case(reference, u, y, fit(u, y, order, dt=0.001, method="ls"))


@pytest.fixture(params=range(24), scope="module")
def case(request: pytest.FixtureRequest) -> Case:
    return load_case(request.param)


def test_coefficients(case: Case) -> None:
    assert_allclose(case.model.a, case.reference["ls_A"], atol=1e-9)
    assert_allclose(case.model.b, case.reference["ls_B"], atol=1e-9)


def test_octaves_own_arx(case: Case) -> None:
    # Its nk = 0 is done by advancing u by one sample, so that case starts one row later.
    tolerance = 2e-3 if case.reference["nk"] == 0 else 1e-9
    assert_allclose(case.model.a, case.reference["octave_arx_A"], atol=tolerance)
    assert_allclose(case.model.b[: len(case.reference["octave_arx_B"])], case.reference["octave_arx_B"], atol=tolerance)


def test_standard_errors_and_loss(case: Case) -> None:
    if case.exact:
        assert case.model.fpe < 1e-20
        return
    assert_allclose(case.model.standard_errors, case.reference["ls_se"], rtol=1e-8)
    assert_allclose(case.model.fpe, case.reference["fpe"], rtol=1e-9)
    assert_allclose(case.model.aic, case.reference["aic_matlab"], rtol=1e-9)


def test_poles_and_simulation(case: Case) -> None:
    y_sim = case.model.simulate(case.u)
    assert_allclose(abs(case.model.poles[0]), case.reference["max_pole"], atol=1e-9)
    assert_allclose(y_sim[:10], case.reference["sim_first10"], atol=1e-9)
    assert_allclose(y_sim[-5:], case.reference["sim_last5"], atol=1e-9)
    assert_allclose(case.model.nrmse_fit, case.reference["fit_nrmse_pct"], atol=1e-8)
    assert_allclose(case.model.r2t, case.reference["RT2"], atol=1e-10)
    assert case.model.nrmse_fit == nrmse_percent(case.y, y_sim)
    assert case.model.r2t == r_squared(case.y, y_sim)
