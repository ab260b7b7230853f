"""The vehicle file: what it says, what it refuses, and the motor mapping made from it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plant_cases import nominal_airframe

from mavdiag.errors import InputError, UsageError
from sitl_plant import vehicle as vehicle_module
from sitl_plant.physics.airframe import Payload, draw_airframe, drone
from sitl_plant.physics.parameters import body_with_payload
from sitl_plant.vehicle import allocation, load_vehicle, qdrone2, shipped_vehicles, vehicle_from

SOURCE = (Path(vehicle_module.__file__).parent / "qdrone2.toml").read_text(encoding="utf-8")


def edited(tmp_path: Path, old: str, new: str) -> Path:
    assert SOURCE.count(old) == 1, old
    file = tmp_path / "edited.toml"
    file.write_text(SOURCE.replace(old, new), encoding="utf-8")
    return file


def test_numbers_of_the_thesis_are_in_the_file() -> None:
    """T Table 5.1."""
    vehicle = qdrone2()
    hubs = np.array([rotor.position_m for rotor in vehicle.rotors])
    assert vehicle.body.mass_kg == pytest.approx(1.146 + 0.358)
    assert np.ptp(hubs[:, 1]) == pytest.approx(0.254)
    assert np.ptp(hubs[:, 0]) == pytest.approx(0.2032)
    assert vehicle.propulsion.thrust_per_torque_1_m == 68.9055
    assert vehicle.battery.motor_constant_rpm_v == 1300
    assert vehicle.battery.nominal_v == 14.8


def test_every_number_in_the_file_has_its_source_beside_it() -> None:
    """The thesis, a data sheet, an autopilot's own documentation, or plainly: estimate, fitted."""
    numbers = [line for line in SOURCE.splitlines() if re.match(r"\w+ = [^\"]*\d", line)]
    assert len(numbers) > 60
    known = re.compile(r"# .*(T Table|T Eq|T 3|data sheet|estimate|fitted|hover|ArduPilot:|PX4:)")
    assert [line for line in numbers if not known.search(line)] == []


