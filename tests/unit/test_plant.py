"""Whole flights: reproducible bits, balances that can be done on paper, and the signals the detector lives on."""

import hashlib
import math
from dataclasses import fields, replace
from typing import Literal

import numpy as np
import pytest
from plant_cases import fly, quiet_airframe

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from sitl_plant.physics.airframe import Payload, PickUp
from sitl_plant.physics.faults import Injection, RotorDamage, SensorFault
from sitl_plant.plant import Plant, PlantConfig, PlantSamples
from sitl_plant.vehicle import vehicle_named

G = 9.81
MASS = 1.504


def digest(parts: list[PlantSamples]) -> str:
    """SHA-256 of every bit of a flight."""
    whole = hashlib.sha256()
    for field in fields(PlantSamples):
        whole.update(np.concatenate([getattr(part, field.name) for part in parts]).tobytes())
    return whole.hexdigest()


BUSY = PlantConfig(
    drone=1,
    fault="F2/SV2",
    rotor=3,
    onset_s=1.2345,
    wind_m_s=1.0,
    payload=Payload(0.1),
    turbulence_m_s=8.0,
    outages_per_min=20.0,
    pickup=PickUp(Payload(0.2, (0.012, -0.016, 0.05)), 0.9, 1.4),
    injections=(Injection(SensorFault("gyro", 0, offset=0.1), onset_s=0.5, end_s=0.7),),
    seed=5,
)
RECORDED = PlantConfig(
    vehicle=vehicle_named("qdrone2-recorded"), trajectory="t5-sp1", fault="F2/SV2", onset_s=1.2, seed=79, start="ground"
)


@pytest.mark.parametrize("cuts", [(2000,), (1, 3, 996, 0, 7, 993), (500,) * 4, (499, 1, 734, 1, 1, 764)])
@pytest.mark.parametrize("config", [BUSY, RECORDED], ids=["busy", "recorded"])
def test_flight_does_not_depend_on_how_it_is_cut(config: PlantConfig, cuts: tuple[int, ...]) -> None:
    plant = Plant(config)
    assert digest([plant.advance(n) for n in cuts]) == digest([Plant(config).advance(2000)])


def test_hover_takes_ten_thousand_rpm() -> None:
    """T 3.2.2: about 10,000 rpm. Thrust equals weight: 4 K_F w^2 = m g."""
    samples = fly(PlantConfig(trajectory="hover", airframe=quiet_airframe()), 2.0)
    speed = samples.rotor_speed[-500:].mean()
    assert speed * 60 / (2 * math.pi) == pytest.approx(10_000, rel=0.002)
    assert 4 * 3.364e-6 * speed**2 == pytest.approx(MASS * G, rel=1e-4)


def test_square_excites_roll_and_pitch_like_the_thesis_flight() -> None:
    """T 5.2 and Fig 5.4: sharp spikes at the corners; about 0.22 rad commanded and 1.3 rad/s reached."""
    samples = fly(PlantConfig(drone=2), 16.0)
    for axis in (0, 1):
        assert 0.17 < np.abs(samples.setpoint[:, axis]).max() < 0.28
        assert 1.1 < np.abs(samples.gyro[:, axis]).max() < 1.6
    assert np.ptp(samples.position[:, 0]) == pytest.approx(1.15, abs=0.2)
    assert np.abs(samples.position[:, 2] + 1.0).max() < 0.05


def amplitude(signal: FloatArray, frequency_hz: float) -> float:
    """Amplitude of the line nearest to a frequency, by a flat-top windowed FFT."""
    from scipy.signal import get_window

    window = get_window("flattop", len(signal))
    spectrum = np.abs(np.fft.rfft((signal - signal.mean()) * window)) * 2 / window.sum()
    centre = round(frequency_hz * len(signal) / 1000)
    return float(spectrum[centre - 4 : centre + 5].max())


def test_unbalance_line_has_the_amplitude_of_its_force() -> None:
    """|a| = U w^2 / m at one per revolution, through the 250 Hz filter, plus alpha × r of the lever arm."""
    from scipy.signal import butter, freqz

    U = 3.0e-6
    config = PlantConfig(
        trajectory="hover",
        airframe=quiet_airframe(),
        injections=(Injection(RotorDamage(unbalance_g_mm=3.0), rotor=1, angle_rad=0.3),),
    )
    samples = fly(config, 4.0)
    w = samples.rotor_speed[:, 0].mean()
    line_hz = w / (2 * math.pi)
    assert line_hz == pytest.approx(166.7, abs=1.0)
    _, response = freqz(*butter(2, 250.0, fs=1000.0), worN=[line_hz], fs=1000.0)
    gain = abs(response[0])
    # f = U w^2 (cos, sin). Yaw: I_z alpha = x f_y - y f_x, hub (-0.1016, 0.127). IMU at (10, 5) mm.
    force, hub, place = U * w * w, (-0.1016, 0.127), (0.010, 0.005)
    alpha = np.array([-hub[1], hub[0]]) * force / 0.0182  # coefficients of cos and sin
    a_x = np.array([force / MASS, 0.0]) - alpha * place[1]
    a_y = np.array([0.0, force / MASS]) + alpha * place[0]
    assert amplitude(samples.accel[:, 0], line_hz) == pytest.approx(gain * np.linalg.norm(a_x), rel=0.02)
    assert amplitude(samples.accel[:, 1], line_hz) == pytest.approx(gain * np.linalg.norm(a_y), rel=0.02)
    assert amplitude(samples.gyro[:, 2], line_hz) == pytest.approx(gain * np.linalg.norm(alpha) / w, rel=0.02)


