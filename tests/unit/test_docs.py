"""What README.md and docs/ show can be done, and what they name is there.

Every command of ours in a console block goes through the parser of its subcommand; those of `RUN` are run in its order,
in a folder with made flights. Python is executed, TOML is loaded by what loads it in the product.
"""

import itertools
import re
import runpy
import shlex
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, reduce
from importlib import import_module
from pathlib import Path
from pydoc import locate
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import mavdiag as md
from detector.__main__ import app as detector
from mavdiag.airframe.load import load_airframe
from mavdiag.cli import app as mavdiag
from mavdiag.logs.csv_columns import load_column_map

ROOT = Path(__file__).resolve().parents[2]
NAMES = {page.name for page in (ROOT / "docs").glob("*.md")} - {"constants.md"}  # which is made from code
PAGES = ("README.md", *sorted(f"docs/{name}" for name in NAMES))
PROGRAMS = ("mavdiag", "mavdiag-detector", "sitl-plant")

# Run in this order: what one writes, a later one reads.
RUN = (
    "sitl-plant record -o cracked.tlog --fault F2/SV2 --rotor 1 --onset 20",
    "mavdiag look flight.bin",
    "mavdiag identify healthy/ -o my_drone.json",
    "mavdiag scan flights/ --baseline my_drone.json",
    "mavdiag report flights/today.bin --baseline my_drone.json -o report.html",
    "mavdiag baseline extend --new-propellers my_drone.json hover.tlog -o my_drone.json",
    "mavdiag scan flights/ 'more/2026-*/*.tlog' --baseline drone1.json --windows 60 --csv drone1.csv",
    "mavdiag export LOG --mcap --baseline BASELINE -o FILE",
    "mavdiag export --lua my_drone.json -o propeller.lua",
    "mavdiag history add flights/ --baseline drone1.json",
    "mavdiag history show --html trends.html",
    "mavdiag history mark --airframe drone1 --new-propellers",
    "mavdiag history list --airframe drone1 --json",
    "sitl-plant serve-ardupilot --print-parameters ardupilot",
)
WRITTEN = (
    *("cracked.tlog", "my_drone.json", "report.html", "drone1.csv", "FILE", "propeller.lua"),
    *("trends.html", "mavdiag-history.sqlite"),
)
MAKER = runpy.run_path(str(ROOT / "docs" / "make_constants.py"))


