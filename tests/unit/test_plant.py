"""Vehicle files and whole flights: sources, reproducible bits, and balances that can be done on paper."""

import hashlib
import io
import json
import math
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from plant_cases import fly, nominal_airframe, quaternion_rotation, quiet_airframe
from scipy.signal import butter, freqz, get_window
from scipy.stats import kstest, uniform

from mavdiag.errors import InputError, UsageError
from mavdiag.telemetry import FloatArray
from sitl_plant import vehicle as vehicle_module
from sitl_plant.physics.airframe import Payload, drone, with_propellers
from sitl_plant.physics.faults import Injection, RotorDamage, SensorFault, fault_injection
from sitl_plant.physics.parameters import body_with_payload, initial_state, make_model, reload
from sitl_plant.physics.trajectory import Shape, path
from sitl_plant.plant import Plant, PlantConfig, PlantSamples
from sitl_plant.truth import Truth
from sitl_plant.vehicle import load_vehicle, qdrone2, shipped_vehicles, vehicle_from, vehicle_named

G = 9.81
MASS = 1.504
HOVER = PlantConfig(trajectory="hover", seed=4)
DRONE = drone(qdrone2(), 2)
BESIDE = Payload(0.2, (0.012, -0.016, 0.05))  # 200 g, 20 mm beside the centre
SOURCE = (Path(vehicle_module.__file__).parent / "qdrone2.toml").read_text(encoding="utf-8")


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
    pickup=Payload(0.2, (0.012, -0.016, 0.05)),
    pickup_s=(0.9, 1.4),
    injections=(Injection(SensorFault("gyro", 0, offset=0.1), onset_s=0.5),),
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
    speed = fly(PlantConfig(trajectory="hover", airframe=quiet_airframe()), 2.0).rotor_speed[-500:].mean()
    assert speed * 60 / (2 * math.pi) == pytest.approx(10_000, rel=0.002)
    assert 4 * 3.364e-6 * speed**2 == pytest.approx(MASS * G, rel=1e-4)


def amplitude(signal: FloatArray, frequency_hz: float) -> float:
    """Amplitude of the line nearest to a frequency, by a flat-top windowed FFT."""
    window = get_window("flattop", len(signal))
    spectrum = np.abs(np.fft.rfft((signal - signal.mean()) * window)) * 2 / window.sum()
    centre = round(frequency_hz * len(signal) / 1000)
    return float(spectrum[centre - 4 : centre + 5].max())


def test_unbalance_line_has_the_amplitude_of_its_force() -> None:
    """|a| = U w^2 / m at one per revolution, through the 250 Hz filter, plus alpha × r of the lever arm."""
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
    a_x, a_y = np.array([force / MASS, 0.0]) - alpha * place[1], np.array([0.0, force / MASS]) + alpha * place[0]
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
    assert [int(motors[0]), *motors[np.flatnonzero(np.diff(motors)) + 1].tolist()] == [0, 1, 2, 1, 0]
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
        ({"fault": "F1/SV1", "phenomenology": 2.0}, "phenomenology"),
        ({"speed_m_s": -1.0}, "speed_m_s"),
        ({"size_m": math.nan}, "size_m"),
        ({"onset_s": math.nan, "fault": "F1/SV1"}, "onset_s"),
        ({"seed": -1}, "seed"),
        ({"start": "ground", "landed_s": 14.0}, "needs 14.7 s"),
        ({"start": "ground", "altitude_m": -1.0}, "altitude_m"),
    ],
)
def test_impossible_flights_are_refused_in_one_line(config: dict[str, str | int | float], said: str) -> None:
    with pytest.raises(UsageError, match=said) as caught:
        Plant(PlantConfig(**config))  # type: ignore[arg-type]  # the table mixes the types of several fields
    assert "\n" not in str(caught.value)


# What is changed in flight: causes, wind, battery; and what the truth file says of it
def test_injected_in_flight_is_as_configured_before_it() -> None:
    cause = Injection(RotorDamage(0.9, 1.2), rotor=2, onset_s=0.5, angle_rad=1.0)
    configured, plant = Plant(PlantConfig(trajectory="hover", seed=4, injections=(cause,))).advance(800), Plant(HOVER)
    before = plant.advance(500)
    plant.inject(cause)
    np.testing.assert_array_equal(np.vstack([before.gyro, plant.advance(300).gyro]), configured.gyro)


