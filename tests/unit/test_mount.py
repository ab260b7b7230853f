"""The IMU's mount against scipy's bilinear transform, and what it does to the rotors' line in flight."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plant_cases import fly
from scipy.signal import bilinear, freqz, lfilter, periodogram

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from sitl_plant.physics.sensors import RIGID_MOUNT, YAW_RATE, advance_mount, gain_of, isolating_hz, mode
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import SoftMount, qdrone2

DT = 0.001


@pytest.mark.parametrize(("hz", "damping"), [(25.0, 0.1), (50.0, 0.1), (165.0, 0.05), (300.0, 1.2)])
def test_the_filter_is_the_bilinear_transform_of_a_driven_mode(hz: float, damping: float) -> None:
    warped = 2 / DT * math.tan(math.pi * hz * DT)
    b, a = bilinear([2 * damping * warped, warped**2], [1, 2 * damping * warped, warped**2], 1 / DT)
    b0, b1, b2, a1, a2 = mode(hz, damping, DT).filter
    np.testing.assert_allclose([b0, b1, b2], b, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose([1.0, a1, a2], a, rtol=1e-9)
    _, (still, line) = freqz(b, a, [0.0, hz], fs=1 / DT)
    assert abs(still) == pytest.approx(1.0)  # slow motion passes
    assert abs(line) == pytest.approx(math.sqrt(1 + 1 / (2 * damping) ** 2))  # Den Hartog, Mechanical Vibrations, 2.12
    assert gain_of(mode(hz, damping, DT).filter, hz, DT) == pytest.approx(abs(line))


@pytest.mark.parametrize("share", [1 / 10, 1 / 30])
def test_an_isolator_passes_the_share_that_was_asked_for(share: float) -> None:
    found = isolating_hz(167.0, share, 0.1, DT)
    assert found < 167.0 / math.sqrt(2)
    assert gain_of(mode(found, 0.1, DT).filter, 167.0, DT) == pytest.approx(share)


def test_all_axes_but_yaw_pass_the_mount() -> None:
    mount, memory = mode(50.0, 0.1, DT), np.zeros((6, 2))
    given = np.random.default_rng(2).standard_normal((400, 6))
    felt = given.copy()
    for row in felt:
        advance_mount(memory, mount, row)
    b0, b1, b2, a1, a2 = mount.filter
    expected = lfilter([b0, b1, b2], [1.0, a1, a2], given, axis=0)
    expected[:, YAW_RATE] = given[:, YAW_RATE]
    np.testing.assert_allclose(felt, expected, atol=1e-12)
    advance_mount(memory, RIGID_MOUNT, felt[0])
    np.testing.assert_allclose(felt[0], expected[0])


def line(samples_accel: FloatArray) -> float:
    """Power of the lateral acceleration from 150 to 185 Hz."""
    hz, power = periodogram(samples_accel[:, :2], 1 / DT, axis=0)
    return float(power[(hz > 150) & (hz < 185)].sum())


@pytest.mark.parametrize(("mount", "low", "high"), [(1 / 10, 0.09, 0.13), (1 / 30, 0.025, 0.05), (None, 4.0, 10.05)])
def test_the_rotors_line_is_weaker_behind_an_isolator_and_stronger_at_a_resonance(
    mount: float | None, low: float, high: float
) -> None:
    """The line is not one frequency: four rotors within some hertz of 167."""
    soft = SoftMount(165.0, 0.05) if mount is None else SoftMount(isolating_hz(167.0, mount, 0.1, DT), 0.1)
    vehicle = qdrone2()
    quiet = replace(vehicle, imu=replace(vehicle.imu, accel_noise_density=0.0))
    hover = PlantConfig(drone=1, trajectory="hover", seed=2)
    rigid, mounted = (
        fly(replace(hover, vehicle=one), 10.0) for one in (quiet, replace(quiet, imu=replace(quiet.imu, mount=soft)))
    )
    ratio = math.sqrt(line(mounted.accel) / line(rigid.accel))
    assert low < ratio < high
    assert np.abs(mounted.gyro).max() < 0.2  # the loops stay stable
    assert mounted.accel[:, 2].mean() == pytest.approx(rigid.accel[:, 2].mean(), abs=0.01)


def test_a_mode_that_the_sample_rate_cannot_carry_is_refused() -> None:
    with pytest.raises(UsageError, match="resonance of 0 to 450 Hz"):
        mode(480.0, 0.1, DT)
