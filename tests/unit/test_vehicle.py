"""The vehicle file: what it says, what it refuses, and the motor mapping made from it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plant_cases import nominal_airframe

from mavdiag.errors import InputError, UsageError
from sitl_plant import vehicle as vehicle_module
from sitl_plant.vehicle import allocation, load_vehicle, qdrone2, shipped_vehicles, vehicle_from

SOURCE = (Path(vehicle_module.__file__).parent / "qdrone2.toml").read_text(encoding="utf-8")


def edited(tmp_path: Path, old: str, new: str) -> Path:
    assert SOURCE.count(old) == 1, old
    file = tmp_path / "edited.toml"
    file.write_text(SOURCE.replace(old, new), encoding="utf-8")
    return file


@pytest.mark.parametrize(("name", "many"), [("qdrone2", 60), ("qdrone2-recorded", 50)])
def test_every_number_in_the_file_has_its_source_beside_it(name: str, many: int) -> None:
    """The thesis, a data sheet, an autopilot's own documentation, or plainly: estimate, fitted."""
    text = (Path(vehicle_module.__file__).parent / f"{name}.toml").read_text(encoding="utf-8")
    numbers = [line for line in text.splitlines() if re.match(r"\w+ = [^\"]*\d", line)]
    assert len(numbers) > many
    sources = "T Table|T Eq|T 3|data sheet|hover|ArduPilot:|PX4:|manufacturer|measured|inferred|estimate|fitted"
    known = re.compile(rf"# .*({sources})")
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
