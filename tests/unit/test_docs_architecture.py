"""docs/architecture.md must stay true: its layers, its modules and tests, and the one pass that it draws."""

import importlib.util
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def table(heading: str, column: int) -> list[str]:
    """A column of the first table after a heading, without its head."""
    lines = PAGE[PAGE.index(heading) :].splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("|---"))
    rows = []
    for line in lines[start + 1 :]:
        if not line.startswith("|"):
            break
        rows.append(line.strip("|").split("|")[column].strip())
    return rows


def test_the_layers_are_those_of_the_import_contract() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = next(one["layers"] for one in contracts if one["type"] == "layers")
    wanted = [{name.strip().removeprefix("mavdiag.") for name in layer.split("|")} for layer in layers[::-1]]
    drawn = [set(re.findall(r"`([a-z_]+)`", cell)) for cell in table("Within `mavdiag`", 0)]
    assert [one - {"__main__"} for one in wanted if one != {"__main__"}] == drawn


def drawn_modules() -> list[str]:
    blocks = re.findall(r"```\n(.*?)```", PAGE, flags=re.DOTALL)
    names = {name for block in blocks for line in block.splitlines() for name in line.split("  ")[:1]}
    indented = {line.strip().split("  ")[0] for block in blocks for line in block.splitlines()}
    return sorted(name for one in names | indented for name in re.findall(r"[a-z_]+(?:\.[a-z_]+)*", one))


@pytest.mark.parametrize("name", [*drawn_modules(), *(m.strip("`") for m in table("## The values that cross", 1))])
def test_every_module_named_is_there(name: str) -> None:
    names = (name, f"mavdiag.{name}", f"detector.{name}")
    assert any(one.split(".")[0] in ("mavdiag", "detector") and found(one) for one in names), name


def found(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False
