"""Poles, margins and bandwidth against known systems, and their standard errors against repeated experiments."""

import math

import numpy as np
import pytest
from identification_data import WELL, record
from numpy.testing import assert_allclose

from mavdiag.identify import ArxModel, Method, fit
from mavdiag.identify.lab.figures import ModelFigures, model_figures

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
