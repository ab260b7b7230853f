"""docs/architecture.md must stay true: its layers, its modules and tests, and the one pass that it draws."""

import importlib.util
import re
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from flying_telemetry import flying

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.chain import chain_of
from mavdiag.decision.alarm import Stage
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import Log

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
STAGES = ("mavdiag.rows.align", "mavdiag.rows.gate", "mavdiag.rows.rates", "mavdiag.kernel", "mavdiag.decision.alarm")
INSIDE = ("kinds", "grading")  # of the decision, in the order of the drawing


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


@pytest.mark.parametrize("cell", table("## Where a new thing goes", 3))
def test_what_shows_how_to_add_a_thing_is_there(cell: str) -> None:
    shown = re.findall(r"`(tests/[a-z_/]+\.py)`(?: \(`(\w+)`\))?", cell)
    assert shown
    for path, name in shown:
        text = (ROOT / path).read_text()
        assert re.search(rf"^(def|class|from \w+ import) {name}\b", text, re.MULTILINE), f"{path}: {name}"


@contextmanager
def calls() -> Iterator[list[str]]:
    """Modules of the steps that are called: the streaming steps of the drawing, and the parts of the decision."""
    seen: list[str] = []

    def watch(frame: FrameType, event: str, arg: Any) -> None:
        if event == "call" and frame.f_code.co_name in ("step", "isolate", "assess"):
            seen.append(frame.f_globals.get("__name__", ""))

    sys.setprofile(watch)
    try:
        yield seen
    finally:
        sys.setprofile(None)


def test_no_module_is_entered_twice_between_rows_and_decision() -> None:
    airframe = Airframe(layout=layout_named("x"), classifier="qdrone2")
    flights = [Log(f"flight{i}", "", "ardupilot", flying(4000, i)) for i in range(3)]
    chain = chain_of(learn(flights, LearnOptions(airframe=airframe), created=""))
    assert len(chain.slots) >= 5
    with calls() as seen:
        state, output = chain.step(chain.start(), flying(4000, 7, weak_rotor=2, rise=0.3))
    assert Stage.FAULT in {change.stage for change in output.changes}
    assert state.diagnosis.rotor == 2
    passed = [stage for name in seen for stage in STAGES if name == stage or name.startswith(f"{stage}.")]
    assert [stage for stage, _ in groupby(passed)] == list(STAGES)
    assert chain.baseline.envelope
    order = [re.escape(stage.removeprefix("mavdiag.")) for stage in STAGES]
    assert re.search(r"\n *" + r" .*?\n *".join(order) + r"\b", PAGE, re.DOTALL)
    decision = [name.rsplit(".", 1)[1] for name in seen if name.startswith("mavdiag.decision.")]
    assert (
        tuple(part for part in dict.fromkeys(decision) if part in INSIDE) == INSIDE[: len(set(decision) & set(INSIDE))]
    )
    assert "kinds" in decision