def test_mixer_is_the_inverse_of_the_mapping_and_the_one_of_the_thesis() -> None:
    """T Eq 2.8 = inverse of Eq 2.7. T's pitch and yaw are about y left and z up: the negative of FRD."""
    vehicle = qdrone2()
    mapping = allocation(vehicle)
    mixer = np.linalg.pinv(mapping)
    np.testing.assert_allclose(mapping @ mixer, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(mixer @ mapping, np.eye(4), atol=1e-12)
    roll, pitch, yaw = 1 / (2 * 0.254), 1 / (2 * 0.2032), 68.9055 / 4
    thesis = np.array(
        [
            [0.25, -roll, pitch, yaw],
            [0.25, -roll, -pitch, -yaw],
            [0.25, roll, pitch, -yaw],
            [0.25, roll, -pitch, yaw],
        ]
    )
    np.testing.assert_allclose(mixer, thesis * [1, 1, -1, -1], atol=1e-12)


def test_hexacopter_is_only_another_file(tmp_path: Path) -> None:
    extra = "".join(
        f'[[rotors]]\nname = "side {side}"\nposition_m = [0.0, {y}, -0.025]\nspin = "{spin}"\n\n'
        for side, y, spin in (("right", 0.2, "cw"), ("left", -0.2, "ccw"))
    )
    vehicle = load_vehicle(edited(tmp_path, "[propulsion]", extra + "[propulsion]"))
    assert allocation(vehicle).shape == (4, 6)
    np.testing.assert_allclose(allocation(vehicle) @ np.linalg.pinv(allocation(vehicle)), np.eye(4), atol=1e-12)
    assert nominal_airframe(vehicle).motor_lag_s.shape == (6,)


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


def test_missing_file_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.toml"):
        load_vehicle(tmp_path / "nowhere.toml")


def test_drones_keep_their_identity_and_differ_from_each_other() -> None:
    one, again, two = drone(qdrone2(), 1), drone(qdrone2(), 1), drone(qdrone2(), 2)
    np.testing.assert_array_equal(one.thrust_coefficient_n_s2, again.thrust_coefficient_n_s2)
    np.testing.assert_array_equal(one.unbalance_g_mm, again.unbalance_g_mm)
    assert not np.array_equal(one.motor_lag_s, two.motor_lag_s)
    with pytest.raises(UsageError, match="drone must be 1, 2 or 3"):
        drone(qdrone2(), 4)


@pytest.mark.parametrize("seed", [11])
def test_airframes_spread_as_the_file_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    new = [draw_airframe(qdrone2(), aged=False, rng=rng) for _ in range(500)]
    aged = [draw_airframe(qdrone2(), aged=True, rng=rng) for _ in range(500)]
    new_lag, aged_lag = (np.array([a.motor_lag_s for a in fleet]) / 0.025 for fleet in (new, aged))
    assert new_lag.std() == pytest.approx(0.03, rel=0.1)
    assert aged_lag.std() == pytest.approx(0.03 * 1.6 * 1.06, rel=0.1)
    assert aged_lag.mean() == pytest.approx(1.06, abs=0.005)
    thrust = np.array([a.thrust_coefficient_n_s2 for a in aged]) / 3.364e-6
    assert thrust.mean() == pytest.approx(0.985, abs=0.002)
    for fleet, limit in ((new, 0.18), (aged, 0.27)):
        unbalance = np.hypot(*np.concatenate([a.unbalance_g_mm for a in fleet]).T)
        assert unbalance.max() <= limit
        assert unbalance.max() > 0.97 * limit


def test_payload_moves_mass_centre_and_inertia_as_two_bodies_do() -> None:
    """Sum of two bodies about their common centre, computed from the definition of the inertia tensor."""
    airframe = drone(qdrone2(), 1)
    where = np.array([0.03, -0.02, 0.06])
    body, centre = body_with_payload(airframe, Payload(0.3, (0.03, -0.02, 0.06)))
    mass = 1.504
    common = (mass * airframe.centre_of_gravity_m + 0.3 * where) / (mass + 0.3)
    np.testing.assert_allclose(centre, common, atol=1e-15)

    def point(
        m: float, r: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
    ) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return np.asarray(m * (r @ r * np.eye(3) - np.outer(r, r)))

    expected = np.diag(airframe.inertia_kg_m2) + point(mass, airframe.centre_of_gravity_m - common)
    np.testing.assert_allclose(body.inertia, expected + point(0.3, where - common), atol=1e-15)
    assert body.mass == pytest.approx(1.804)
    with pytest.raises(UsageError, match="payload"):
        Payload(5.0)


def test_shipped_vehicles_can_be_had_by_name_or_file(tmp_path: Path) -> None:
    assert shipped_vehicles()[0] == "qdrone2"
    assert {name: len(vehicle_from(name).rotors) for name in shipped_vehicles()} == {
        "qdrone2": 4, "hexa-x": 6, "octo-x": 8, "qdrone2-recorded": 4, "quad-plus": 4, "hexa-plus": 6,
    }  # fmt: skip
    file = tmp_path / "heavy.toml"
    file.write_text('base = "hexa-x"\nname = "heavy"\n')
    assert vehicle_from(str(file)) == replace(vehicle_from("hexa-x"), name="heavy")
    file.write_text('base = "qdrone2"\nname = "heavy"\n[body]\nmass_kg = 2.0\n')
    assert vehicle_from(str(file)) == replace(qdrone2(), name="heavy", body=replace(qdrone2().body, mass_kg=2.0))
    with pytest.raises(UsageError, match="hexa-x"):
        vehicle_from("nothing")
    file.write_text('base = "nothing"\n')
    with pytest.raises(InputError, match="base: give one of"):
        vehicle_from(str(file))
