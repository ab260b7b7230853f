"""The commands that README.md and docs/ name exist, with the options that they are shown with."""

import re
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest
from typer.testing import CliRunner

from detector.__main__ import app as detector
from mavdiag.cli import app as mavdiag

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    "README.md",
    *(f"docs/{name}.md" for name in ("operating", "detector", "airframe", "droneprop", "qdrone2-recorded")),
    *(f"docs/{name}.md" for name in ("emulator", "hil", "links", "security", "flight-controller")),
    *(f"docs/{name}.md" for name in ("results", "theory")),
)
COMMAND = re.compile(r"(?:^|`|\$ )((?:mavdiag-detector|mavdiag|sitl-plant) [^`\n]*)", re.MULTILINE)


def shown() -> list[tuple[str, str]]:
    """Pages and the commands in them, by code spans and fenced lines."""
    found = []
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8").replace("\\\n", " ")
        found += [(page, command) for command in COMMAND.findall(text)]
    return found


@cache
def help_of(words: tuple[str, ...]) -> str:
    program, *rest = words
    apps = {"mavdiag": mavdiag, "mavdiag-detector": detector}
    if program == "sitl-plant":
        pytest.importorskip("numba", reason="the plant is an extra")
        apps[program] = import_module("sitl_plant.__main__").app
    result = CliRunner().invoke(apps[program], [*rest, "--help"])
    return result.output if result.exit_code == 0 else ""


def words_of(command: str) -> tuple[str, ...]:
    """Program and subcommands of a command line."""
    program, *rest = command.split()
    known: tuple[str, ...] = (program,)
    for word in rest:
        listed = re.search(r"^Commands:\n((?:  .*\n?)+)", help_of(known), re.MULTILINE)
        names = re.findall(r"^  ([\w-]+)", listed[1], re.MULTILINE) if listed else []
        if word not in names:
            return (*known, "show") if known == ("mavdiag", "model") and not word.startswith("-") else known
        known = (*known, word)
    return known


@pytest.mark.parametrize(("page", "command"), shown())
def test_a_command_has_the_options_it_is_shown_with(page: str, command: str) -> None:
    words = words_of(command)
    text = help_of(words)
    assert text, f"{page}: {' '.join(words)} is no command"
    if words == (command.split()[0],) and "Commands:" in text and len(command.split()) > 1:
        rest = command.split()[1]
        assert rest.startswith(("-", "[", "|")), f"{page}: no subcommand {rest}"
    for option in re.findall(r"(?<=\s)-{1,2}[a-z][a-z-]*", command):
        assert re.search(rf"(?<![\w-]){option}(?![\w-])", text), f"{page}: {' '.join(words)} has no {option}"
