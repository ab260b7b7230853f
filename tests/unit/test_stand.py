"""The flight stand by physics: the force that turns, its answer, and the way back to g mm."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mavdiag.airframe.balance import unbalance_force_n
from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from sitl_plant.stand import Peak, Propeller, Stand, StandReport, fit_scale, peak_of, stand_run, stand_test

QUIET = Stand(noise_rms_m_s2=0.0, second_m_s2=0.0, wander_rms=0.0)
FREE = replace(QUIET, natural_hz=(1.0, 1.0, 1.0), share=(1.0, 1.0, 1.0))  # far above resonance it is a free mass
SEEDS = range(5)


def peak(stand: Stand, unbalance: float, rpm: float = 5000.0, seed: int = 0) -> Peak:
    accel = stand_run(stand, Propeller("p", unbalance), rpm, np.random.default_rng(seed))
    return peak_of(accel, stand.rate_hz, rpm)


def answer(stand: Stand, axis: int, rpm: float) -> float:
    """|a| per newton of a damped oscillator, from its equation of motion in steady state."""
    w, w_n = 2 * math.pi * rpm / 60, 2 * math.pi * stand.natural_hz[axis]
    return abs(-(w**2) / (stand.mass_kg * (w_n**2 - w**2 + 2j * stand.damping * w_n * w)))


@pytest.mark.parametrize("rpm", [2000.0, 5000.0, 10_000.0])
def test_a_free_mass_feels_the_turning_force(rpm: float) -> None:
    expected = unbalance_force_n(3.77, rpm) / FREE.mass_kg  # m r w^2 / mass
    for amplitude in peak(FREE, 3.77, rpm).amplitude_m_s2:
        assert amplitude == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("rpm", [3000.0, 5000.0, 9000.0])
def test_each_axis_answers_as_an_oscillator(rpm: float) -> None:
    found = peak(QUIET, 5.1, rpm).amplitude_m_s2
    for axis in range(3):
        expected = QUIET.share[axis] * unbalance_force_n(5.1, rpm) * answer(QUIET, axis, rpm)
        assert found[axis] == pytest.approx(expected, rel=0.01), axis


def test_the_equation_of_motion_agrees() -> None:
    """The same force on a mass, spring and damper, integrated in time by scipy."""
    from scipy.integrate import solve_ivp

    w, w_n = 2 * math.pi * 5000 / 60, 2 * math.pi * QUIET.natural_hz[1]
    push = unbalance_force_n(5.1, 5000.0) / QUIET.mass_kg

    def motion(t: float, x: FloatArray) -> list[float]:
        return [x[1], push * math.cos(w * t) - 2 * QUIET.damping * w_n * x[1] - w_n**2 * x[0]]

    t = np.linspace(0.9, 1.0, 2000)  # the start is forgotten
    x, v = solve_ivp(motion, (0.0, 1.0), [0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-12).y
    accel = push * np.cos(w * t) - 2 * QUIET.damping * w_n * v - w_n**2 * x
    assert peak(QUIET, 5.1).amplitude_m_s2[1] == pytest.approx(np.abs(accel).max(), rel=0.01)


@pytest.mark.parametrize("rpm", [2500.0, 5000.0, 5017.0, 11_000.0])
def test_the_peak_lies_at_the_rotation_frequency_and_y_is_the_strongest_axis(rpm: float) -> None:
    for seed in SEEDS:
        found = peak(Stand(), 2.75, rpm, seed)
        assert found.frequency_hz == pytest.approx(rpm / 60, abs=0.2), seed
        x, y, z = found.amplitude_m_s2
        assert y > x > z, seed


def test_83_3_hz_is_5000_rpm() -> None:
    assert peak(Stand(), 5.52).frequency_hz == pytest.approx(83.3, abs=0.1)


def test_acceleration_is_proportional_to_unbalance() -> None:
    amplitudes = np.array([peak(QUIET, unbalance).amplitude_m_s2[1] for unbalance in (0.5, 1.0, 2.0, 4.0)])
    np.testing.assert_allclose(amplitudes / amplitudes[0], [1.0, 2.0, 4.0, 8.0], rtol=1e-6)


def test_unbalances_add_as_vectors() -> None:
    assert Propeller("p", 3.0, (0.0, 4.0)).total_g_mm == pytest.approx(5.0)
    assert Propeller("p", 3.0, (0.0, 4.0), math.pi / 2).total_g_mm == pytest.approx(7.0)
    assert Propeller("p", 3.0, (3.0, 0.0), math.pi).total_g_mm == pytest.approx(0.0, abs=1e-12)


def test_the_scale_is_the_least_squares_one() -> None:
    rng = np.random.default_rng(4)
    A = rng.uniform(0.1, 2.0, 9)
    U = 3.4 * A + 0.05 * rng.standard_normal(9)
    (oracle,), (error,), _, _ = np.linalg.lstsq(A[:, None], U, rcond=None)
    scale = fit_scale(U.tolist(), A.tolist())
    assert scale.g_mm_per_m_s2 == pytest.approx(oracle)
    assert scale.standard_error == pytest.approx(math.sqrt(error / 8 / (A @ A)))
    assert abs(scale.g_mm_per_m_s2 - 3.4) < 4 * scale.standard_error


def test_the_scale_is_what_the_oscillator_says() -> None:
    per_newton = answer(Stand(), 1, 5000.0)
    expected = 1.0 / (unbalance_force_n(1.0, 5000.0) * per_newton)  # g mm per m/s^2
    for seed in SEEDS:
        assert stand_test(seed=seed).scale.g_mm_per_m_s2 == pytest.approx(expected, rel=0.05), seed


@pytest.mark.parametrize("seed", SEEDS)
def test_nine_unbalances_come_back_within_the_propellers_own_residue(seed: int) -> None:
    report = stand_test(seed=seed)
    assert [bar.name for bar in report.bars[:4]] == ["H1", "H2", "H3", "F1/SV1"]
    assert len(report.bars) == 12
    for bar in report.bars:
        # its own residue (up to 0.18 g mm, T Eq 3.6), and the scale's error
        allowed = 0.18 + 4 * report.scale.standard_error * bar.peak.amplitude_m_s2[1] + 0.02
        assert abs(bar.estimated_g_mm - bar.known_g_mm) < allowed, bar


def order(report: StandReport) -> FloatArray:
    return np.array([bar.estimated_g_mm for bar in report.bars])


def test_edge_cuts_and_holes_stand_out_and_the_lightest_crack_does_not() -> None:
    by_name = {bar.name: bar.estimated_g_mm for bar in stand_test().bars}
    healthy = max(by_name[name] for name in ("H1", "H2", "H3"))
    assert min(by_name[f"F{kind}/SV{severity}"] for kind in (1, 3) for severity in (1, 2, 3)) > 5 * healthy
    assert by_name["F2/SV1"] < 3 * healthy


def test_equal_seeds_give_equal_runs() -> None:
    assert stand_test(seed=7) == stand_test(seed=7)
    assert not np.array_equal(order(stand_test(seed=7)), order(stand_test(seed=8)))


def test_nonsense_is_refused() -> None:
    with pytest.raises(UsageError, match="rpm"):
        stand_test(50.0)
    with pytest.raises(UsageError, match="two known"):
        fit_scale([1.0], [1.0])
    with pytest.raises(UsageError, match="two known"):
        fit_scale([1.0, 2.0], [0.0, 0.0])
