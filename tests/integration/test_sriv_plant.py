"""Under gyro noise SRIV identifies the emulated aircraft, least squares does not (T 4.4: 2 and 3 train, 1 judges)."""

import numpy as np
import pytest

from mavdiag.identify import fit
from mavdiag.identify.lab.comparison import THESIS_PITCH, THESIS_ROLL, ReferenceModel
from mavdiag.identify.validate import r_squared, validate
from mavdiag.rows.savgol import coefficients
from mavdiag.telemetry import FloatArray
from sitl_plant.plant import Plant, PlantConfig, PlantSamples

DT_S = 0.001
WINDOW = 101


@pytest.fixture(scope="module")
def flights() -> dict[int, PlantSamples]:
    return {drone: Plant(PlantConfig(drone=drone, seed=drone)).advance(33_000) for drone in (1, 2, 3)}


def rates(flight: PlantSamples, noise: float, seed: int, column: int = 0) -> tuple[FloatArray, FloatArray]:
    """u and y behind the window [rad/s], the first 3 s left out."""
    gyro = flight.gyro[3000:, column] + noise * np.random.default_rng(seed).standard_normal(30_000)
    value, slope, _ = coefficients(WINDOW)
    return np.correlate(flight.setpoint[3000:, column], slope / DT_S, "valid"), np.correlate(gyro, value, "valid")


@pytest.mark.parametrize("noise", [0.05, 0.1, 0.2])
def test_sriv_holds_where_least_squares_fails(flights: dict[int, PlantSamples], noise: float) -> None:
    (u2, y2), (u3, y3), (u1, y1) = (rates(flights[drone], noise, drone) for drone in (2, 3, 1))
    refined, plain = (fit([u2, u3], [y2, y3], dt=DT_S, method=method) for method in ("sriv", "ls"))
    assert refined.converged
    assert validate(refined, u1, y1).r2t >= 0.98
    assert validate(plain, u1, y1).r2t < 0.85


def test_noise_moves_sriv_only_by_its_standard_errors(flights: dict[int, PlantSamples]) -> None:
    quiet = fit(*rates(flights[2], 0.0, 0), dt=DT_S)
    for seed in range(3):
        noisy = fit(*rates(flights[2], 0.2, seed), dt=DT_S)
        assert np.all(np.abs(noisy.theta - quiet.theta) < 4 * noisy.standard_errors)
        assert noisy.dc_gain == pytest.approx(quiet.dc_gain, abs=0.05)


@pytest.mark.parametrize(("reference", "r2t"), [(THESIS_ROLL, 0.55), (THESIS_PITCH, 0.85)])
def test_the_printed_models_need_their_input_scale(
    flights: dict[int, PlantSamples], reference: ReferenceModel, r2t: float
) -> None:
    u, y = rates(flights[2], 0.0, 0, reference.axis.column)
    assert r_squared(y, reference.scaled.simulate(u)) == pytest.approx(r2t, abs=0.06)
    assert r_squared(y, reference.model.simulate(u)) < -1000