def blocks(page: str, language: str) -> list[str]:
    """Fenced blocks of a page in a language, without their indentation."""
    found = re.findall(
        r"^( *)```(\S*)\n(.*?)^ *```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )
    return [re.sub(rf"^{indent}", "", text, flags=re.MULTILINE) for indent, named, text in found if named == language]


def console() -> list[tuple[str, str]]:
    """Pages and the lines of their console blocks; drawings of the architecture and printed results are none."""
    return [
        (page, line)
        for page in PAGES
        if page not in ("docs/architecture.md", "docs/results.md")
        for block in blocks(page, "")
        for line in block.replace("\\\n", " ").splitlines()
        if line.strip()
    ]


def ours() -> list[tuple[str, str]]:
    """Pages and the command lines of our programs in them, without what a shell does with the output."""
    lines = [(page, line) for page, line in console() if line.split()[0] in PROGRAMS]
    return [(page, re.split(r"\s+>\s+", line)[0].strip()) for page, line in lines]


@cache
def program(name: str) -> typer.Typer:
    apps = {"mavdiag": mavdiag, "mavdiag-detector": detector}
    if name == "sitl-plant":
        apps[name] = import_module("sitl_plant.__main__").app
    return apps[name]


def resolve(words: list[str]) -> tuple[Any, list[str], str]:
    """The subcommand that words name, what is left of them, and its name."""
    command: Any = typer.main.get_command(program(words[0]))
    names, rest = [words[0]], words[1:]
    while rest and rest[0] in subcommands(command):
        command, names, rest = command.commands[rest[0]], [*names, rest[0]], rest[1:]
    if names == ["mavdiag", "model"]:
        command, names = command.commands["show"], [*names, "show"]
    return command, rest, " ".join(names)


def subcommands(command: Any) -> list[str]:
    return list(getattr(command, "commands", ()))


@pytest.mark.parametrize(("page", "line"), ours())
def test_a_command_of_a_block_is_taken_by_the_real_command_line(page: str, line: str) -> None:
    command, rest, name = resolve(shlex.split(line))
    assert not subcommands(command), f"{page}: {name} is no whole command"
    context = command.context_class(command)
    values, left, _ = command.make_parser(context).parse_args(list(rest))
    assert not left, f"{page}: {name} does not take {left}"
    for parameter in command.params:
        assert parameter.help, f"{name}: {parameter.name} has no help"
        if parameter.name in values:
            parameter.process_value(context, values[parameter.name])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where the commands of the pages find their files: flights of an emulated quadcopter."""
    here = tmp_path_factory.mktemp("pages")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(here)
        patch.setenv("XDG_CACHE_HOME", str(here / "cache"))
        for place in ("healthy", "flights", "more/2026-01"):
            (here / place).mkdir(parents=True)
        for seed, name in enumerate(("healthy/1.tlog", "healthy/2.tlog", "healthy/3.tlog", "flights/today.bin")):
            run(f"sitl-plant record -o {name} --profile ardupilot --rate 100 --duration 30 --seed {seed}")
        for copy in ("flight.bin", "hover.tlog", "LOG", "more/2026-01/monday.tlog"):
            (here / copy).write_bytes((here / "flights/today.bin").read_bytes())
        run("mavdiag identify healthy/ -o drone1.json")
        (here / "BASELINE").write_bytes((here / "drone1.json").read_bytes())
        yield here


def run(line: str) -> str:
    """What a command prints. It must not end with an error; 1, 3 and 4 are verdicts."""
    name, *arguments = shlex.split(line)
    result = CliRunner().invoke(program(name), arguments)
    assert result.exit_code in (0, 1, 3, 4), f"{line}: {result.output}"
    assert result.exception is None or isinstance(result.exception, SystemExit), f"{line}: {result.exception!r}"
    return result.output


def test_the_commands_of_the_pages_do_what_is_said(folder: Path) -> None:
    assert set(RUN) <= {line for _, line in ours()}, "a command that is run stands on no page"
    for extra in ("mcap", "sqlalchemy"):
        pytest.importorskip(extra, reason="an extra")
    said = {line: run(line) for line in RUN}
    assert [name for name in WRITTEN if not (folder / name).stat().st_size] == []
    assert "healthy" in said["mavdiag scan flights/ --baseline my_drone.json"]
    assert "grade" in said["mavdiag identify healthy/ -o my_drone.json"]
    assert "SCR_" not in said["sitl-plant serve-ardupilot --print-parameters ardupilot"]
    assert "FRAME_CLASS" in said["sitl-plant serve-ardupilot --print-parameters ardupilot"]


@contextmanager
def made_link(address: str) -> Iterator[list[md.Telemetry]]:
    assert address.startswith("udpin:")
    yield [md.read_log("flights/today.bin").telemetry]


SNIPPETS = [(page, block) for page in PAGES for block in blocks(page, "python")]


@pytest.mark.parametrize(("page", "block"), SNIPPETS, ids=[page for page, _ in SNIPPETS])
def test_the_python_of_a_page_runs(page: str, block: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(md, "open_link", made_link)
    (folder / "my_drone.toml").write_text('name = "mine"\n')
    for copy in ("new.tlog", "swarm.tlog"):
        (folder / copy).write_bytes((folder / "flights/today.bin").read_bytes())
    t_s = np.arange(0.0, 5.0, 0.01)
    given = {
        "t_s": t_s,
        "gyro": np.zeros((len(t_s), 3)),
        "commanded": np.zeros((len(t_s), 3)),
        "duties": np.full(4, 0.5),
    }
    exec(compile(block, page, "exec"), given)


TOML = {
    "docs/airframe.md": load_airframe,
    "docs/operating.md": load_column_map,
    "docs/qdrone2-recorded.md": load_airframe,
    "docs/hil.md": import_module("sitl_plant.vehicle").load_vehicle,
}


def test_the_tables_of_the_pages_are_loaded_by_the_product(tmp_path: Path) -> None:
    found = {page: blocks(page, "toml") for page in PAGES if blocks(page, "toml")}
    assert set(found) == set(TOML)
    assert not [page for page in PAGES if blocks(page, "json") or blocks(page, "yaml")]
    for page, texts in found.items():
        for text in texts:
            path = tmp_path / "shown.toml"
            head = 'name = "mine"\nbase = "qdrone2"\n' if page == "docs/hil.md" else ""  # the tables stand beside these
            path.write_text(head + text, encoding="utf-8")
            assert TOML[page](path) is not None


def table(page: str, words: str) -> list[list[str]]:
    """Cells of the first table from a line with these words on, without its head."""
    lines = (ROOT / "docs" / page).read_text(encoding="utf-8").splitlines()
    start = next(i for i, line in enumerate(lines) if words in line)
    rows = itertools.dropwhile(lambda line: not line.startswith("|---"), lines[start:])
    found = list(itertools.takewhile(lambda line: line.startswith("|"), rows))[1:]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in found]


SYMBOLS = table("theory.md", "| Symbol |")


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
    """Whether a dotted name is in the code, or a file holds a TOML key."""
    if ":" in name:
        file, keys = name.split(":")
        held: Any = tomllib.loads((ROOT / file).read_text(encoding="utf-8"))
        return bool(reduce(lambda table, key: table.get(key, {}), keys.split("."), held) != {})
    owner, _, last = name.rpartition(".")
    found = locate(owner)
    return hasattr(found, last) or last in getattr(found, "model_fields", ())


def test_the_table_is_up_to_date() -> None:
    assert (ROOT / "docs" / "constants.md").read_text(encoding="utf-8") == MAKER["table"](), (
        "run python docs/make_constants.py"
    )


def test_the_layers_are_those_of_the_import_contract() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = next(one["layers"] for one in contracts if one["type"] == "layers")
    wanted = [{name.strip().removeprefix("mavdiag.") for name in layer.split("|")} for layer in layers[::-1]]
    drawn = [set(re.findall(r"`([a-z_]+)`", row[0])) for row in table("architecture.md", "Within `mavdiag`")]
    assert [one - {"__main__"} for one in wanted if one != {"__main__"}] == drawn


def drawn_modules() -> list[str]:
    lines = [line for block in blocks("docs/architecture.md", "") for line in block.splitlines()]
    names = {part for line in lines for part in (line.split("  ")[0], line.strip().split("  ")[0])}
    names |= {row[1].strip("`") for row in table("architecture.md", "## The values that cross")}
    return sorted(name for one in names for name in re.findall(r"[a-z_]+(?:\.[a-z_]+)*", one))


@pytest.mark.parametrize("name", drawn_modules())
def test_every_module_named_is_there(name: str) -> None:
    names = (name, f"mavdiag.{name}", f"detector.{name}")
    assert any(one.startswith(("mavdiag", "detector")) and isinstance(locate(one), ModuleType) for one in names), name
