"""docs/theory.md must stay true: its names exist, its numbers are computed again, its equations are counted."""

import importlib
import itertools
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel

from mavdiag.identify.lab import THESIS_PITCH, THESIS_ROLL, ReferenceModel

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")


def table(first_header: str) -> list[list[str]]:
    """Cells of the table whose first column has this header, without its head."""
    lines = PAGE.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(f"| {first_header} |"))
    rows = itertools.takewhile(lambda line: line.startswith("|"), lines[start + 2 :])
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


SYMBOLS = table("Symbol")


@pytest.mark.parametrize("row", SYMBOLS, ids=[row[0] for row in SYMBOLS])
def test_every_symbol_has_a_code_name_a_unit_and_a_source(row: list[str]) -> None:
    assert len(row) == 4
    symbol, code, unit, source = row
    assert symbol
    assert unit
    assert re.search(r"^(T |estimate|fitted|choice|standard|ISO )", source), source
    (name,) = re.findall(r"^`([^`]+)`$", code)
    assert exists(name), f"{name} is not in the code"


def exists(name: str) -> bool:
    """Whether a dotted name can be imported, or a file holds a TOML key."""
    if ":" in name:
        file, keys = name.split(":")
        return has_key(tomllib.loads((ROOT / file).read_text(encoding="utf-8")), keys.split("."))
    parts = name.split(".")
    if parts[0] == "sitl_plant":
        pytest.importorskip("numba", reason="the plant is an extra")
    for split in range(len(parts) - 1, 0, -1):
        path = ROOT.joinpath(*parts[:split])
        if path.is_dir() or path.with_suffix(".py").is_file():
            return has_attribute(importlib.import_module(".".join(parts[:split])), parts[split:])
    return False


def has_key(data: object, keys: list[str]) -> bool:
    for key in keys:
        if not (isinstance(data, dict) and key in data):
            return False
        data = data[key]
    return True


def has_attribute(found: object, names: list[str]) -> bool:
    for name in names:
        if isinstance(found, type) and issubclass(found, BaseModel) and name in found.model_fields:
            found = found.model_fields[name]
        elif hasattr(found, name):
            found = getattr(found, name)
        else:
            return False
    return True


def equations() -> list[str]:
    return re.findall(r"```math\n(.*?)```", PAGE, flags=re.DOTALL)


def test_equations_are_numbered_in_order_and_none_appears_twice() -> None:
    numbers = [int(re.findall(r"\\qquad \((\d+)\)\n$", text)[0]) for text in equations()]
    assert numbers == list(range(1, len(numbers) + 1))
    bodies = [re.sub(r"\\qquad \(\d+\)|\s", "", text) for text in equations()]
    assert len(set(bodies)) == len(bodies)
    cited = {int(number) for number in re.findall(r"(?<![\d.])\((\d{1,2})\)", PAGE)}
    assert cited <= set(numbers)


@pytest.mark.parametrize(("row", "reference"), list(zip(table("Model"), (THESIS_ROLL, THESIS_PITCH), strict=True)))
def test_the_published_models_are_those_in_the_code(row: list[str], reference: ReferenceModel) -> None:
    name, b, a, poles, gain, scale, dt = row
    assert name.startswith(reference.axis.value)
    assert name.endswith(reference.source)
    assert numbers_in(b) == reference.model.b[1:].tolist()
    assert numbers_in(a) == reference.model.a[1:].tolist()
    assert numbers_in(poles) == [round(float(pole.real), 4) for pole in reference.model.poles]
    assert numbers_in(gain) == [round(reference.model.dc_gain, 1)]
    assert scale == f"1/{round(1 / reference.input_scale)}"
    assert dt == f"{reference.model.dt * 1000:.0f} ms"


def numbers_in(cell: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.\d+", cell)]


def test_the_mixer_of_the_thesis_and_its_inverse_agree() -> None:
    """T Eq 2.8 is the inverse of T Eq 2.7, and in FRD T Eq 2.7 is the plant's allocation."""
    pytest.importorskip("numba", reason="the plant is an extra")
    vehicle = importlib.import_module("sitl_plant.vehicle")
    L_roll, L_pitch, K = 0.254, 0.2032, 68.9055
    roll, pitch, yaw = ([-1, -1, 1, 1], [1, -1, 1, -1], [1, -1, -1, 1])
    forward = np.array([[1] * 4, np.multiply(roll, L_roll / 2), np.multiply(pitch, L_pitch / 2), np.divide(yaw, K)])
    ones = np.full(4, 0.25)
    inverse = np.column_stack(
        [ones, np.divide(roll, 2 * L_roll), np.divide(pitch, 2 * L_pitch), np.multiply(yaw, K / 4)]
    )
    np.testing.assert_allclose(inverse @ forward, np.eye(4), atol=1e-12)
    signs = np.array([1.0, 1.0, -1.0, -1.0])  # y left, z up to FRD: pitch and yaw change sign
    np.testing.assert_allclose(vehicle.allocation(vehicle.qdrone2()), signs[:, None] * forward, rtol=1e-12)