@pytest.mark.parametrize("name", ["qdrone2", "qdrone2-recorded"])
def test_cleared_is_healthy_again(name: str) -> None:
    """A hover with one rotor at 0.85 takes a higher duty there; cleared, all are alike again, and the gyro too."""
    vehicle = vehicle_named(name)
    plant = Plant(PlantConfig(trajectory="hover", vehicle=vehicle, fault="F1/SV1", rotor=4, seed=1))
    plant.inject(Injection(RotorDamage(0.85), rotor=2))
    plant.inject(Injection(SensorFault("gyro", 2, drift_per_s=0.002)))
    weak = plant.advance(6000).duty[-2000:].mean(axis=0)
    plant.clear()
    whole = plant.advance(8000)
    healthy = Plant(PlantConfig(trajectory="hover", vehicle=vehicle, seed=1)).advance(8000)
    duty = healthy.duty[-2000:].mean(axis=0)
    assert weak[1] / duty[1] > 1.05
    np.testing.assert_allclose(whole.duty[-2000:].mean(axis=0), duty, rtol=0.01)
    assert whole.gyro[-2000:, 2].mean() == pytest.approx(healthy.gyro[-2000:, 2].mean(), abs=0.005)


def test_the_truth_has_every_change_with_its_time() -> None:
    plant = Plant(PlantConfig(trajectory="hover", airframe=drone(vehicle_named("qdrone2"), 2), seed=4))
    file = io.StringIO()
    truth = Truth(plant.config, "qdrone2", 1000.0, 10**18, file)
    plant.advance(500)
    plant.inject(fault_injection("F2/SV2", 3, onset_s=0.75))
    plant.inject(Injection(SensorFault("accel", 1, offset=0.2)))
    truth.write(plant.advance(600), plant.take_changes())
    plant.clear()
    truth.write(plant.advance(1000), plant.take_changes())
    found = [json.loads(line) for line in file.getvalue().splitlines()[1:]]  # without that of the flight
    told = [(one["record"], one["t_s"], one.get("fault"), one.get("rotor")) for one in found]
    assert told == [
        ("onset", 0.5, None, None),
        ("onset", 0.75, "F2/SV2", 3),
        ("state", 1.0, None, None),
        ("clear", 1.1, None, None),
        ("state", 2.0, None, None),
    ]
    assert [one["fault_present"] for one in found if one["record"] == "state"] == [True, False]
    assert found[0]["cause"]["sensor"] == "accel"
    assert found[1]["unix_ns"] == 10**18 + 750_000_000


# One specimen: sessions, propellers, wear; a payload taken up and dropped in flight
@pytest.mark.parametrize("spread", [0.01, 0.03])
def test_a_new_set_of_propellers_differs_uniformly_and_is_balanced_as_permitted(spread: float) -> None:
    rng = np.random.default_rng(1)
    sets = [with_propellers(DRONE, spread, rng) for _ in range(300)]
    ratio = np.array([one.thrust_coefficient_n_s2 / DRONE.thrust_coefficient_n_s2 for one in sets]).ravel()
    assert kstest(ratio, uniform(1 - spread, 2 * spread).cdf).pvalue > 0.01
    size = np.array([np.hypot(*one.unbalance_g_mm.T) for one in sets]).ravel()
    assert kstest(size, uniform(0.0, 0.18).cdf).pvalue > 0.01
    assert (sets[0].battery_gain, sets[0].centre_of_gravity_m[0]) == (DRONE.battery_gain, DRONE.centre_of_gravity_m[0])


@pytest.mark.parametrize("seed", range(3))
def test_a_vehicle_without_cameras_stays_in_its_hall(seed: int) -> None:
    """It coasts level at up to 0.5 m/s for up to 2 s, and comes back: no fly-away, no fall."""
    samples = fly(PlantConfig(drone=1 + seed % 3, seed=100 + seed, outages_per_min=3.0), 40.0)
    assert np.abs(samples.position[:, :2] - 0.5).max() < 3.0
    assert samples.position[:, 2].max() < -0.5
    assert np.abs(samples.position[:, 2]).max() < 2.0


def test_two_payloads_are_point_masses_about_the_common_centre() -> None:
    """Sum over the parts, each by the parallel-axis theorem: another way than one after the other."""
    airframe = nominal_airframe(qdrone2())
    parts = [(1.504, np.zeros(3)), (0.1, np.array([0.03, -0.02, 0.06])), (0.2, np.array(BESIDE.position_m))]
    payloads = [Payload(mass, (float(at[0]), float(at[1]), float(at[2]))) for mass, at in parts[1:]]
    body, centre = body_with_payload(airframe, *payloads)
    total = sum(mass for mass, _ in parts)
    expected, inertia = sum((mass * at for mass, at in parts), np.zeros(3)) / total, np.diag(airframe.inertia_kg_m2)
    for mass, at in parts:
        r = at - expected
        inertia = inertia + mass * (r @ r * np.eye(3) - np.outer(r, r))
    assert body.mass == pytest.approx(total)
    np.testing.assert_allclose(centre, expected, atol=1e-15)
    np.testing.assert_allclose(body.inertia, inertia, atol=1e-15)
    np.testing.assert_allclose(body.inverse @ inertia, np.eye(3), atol=1e-12)


