"""The recorded QDrone 2's IMUs: filters, hold, aliases, steps and ranges, against scipy and the sampling theorem."""

import numpy as np
import pytest
from plant_cases import nominal_airframe

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.airframe import draw_airframe
from sitl_plant.physics.faults import sensor_condition
from sitl_plant.physics.parameters import specimen_of
from sitl_plant.physics.rotors import RotorState
from sitl_plant.physics.sensors import (
    CHANNELS,
    HARMONICS,
    IMUS,
    TwinImu,
    TwinImuState,
    advance_imus,
    butterworth3,
    high_pass,
)
from sitl_plant.vehicle import vehicle_named

VEHICLE = vehicle_named("qdrone2-recorded")
LSB = 1.3316e-4  # DronePropA, from published samples: 250 deg/s over 2^15
RANGE = 4.363


def plain() -> TwinImu:
    """Both IMUs without vibration, noise or bias."""
    filters = np.array([butterworth3(125.0, 0.001)] * 3 + [butterworth3(400.0, 0.001)] * 3)
    nothing = np.zeros((IMUS, CHANNELS))
    line = np.zeros((IMUS, CHANNELS, HARMONICS, 4, 2))
    span, lsb = np.repeat([4.3633231, 156.9064], 3), np.repeat([LSB, 0.0047884], 3)
    shape = high_pass(40.0, 0.001)
    return TwinImu(np.zeros((IMUS, 3)), nothing, nothing, nothing, line, 942.0, shape, filters, span, lsb, 2)


def read(truth: FloatArray) -> FloatArray:
    """Readings (n, 2, 6) while both IMUs feel truth (n,) on every channel."""
    shapes = (IMUS, CHANNELS, 2), (IMUS, CHANNELS, 3), (CHANNELS,), (IMUS, CHANNELS), (HARMONICS, 4, 2)
    state = TwinImuState(*(np.zeros(shape) for shape in shapes))
    still, imu, healthy = RotorState(*(np.zeros(4) for _ in range(5))), plain(), sensor_condition(())
    out, normals = np.empty((len(truth), IMUS, CHANNELS)), np.zeros((1, 24))
    for step, value in enumerate(truth):
        felt = np.full((IMUS, CHANNELS), value)
        advance_imus(state, imu, healthy, felt, still, normals, 0, step, 0.001)
        out[step] = state.reading
    return out


def tone(frequency_hz: float, amplitude: float = 0.5) -> FloatArray:
    return np.asarray(amplitude * np.sin(2 * np.pi * frequency_hz * np.arange(4000) / 1000 + 0.4))


def lines(signal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frequencies and amplitudes, of whole 1 Hz bins, from the last 1 s."""
    return np.arange(501.0), np.abs(np.fft.rfft(signal[-1000:])) / 500


@pytest.mark.parametrize("corner", [40.0, 125.0, 400.0])
def test_filters_are_those_of_scipy(corner: float) -> None:
    from scipy.signal import butter

    b, a, b0, b1, b2, a1, a2 = butterworth3(corner, 0.001)
    numerator, denominator = butter(3, corner, fs=1000.0)
    np.testing.assert_allclose(np.polymul([b, b], [b0, b1, b2]), numerator, atol=1e-12)
    np.testing.assert_allclose(np.polymul([1.0, a], [1.0, a1, a2]), denominator, atol=1e-12)
    numerator, denominator = butter(2, corner, "highpass", fs=1000.0)
    np.testing.assert_allclose([*high_pass(corner, 0.001)], [*numerator, *denominator[1:]], atol=1e-12)


def test_the_gyro_has_the_steps_and_the_range_of_the_recordings() -> None:
    out = read(tone(3.0, 6.0))
    counts = out[:, :, :3] / LSB
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    assert np.abs(out[:, :, :3]).max() == pytest.approx(RANGE, abs=1e-3)
    assert np.abs(out[:, :, 3:]).max() > 5.9
    steps = out[:, :, 3:] / 0.0047884
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)


def test_the_gyro_is_held_for_two_steps_and_the_accelerometer_is_not() -> None:
    out = read(tone(21.0))
    np.testing.assert_array_equal(out[0::2, :, :3], out[1::2, :, :3])
    assert np.mean(out[0::2, 0, 3] == out[1::2, 0, 3]) < 0.05


def test_150_hz_is_halved_by_the_filter_and_the_hold_mirrors_it_to_350_hz() -> None:
    """1 / sqrt(1 + (150/125)^6) = .50 of an analogue filter; a hold over 2 ms leaves cos(pi f T) and its image sin."""
    _, amplitude = lines(read(tone(150.0, 1.0))[:, 0, 0])
    assert amplitude[150] == pytest.approx(0.5 * np.cos(np.pi * 0.15), rel=0.12)  # bilinear: a little less
    assert amplitude[350] / amplitude[150] == pytest.approx(np.tan(np.pi * 0.15), rel=1e-2)


def test_300_hz_comes_out_of_the_gyro_at_200_hz() -> None:
    """500 samples a second: 500 - 300 = 200."""
    _, amplitude = lines(read(tone(300.0, 2.0))[:, 0, 0])
    assert 100 + int(amplitude[100:251].argmax()) == 200


def test_specimens_are_the_measured_ones_or_drawn_between_them() -> None:
    recorded = VEHICLE.recorded
    assert recorded is not None
    rng = np.random.default_rng(31)
    drawn = [draw_airframe(VEHICLE, aged=False, rng=rng) for _ in range(60)]
    levels = np.array([specimen_of(one, recorded).gyro_line for one in drawn])
    assert levels.min() >= 0.0144
    assert levels.max() <= 0.0326
    assert levels.max() / levels.min() > 2.0
    assert specimen_of(drawn[7], recorded) == specimen_of(drawn[7], recorded)
    known = [one.name for one in recorded.specimens]
    assert known == ["drone 1", "drone 2", "drone 3"]
    assert specimen_of(nominal_airframe(VEHICLE), recorded).name == "nominal"
