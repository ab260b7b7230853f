"""Units by gravity and by the attitude's slope."""

import numpy as np
import pytest

from mavdiag.link.profiles import PROFILES, scale_doubt
from mavdiag.link.scale import gyro_checks
from mavdiag.telemetry import FloatArray, Series, Signal
from mavdiag.units import DEG, NS_PER_S

SECONDS = 30


def turning(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angles and body rates of a vehicle that rolls, pitches and turns its nose; the rates by small differences."""

    def angles(at: FloatArray) -> FloatArray:
        return np.stack((0.3 * np.sin(2 * at), 0.2 * np.sin(3 * at + 1), 0.5 * at + 0.4 * np.sin(at)), axis=1)

    phi, theta, _ = angles(t).T
    dphi, dtheta, dpsi = ((angles(t + 1e-6) - angles(t - 1e-6)) / 2e-6).T
    p = dphi - np.sin(theta) * dpsi
    q = np.cos(phi) * dtheta + np.sin(phi) * np.cos(theta) * dpsi
    return angles(t), np.stack((p, q, np.cos(phi) * np.cos(theta) * dpsi - np.sin(phi) * dtheta), axis=1)


def series(signal: Signal, t_s: FloatArray, values: FloatArray, late_s: float = 0.0) -> Series:
    t_ns = np.round((t_s + late_s) * NS_PER_S).astype(np.int64)
    return Series(signal, t_ns, t_ns, values)


def pair(scale: FloatArray, late_s: float, seed: int = 1) -> tuple[Series, Series]:
    """Gyro at 100 Hz with noise, in other units and stamped late, and the attitude at 25 Hz, wrapped."""
    t, slow = np.arange(0, SECONDS, 0.01), np.arange(0, SECONDS, 0.04)
    noise = np.random.default_rng(seed).normal(0, 0.02, (len(t), 3))
    wrapped = (turning(slow)[0] + np.pi) % (2 * np.pi) - np.pi
    return (
        series(Signal.BODY_RATE, t, (turning(t)[1] + noise) * scale, late_s),
        series(Signal.ATTITUDE, slow, wrapped),
    )


@pytest.mark.parametrize("late_s", [0.0, 0.03, -0.05])
def test_the_attitudes_slope_gives_scale_sign_and_delay_of_the_gyro(late_s: float) -> None:
    gyro, attitude = pair(np.array([1.0, -1.0, 1.0 / DEG]), late_s)
    roll, pitch, yaw = gyro_checks(gyro, attitude)
    assert roll.scale == pytest.approx(1.0, abs=0.03)
    assert pitch.scale == pytest.approx(-1.0, abs=0.03)
    assert yaw.scale == pytest.approx(1.0 / DEG, rel=0.03)
    for one in (roll, pitch, yaw):
        assert one.delay_s == pytest.approx(late_s, abs=0.006)
    assert roll.verdict == "right"
    assert pitch.verdict == "turns the wrong way; scale right"
    assert yaw.verdict == "wrong scale: deg/s"


@pytest.mark.parametrize(
    ("profile", "felt_g", "said"),
    [
        ("qdrone2", 1.0, ""),
        ("qdrone2", 1.3, ""),
        ("qdrone2", 2.05, "2.0 g: --profile spec"),
        ("spec", 0.49, "0.5 g: --profile ardupilot"),
        ("spec", 2.0, "2.0 g"),
        ("px4", 9.8, "9.8 g"),
    ],
)
def test_a_profile_that_gravity_contradicts_is_told_with_the_one_that_fits(
    profile: str, felt_g: float, said: str
) -> None:
    assert scale_doubt(PROFILES[profile], felt_g) == said