def test_momentum_and_angular_momentum_are_kept() -> None:
    """Of vehicle and payload about the world's origin, before and after it is taken up."""
    airframe = nominal_airframe(qdrone2())
    model = make_model(airframe, Payload(), path(Shape.HOVER, 1.0, 0.5, 0.0, 1.0), np.zeros(3))
    state = initial_state(model, np.zeros(4))
    x, rng = state.rigid, np.random.default_rng(5)
    x[:3], x[3:6], x[10:13] = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3)
    x[6:10] = rng.normal(size=4)
    x[6:10] /= np.linalg.norm(x[6:10])
    R = quaternion_rotation(x[6:10])
    place, speed = x[:3] + R @ np.array(BESIDE.position_m), x[3:6] + R @ np.cross(x[10:13], BESIDE.position_m)

    def of_vehicle(body_inertia: FloatArray, mass: float) -> tuple[FloatArray, FloatArray]:
        p = mass * x[3:6]
        return p, np.cross(x[:3], p) + R @ body_inertia @ x[10:13]

    p1, L1 = of_vehicle(model.body.inertia, model.body.mass)
    p1, L1 = p1 + BESIDE.mass_kg * speed, L1 + np.cross(place, BESIDE.mass_kg * speed)
    after = reload(model, state, airframe, (Payload(), BESIDE))
    p2, L2 = of_vehicle(after.body.inertia, after.body.mass)
    np.testing.assert_allclose(p2, p1, atol=1e-12)
    np.testing.assert_allclose(L2, L1, atol=1e-12)


def edited(tmp_path: Path, old: str, new: str) -> Path:
    assert SOURCE.count(old) == 1, old
    (file := tmp_path / "edited.toml").write_text(SOURCE.replace(old, new), encoding="utf-8")
    return file


@pytest.mark.parametrize(("name", "many"), [("qdrone2", 60), ("qdrone2-recorded", 50)])
def test_every_number_in_the_file_has_its_source_beside_it(name: str, many: int) -> None:
    """The thesis, a data sheet, an autopilot's own documentation, or plainly: estimate, fitted."""
    text = (Path(vehicle_module.__file__).parent / f"{name}.toml").read_text(encoding="utf-8")
    numbers = [line for line in text.splitlines() if re.match(r"\w+ = [^\"]*\d", line)]
    assert len(numbers) > many
    sources = "T Table|T Eq|T 3|data sheet|hover|ArduPilot:|PX4:|manufacturer|measured|inferred|estimate|fitted"
    assert [line for line in numbers if not re.search(rf"# .*({sources})", line)] == []


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("mass_kg = 1.504", "mass_kg = -1.0", "body.mass_kg"),
        ("mass_kg = 1.504", "weight_kg = 1.504", "body"),
        ("[0.0112, 0.0104, 0.0182]", "[0.0112, 0.0104, 0.0999]", "inertia_kg_m2"),
        ("motor_lag_s = 0.025", 'motor_lag_s = "slow"', "propulsion.motor_lag_s"),
        ("attitude_p = 8.0", "attitude_p = nan", "control.attitude_p"),
        ("occlusion_probability = 0.002", "occlusion_probability = 1.5", "mocap.occlusion_probability"),
        ('[[rotors]]\nname = "front left"', '[[propellers]]\nname = "front left"', "rotors"),
        ("[battery]", "[battery", "not TOML"),
    ],
)
def test_unusable_file_is_refused_by_field(tmp_path: Path, old: str, new: str, named: str) -> None:
    with pytest.raises(InputError) as caught:
        load_vehicle(edited(tmp_path, old, new))
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


def test_shipped_vehicles_can_be_had_by_name_or_file(tmp_path: Path) -> None:
    assert shipped_vehicles()[0] == "qdrone2"
    rotors = {"qdrone2": 4, "hexa-x": 6, "octo-x": 8, "qdrone2-recorded": 4, "quad-plus": 4, "hexa-plus": 6}
    assert {name: len(vehicle_from(name).rotors) for name in shipped_vehicles()} == rotors
    (file := tmp_path / "heavy.toml").write_text('base = "hexa-x"\nname = "heavy"\n')
    assert vehicle_from(str(file)) == replace(vehicle_from("hexa-x"), name="heavy")
    file.write_text('base = "qdrone2"\nname = "heavy"\n[body]\nmass_kg = 2.0\n')
    assert vehicle_from(str(file)) == replace(qdrone2(), name="heavy", body=replace(qdrone2().body, mass_kg=2.0))
    with pytest.raises(UsageError, match="hexa-x"):
        vehicle_from("nothing")
    file.write_text('base = "nothing"\n')
    with pytest.raises(InputError, match="base: give one of"):
        vehicle_from(str(file))
