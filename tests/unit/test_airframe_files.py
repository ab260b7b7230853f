"""Airframe files: what they say, and what is refused."""

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import LAYOUTS, layout_named
from mavdiag.airframe.load import BUILTIN, airframe_from, airframe_named, load_airframe
from mavdiag.errors import InputError
from mavdiag.rows.gate import GateSpec
from mavdiag.units import RPM

ROOT = Path(__file__).resolve().parents[2]


def written(folder: Path, text: str) -> Path:
    path = folder / "vehicle.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", BUILTIN)
def test_shipped_airframes_have_a_layout(name: str) -> None:
    assert airframe_from(name) == airframe_named(name)
    assert airframe_named(name).layout == layout_named(name.removesuffix("-recorded"))
    assert sorted(BUILTIN) == sorted(p.stem for p in (ROOT / "mavdiag" / "airframe").glob("*.toml"))


def test_every_key_arrives_and_what_a_file_leaves_out_is_not_known(tmp_path: Path) -> None:
    """B18: nothing of a QDrone 2 is taken for another vehicle."""
    assert load_airframe(written(tmp_path, 'name = "other"')) == Airframe(name="other")
    path = written(
        tmp_path,
        'name = "survey"\nscope = "type"\nlayout = "octo-x"\nmass_kg = 9\nhover_rpm = 3000\nimu_corner_hz = 20.5\n'
        'classifier = "ours"\n[gate]\nmin_height_m = 1\nmin_thrust = 0.2\nneed_armed = false\ntrim_start_s = 2\n'
        "trim_end_s = 1\n",
    )
    assert airframe_from(str(path)) == Airframe(
        name="survey",
        scope="type",
        layout=layout_named("octo-x"),
        mass_kg=9.0,
        hover_rad_s=3000 * RPM,
        imu_corner_hz=20.5,
        gate=GateSpec(1.0, 0.2, False, 2.0, 1.0),
        classifier="ours",
    )


def test_the_example_of_the_page_is_an_airframe(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "airframe.md").read_text(encoding="utf-8")
    example = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)[0]
    found = load_airframe(written(tmp_path, example))
    assert found.layout is not None
    assert (found.layout.rotors, found.gate) == (6, GateSpec(0.4, 0.1, True, 1.0, 0.0))
    np.testing.assert_allclose(np.square(found.layout.mixing).sum(axis=0), 6.0)
    documented = set(re.findall(r"^(?:# )?(\w+) = ", example, re.MULTILINE))
    known = {field.name for field in fields(Airframe)} | {field.name for field in fields(GateSpec)}
    found_out = {"layout_basis", "layout_warning", "least_shake"}
    assert documented - {"x_m", "y_m", "spin", "hover_rpm"} == known - {"gate", "hover_rad_s"} - found_out
    for name in (*LAYOUTS, *BUILTIN):
        assert f"`{name}`" in page


PLACE = '[[rotors]]\nx_m = 1\ny_m = 1\nspin = "cw"\n'
REFUSED = [
    ("", "name: Field required"),
    ('name = "a"\nmass_kg = "1"', "mass_kg: Input should be a valid number"),
    ('name = "a"\nhover_rpm = nan', "hover_rpm: Input should be a finite number"),
    ('name = "a"\nlayout = "tri"', "layout: no layout 'tri': use one of qdrone2, "),
    ('name = "a"\n[gate]\nmin_hight_m = 1', "gate.min_hight_m: no such key"),
    ('name = "a"\n[gate]\nneed_armed = 1', "gate.need_armed: Input should be a valid boolean"),
    (f'name = "a"\nlayout = "x"\n{PLACE}', "rotors: give either rotors or the name of a layout"),
    (f'name = "x"\n{PLACE}', "rotors: x is a known layout: give these rotors another name"),
    (f'name = "a"\n{PLACE}', "rotors: layout a: its rotors cannot command roll, pitch and yaw independently"),
    (f'name = "a"\n{PLACE}[[rotors]]\nroll=1\npitch=1\nyaw=1', "rotors: give all rotors as places or all as effects"),
    (f'name = "a"\n{PLACE}[[rotors]]\nx_m=1\ny_m=1\nspin="left"', "rotors.2.spin: Input should be 'cw' or 'ccw'"),
    ('name = "a"\n[[rotors]]\nroll=1\npitch=1\nx_m=1', "rotors.1.yaw: Field required"),
    ('name = "a"\nrotors = 4', "rotors: Input should be a valid list"),
    ('name = "a"\nlayout = "x"\noutputs = [1, 2, 3]', "outputs: airframe: 3 outputs for 4 rotors"),
    ('name = "a"\nlayout = "x"\noutputs = [1, 2, 3, 3]', "outputs: airframe: outputs count from 1"),
    ('name = "a"\nlayout = "x"\noutputs = [0, 1, 2, 3]', "outputs.1: Input should be greater"),
    ("name = ", "not TOML: "),
]


@pytest.mark.parametrize(("text", "reason"), REFUSED)
def test_what_is_wrong_is_named_with_its_file(tmp_path: Path, text: str, reason: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        airframe_from(str(path))
    assert str(caught.value).startswith(f"{path}: {reason}")
    assert "\n" not in str(caught.value)
