"""docs/theory.md must stay true: its names exist, its numbers are computed again, its equations are counted."""

import importlib
import itertools
import re
import tomllib
from pathlib import Path

import pytest
from pydantic import BaseModel

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
