"""The flight stand by physics: the force that turns, its answer, and the way back to g mm."""

import math

import numpy as np
import pytest

from mavdiag.airframe.balance import unbalance_force_n
from mavdiag.errors import UsageError
from sitl_plant.stand import Peak, Stand, fit_scale, peak_of, stand_run, stand_test

QUIET = Stand(noise_rms_m_s2=0.0, second_m_s2=0.0, wander_rms=0.0)
SEEDS = range(5)


def peak(stand: Stand, unbalance: float, rpm: float = 5000.0, seed: int = 0) -> Peak:
    accel = stand_run(stand, unbalance, rpm, np.random.default_rng(seed))
    return peak_of(accel, stand.rate_hz, rpm)


def answer(stand: Stand, axis: int, rpm: float) -> float:
    """|a| per newton of a damped oscillator, from its equation of motion in steady state."""
    w, w_n = 2 * math.pi * rpm / 60, 2 * math.pi * stand.natural_hz[axis]
    return abs(-(w**2) / (stand.mass_kg * (w_n**2 - w**2 + 2j * stand.damping * w_n * w)))


@pytest.mark.parametrize("rpm", [3000.0, 5000.0, 9000.0])
def test_each_axis_answers_as_an_oscillator(rpm: float) -> None:
    found = peak(QUIET, 5.1, rpm).amplitude_m_s2
    for axis in range(3):
        expected = QUIET.share[axis] * unbalance_force_n(5.1, rpm) * answer(QUIET, axis, rpm)
        assert found[axis] == pytest.approx(expected, rel=0.01), axis


@pytest.mark.parametrize("rpm", [2500.0, 5000.0, 5017.0, 11_000.0])
def test_the_peak_lies_at_the_rotation_frequency_and_y_is_the_strongest_axis(rpm: float) -> None:
    for seed in SEEDS:
        found = peak(Stand(), 2.75, rpm, seed)
        assert found.frequency_hz == pytest.approx(rpm / 60, abs=0.2), seed
        x, y, z = found.amplitude_m_s2
        assert y > x > z, seed


def test_the_scale_is_the_least_squares_one() -> None:
    rng = np.random.default_rng(4)
    A = rng.uniform(0.1, 2.0, 9)
    U = 3.4 * A + 0.05 * rng.standard_normal(9)
    (oracle,), (error,), _, _ = np.linalg.lstsq(A[:, None], U, rcond=None)
    scale = fit_scale(U.tolist(), A.tolist())
    assert scale.g_mm_per_m_s2 == pytest.approx(oracle)
    assert scale.standard_error == pytest.approx(math.sqrt(error / 8 / (A @ A)))
    assert abs(scale.g_mm_per_m_s2 - 3.4) < 4 * scale.standard_error


@pytest.mark.parametrize("seed", SEEDS)
def test_nine_unbalances_come_back_within_the_propellers_own_residue(seed: int) -> None:
    report = stand_test(seed=seed)
    assert [bar.name for bar in report.bars[:4]] == ["H1", "H2", "H3", "F1/SV1"]
    assert len(report.bars) == 12
    for bar in report.bars:
        # its own residue (up to 0.18 g mm, T Eq 3.6), and the scale's error
        allowed = 0.18 + 4 * report.scale.standard_error * bar.peak.amplitude_m_s2[1] + 0.02
        assert abs(bar.estimated_g_mm - bar.known_g_mm) < allowed, bar


def test_equal_seeds_give_equal_runs() -> None:
    assert stand_test(seed=7) == stand_test(seed=7)
    assert stand_test(seed=7) != stand_test(seed=8)


def test_nonsense_is_refused() -> None:
    with pytest.raises(UsageError, match="rpm"):
        stand_test(50.0)
    with pytest.raises(UsageError, match="two known"):
        fit_scale([1.0], [1.0])
    with pytest.raises(UsageError, match="two known"):
        fit_scale([1.0, 2.0], [0.0, 0.0])
