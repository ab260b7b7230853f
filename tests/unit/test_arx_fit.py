"""`fit` as a whole: several flights, the model's own properties, and what it refuses."""

import subprocess
import sys
from dataclasses import FrozenInstanceError

import control
import numpy as np
import pytest
from identification_data import ROLL, WELL, record
from numpy.testing import assert_allclose

from mavdiag.errors import IdentificationError
from mavdiag.identify import ArxModel, Method, fit
from mavdiag.identify.arx import Records
from mavdiag.telemetry import FloatArray


def test_flights_are_stacked_and_never_joined() -> None:
    one, two = record(WELL, 300, 0.1, 1), record(WELL, 200, 0.1, 2)
    found = fit([one.u, two.u], [one.y, two.y], dt=0.01, method="ls")
    # [ y(t) ] = [ -y(t-1) -y(t-2) u(t-1) u(t-2) ] @ theta, written out here row by row
    rows, target = [], []
    for data in (one, two):
        for t in range(2, len(data.y)):
            rows.append([-data.y[t - 1], -data.y[t - 2], data.u[t - 1], data.u[t - 2]])
            target.append(data.y[t])
    expected, squares, _, _ = np.linalg.lstsq(np.array(rows), np.array(target), rcond=None)
    assert_allclose(found.theta, expected, atol=1e-12)
    assert_allclose(found.fpe, squares[0] / 496 * (1 + 4 / 496) / (1 - 4 / 496), rtol=1e-9)
    joined = fit(np.r_[one.u, two.u], np.r_[one.y, two.y], dt=0.01, method="ls")
    assert not np.allclose(joined.theta, expected, atol=1e-9)


@pytest.mark.parametrize("method", ["ls", "sriv"])
def test_the_order_of_flights_does_not_matter(method: str) -> None:
    one, two = record(WELL, 600, 0.1, 1), record(WELL, 500, 0.1, 2)
    forward = fit([one.u, two.u], [one.y, two.y], dt=0.01, method=method)
    backward = fit([two.u, one.u], [two.y, one.y], dt=0.01, method=method)
    assert_allclose(forward.theta, backward.theta, atol=1e-9)


@pytest.mark.parametrize("method", ["ls", "sriv"])
def test_gain_scales_with_the_units(method: str) -> None:
    data = record(WELL, 2000, 0.1, 4)
    base = fit(data.u, data.y, dt=0.01, method=method)
    scaled = fit(data.u * 1e-3, data.y * 50.0, dt=0.01, method=method)
    assert_allclose(scaled.a, base.a, rtol=1e-8)
    assert_allclose(scaled.b, base.b * 5e4, rtol=1e-8)
    assert scaled.nrmse_fit == pytest.approx(base.nrmse_fit, rel=1e-9)
    assert scaled.yic == pytest.approx(base.yic, rel=1e-6)


def test_default_method_is_sriv_and_lists_are_taken() -> None:
    data = record(WELL, 200, 0.0, 4)
    assert fit(data.u.tolist(), data.y.tolist(), dt=0.01).method is Method.SRIV


def test_model_is_frozen_and_its_arrays_too() -> None:
    model = fit(*(lambda d: (d.u, d.y))(record(WELL, 500, 0.1, 4)), dt=0.01)
    with pytest.raises(FrozenInstanceError):
        model.dt = 1.0  # type: ignore[misc]  # the assignment under test
    for array in (model.a, model.b, model.standard_errors):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 2.0


def test_a_model_does_not_alias_its_arguments() -> None:
    a = np.array([1.0, -0.5])
    model = ArxModel(a, np.array([0.0, 1.0]), 0.01, (1, 1, 1), Method.PUBLISHED)
    a[1] = 3.0
    assert model.a[1] == -0.5


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


def test_poles_and_gain() -> None:
    assert_allclose(WELL.poles, [0.6 + 0.4j, 0.6 - 0.4j], atol=1e-12)
    assert WELL.dc_gain == pytest.approx(0.75 / 0.32)
    assert WELL.stable
    unstable = ArxModel(np.array([1.0, -1.0]), np.array([1.0]), 0.01, (1, 1, 0), Method.PUBLISHED)
    assert not unstable.stable
    assert unstable.dc_gain == np.inf
    delay = ArxModel(np.array([1.0, 0.0, 0.0]), np.array([1.0]), 0.01, (2, 1, 0), Method.PUBLISHED)
    assert_allclose(delay.poles, [0.0, 0.0])


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


def test_prediction_uses_the_measured_past_only() -> None:
    data = record(WELL, 50, 0.3, 6)
    predicted = WELL.predict(data.u, data.y)
    assert predicted.shape == (48,)
    t = 20
    by_hand = 0.5 * data.u[t - 1] + 0.25 * data.u[t - 2] + 1.2 * data.y[t - 1] - 0.52 * data.y[t - 2]
    assert predicted[t - 2] == pytest.approx(by_hand)
    assert_allclose(WELL.predict(data.u, data.clean), data.clean[2:], atol=1e-12)
    with pytest.raises(IdentificationError, match="one length"):
        WELL.predict(data.u[:2], data.y[:2])


def test_simulation_continues_from_a_given_past() -> None:
    data = record(ROLL, 400, 0.0, 7)
    warm = ROLL.simulate(data.u[100:], past_u=data.u[:100], past_y=data.clean[:100])
    assert_allclose(warm, data.clean[100:], atol=1e-10)


def good() -> tuple[FloatArray, FloatArray]:
    data = record(WELL, 400, 0.1, 8)
    return data.u, data.y


def unstable_growth() -> tuple[FloatArray, FloatArray]:
    u = np.random.default_rng(9).standard_normal(300)
    growing = ArxModel(np.array([1.0, -1.02]), np.array([0.0, 1.0]), 0.01, (1, 1, 1), Method.PUBLISHED)
    return u, growing.simulate(u)


@pytest.mark.parametrize("method", ["ls", "sriv"])
def test_bad_data_are_refused_with_one_line(method: str) -> None:
    u, y = good()
    holed = y.copy()
    holed[10] = np.nan
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


def test_an_unstable_result_is_refused() -> None:
    u, y = unstable_growth()
    with pytest.raises(IdentificationError, match="unstable"):
        fit(u, y, (1, 1, 1), dt=0.01, method="ls")


def test_more_parameters_than_the_data_tell_apart_are_refused() -> None:
    data = record(WELL, 400, 0.0, 8)
    with pytest.raises(IdentificationError, match="linearly dependent"):
        fit(data.u, data.y, (3, 3, 1), dt=0.01, method="ls")


@pytest.mark.parametrize("order", [(0, 2, 1), (2, 0, 1), (2, 2, -1), (2, 2), (2.0, 2, 1), (True, 2, 1)])
def test_bad_orders_are_refused(order: tuple[int, int, int]) -> None:
    with pytest.raises(IdentificationError, match="whole numbers"):
        fit(*good(), order, dt=0.01)


def test_bad_method_and_sample_time_are_refused() -> None:
    with pytest.raises(IdentificationError, match="use 'sriv' or 'ls'"):
        fit(*good(), dt=0.01, method="arx")
    with pytest.raises(IdentificationError, match="use 'sriv' or 'ls'"):
        fit(*good(), dt=0.01, method=Method.RLS)
    for dt in (0.0, -1.0, float("nan")):
        with pytest.raises(IdentificationError, match="sample time"):
            fit(*good(), dt=dt)


def test_importing_identify_imports_neither_scipy_nor_control() -> None:
    heavy = "{'scipy', 'control', 'matplotlib', 'numba'}"
    code = f"import sys, mavdiag.identify; sys.exit(bool({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