@pytest.mark.parametrize("start", ["hover", "ground"])
@pytest.mark.parametrize("cuts", [(6000,), (1, 3, 996, 0, 4993, 7)])
def test_driving_with_the_duties_of_a_flight_flies_it_again(
    start: Literal["hover", "ground"], cuts: tuple[int, ...]
) -> None:
    """The cascade is one client of the open loop: the same commands give the same bits."""
    config = replace(BUSY, start=start, onset_s=4.5)
    flown, plant, first = fly(config, 6.0), Plant(config), 0
    for n in cuts:
        driven = plant.drive(flown.duty[first : first + n], n)
        for name in ("t_ns", "gyro", "accel", "attitude", "duty", "battery_v", "quaternion", "position", "rotor_speed"):
            np.testing.assert_array_equal(getattr(driven, name), getattr(flown, name)[first : first + n], err_msg=name)
        assert np.isnan(driven.setpoint).all()
        assert np.isnan(driven.thrust_setpoint).all()
        first += n


@pytest.mark.parametrize(
    ("commands", "steps"),
    [(np.zeros(3), 5), (np.zeros((4, 4)), 5), (np.full(4, 1.1), 5), (np.full(4, np.nan), 5), (np.zeros(4), -1)],
)
def test_commands_that_no_motor_can_follow_are_refused(commands: FloatArray, steps: int) -> None:
    with pytest.raises(UsageError):
        Plant(PlantConfig()).drive(commands, steps)


def test_a_vehicle_rests_on_the_ground() -> None:
    """Specific force -g, and nothing moves for 10 s; with a specimen's sensors the same but for their noise."""
    samples = Plant(PlantConfig(start="ground", airframe=quiet_airframe())).drive(np.zeros(4), 10_000)
    np.testing.assert_allclose(samples.accel, np.broadcast_to([0.0, 0.0, -G], (10_000, 3)), atol=1e-9)
    assert np.abs(samples.position - samples.position[0]).max() < 1e-12
    assert np.abs(samples.omega).max() < 1e-12
    assert samples.motors.max() == 0
    aged = Plant(PlantConfig(start="ground", drone=1, payload=Payload(0.2))).drive(np.zeros(4), 10_000)
    np.testing.assert_allclose(aged.accel.mean(axis=0), [0.0, 0.0, -G], atol=0.02)
    assert np.abs(aged.position - aged.position[0]).max() < 1e-6


@pytest.mark.parametrize(
    "config", [{}, {"drone": 2, "wind_m_s": 2.0, "nose": "path"}, {"nose": "spin", "trajectory": "circle"}]
)
def test_a_flight_from_the_ground_takes_off_flies_and_lands(config: dict[str, str | int | float]) -> None:
    samples = fly(PlantConfig(start="ground", landed_s=26.8, **config), 30.0)  # type: ignore[arg-type]  # as above
    height, motors = -samples.position[:, 2], samples.motors
    changes = motors[np.flatnonzero(np.diff(motors)) + 1]
    assert [int(motors[0]), *changes.tolist()] == [0, 1, 2, 1, 0]
    assert np.abs(height[motors < 2]).max() < 0.01
    assert height[9000:20_000] == pytest.approx(1.0, abs=0.06)
    assert samples.thrust_setpoint[motors == 0].max() == 0.0
    assert 0.0 < samples.thrust_setpoint[motors == 1].max() < 0.01
    np.testing.assert_array_equal(samples.duty[motors == 1], 0.08)
    assert samples.rotor_speed[-1].max() < 1.0
    assert np.abs(samples.attitude[:, :2]).max() < 0.3


@pytest.mark.parametrize(
    ("config", "said"),
    [
        ({"trajectory": "spiral"}, "square"),
        ({"drone": 7}, "drone must be"),
        ({"fault": "F9/SV1"}, "F2/SV2"),
        ({"fault": "F1/SV1", "rotor": 5}, "rotor must be 1 to 4"),
        ({"fault": "F1/SV1", "phenomenology": 2.0}, "phenomenology"),
        ({"speed_m_s": -1.0}, "speed_m_s"),
        ({"size_m": math.nan}, "size_m"),
        ({"wind_m_s": math.inf}, "wind_m_s"),
        ({"onset_s": math.nan, "fault": "F1/SV1"}, "onset_s"),
        ({"seed": -1}, "seed"),
        ({"nose": "up"}, "nose"),
        ({"start": "ground", "landed_s": 14.0}, "needs 14.7 s"),
        ({"start": "ground", "altitude_m": -1.0}, "altitude_m"),
    ],
)
def test_impossible_flights_are_refused_in_one_line(config: dict[str, str | int | float], said: str) -> None:
    with pytest.raises(UsageError, match=said) as caught:
        Plant(PlantConfig(**config))  # type: ignore[arg-type]  # the table mixes the types of several fields
    assert "\n" not in str(caught.value)
