"""Least squares against Octave, `fit` as a whole, the model's own properties and its record, and what is refused."""

import dataclasses
import json
import math
from typing import Any

import control
import numpy as np
import pytest
from identification_data import WELL, octave, record
from numpy.testing import assert_allclose, assert_array_equal
from pydantic import TypeAdapter

from mavdiag.errors import IdentificationError
from mavdiag.identify import ArxModel, Method, ModelRecord, fit
from mavdiag.identify.arx import Records
from mavdiag.telemetry import FloatArray


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
    holed = np.where(np.arange(400) == 10, np.nan, y)
    sine = np.sin(0.3 * np.arange(400))
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
