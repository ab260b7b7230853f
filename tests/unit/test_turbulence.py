"""Dryden turbulence against its published spectra, autocorrelations and rms, and how it reaches the vehicle."""

import math

import numpy as np
import pytest
from plant_cases import fly, quiet_airframe
from scipy.signal import welch

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.air import Turbulence, dryden
from sitl_plant.plant import PlantConfig

STEP_S = 0.02
MODEL = dryden(5.0, 1.0)


@pytest.fixture(scope="module")
def gusts() -> FloatArray:
    """Three hours, with the wind to the north: u, v, w."""
    return Turbulence(MODEL, 0.0, STEP_S, np.random.default_rng(3)).draw(round(3 * 3600 / STEP_S))


def published(omega: FloatArray, axis: int) -> FloatArray:
    """MIL-F-8785C 3.7.1.2, over angular frequency, one-sided [(m/s)^2 / (rad/s)]."""
    rms, T = MODEL.rms_m_s[axis], MODEL.passing_s[axis]
    x = (T * omega) ** 2
    if axis == 0:
        return np.asarray(rms**2 * 2 * T / math.pi / (1 + x))
    return np.asarray(rms**2 * T / math.pi * (1 + 3 * x) / (1 + x) ** 2)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_spectra_are_those_published(gusts: FloatArray, axis: int) -> None:
    hz, density = welch(gusts[:, axis], 1 / STEP_S, nperseg=8192)
    for low in (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2):
        band = (hz >= low) & (hz < 2 * low)
        expected = 2 * math.pi * published(2 * math.pi * hz[band], axis)
        assert density[band].mean() == pytest.approx(expected.mean(), rel=0.1), low


@pytest.mark.parametrize("w20", [5.0, 8.0])
def test_a_vehicle_in_turbulence_holds_its_place_and_feels_the_drag_of_the_gusts(w20: float) -> None:
    """At rest on average, the specific force of the horizontal axes is drag / mass = 0.25 u / 1.504."""
    config = PlantConfig(trajectory="hover", airframe=quiet_airframe(), turbulence_m_s=w20, seed=4)
    samples = fly(config, 120.0)
    assert np.abs(samples.position[:, :2]).max() < 0.3
    felt = samples.accel[:, :2].std()
    assert felt == pytest.approx(0.25 / 1.504 * dryden(w20, 1.0).rms_m_s[0], rel=0.3)
