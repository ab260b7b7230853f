"""To add a hexarotor: one TOML file. It is found, its rotors are named, and its baseline needs nothing shipped."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import TypeAdapter

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.load import airframe_from
from mavdiag.errors import InputError
from mavdiag.monitors.base import LearnContext
from mavdiag.monitors.rotor_signature import RotorSignature
from mavdiag.monitors.rotor_trim import RotorTrim, RotorTrimSpec
from mavdiag.monitors.unbalance import Unbalance
from mavdiag.rows.front import Rows
from mavdiag.testing import example_rows

PLACES = [(0.22, 0.16, "cw"), (0.22, -0.16, "ccw"), (0, 0.3, "ccw"), (0, -0.3, "cw"), (-0.22, 0.16, "cw")]
FILE = 'name = "made hexa"\nmass_kg = 2.4\nhover_rpm = 5200\n' + "".join(
    f'[[rotors]]\nx_m = {x}\ny_m = {y}\nspin = "{spin}"\n' for x, y, spin in [*PLACES, (-0.22, -0.16, "ccw")]
)


@pytest.fixture
def hexarotor(tmp_path: Path) -> Airframe:
    path = tmp_path / "hexa.toml"
    path.write_text(FILE, encoding="utf-8")
    return airframe_from(str(path))


def flight(seed: int, weak: int | None = None) -> Rows:
    """20 s of hover; rotor `weak`, from 1, is commanded 10 % more."""
    outputs = np.random.default_rng(seed).normal(0.5, 0.01, (2000, 6))
    if weak is not None:
        outputs[:, weak - 1] += 0.05
    force = np.random.default_rng(seed).normal([0.0, 0.0, -9.81], 0.3, (2000, 3))
    return example_rows(2000, 0.01, actuator=outputs, force=force)


def shaken(seed: int) -> Rows:
    """4 s at 1 kHz of sensor noise, without outputs."""
    rng = np.random.default_rng(seed)
    return example_rows(4000, 0.001, rate=rng.normal(0, 0.1, (4000, 3)), force=rng.normal(0, 1, (4000, 3)))


@pytest.mark.parametrize("weak", range(1, 7))
def test_rotor_trim_names_each_rotor_of_a_hexarotor(hexarotor: Airframe, weak: int) -> None:
    (spec,) = RotorTrim.fit([[flight(seed)] for seed in (1, 2)], LearnContext(hexarotor, None, 0.01, 5))
    monitor = RotorTrim(TypeAdapter(RotorTrimSpec).validate_json(TypeAdapter(RotorTrimSpec).dump_json(spec)))
    assert monitor.spec == spec
    _, found = monitor.step(monitor.start(), flight(3, weak))
    assert found.rotors is not None
    assert found.valid[-1]
    assert int(found.rotors[-1].argmax()) + 1 == weak
    assert found.value[-1] == pytest.approx(0.1, abs=0.02)


def test_what_the_file_leaves_out_is_not_a_qdrone2() -> None:
    """B18: without an airframe no rotor, no mass and no speed is assumed."""
    context = LearnContext(Airframe(), None, 0.001, 5)
    flights = [[shaken(seed)] for seed in (1, 2)]
    (spec,) = Unbalance.fit(flights, context)
    assert (spec.layout, spec.mass_kg, spec.hover_rad_s) == (None, None, None)
    for kind in (RotorTrim, RotorSignature):
        with pytest.raises(InputError, match="name the airframe"):
            kind.fit(flights, context)
