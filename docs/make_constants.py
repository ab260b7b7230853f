"""Make docs/constants.md: every constant whose value is a choice or a guess of ours, with its reason.

    python docs/make_constants.py           (a test fails where the table is not up to date)

A constant is a name in capitals that a module or class of the product assigns, whose comment says "our choice" or
"guess"; the reason is what else the comment says. Constants that cite a source are not in the table.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "docs" / "constants.md"
PACKAGES = ("mavdiag", "detector", "sitl_plant")
MOST_LINES = 4  # a longer statement is a table whose rows have comments of their own
OURS = re.compile(r"\b(our (own )?(choices?|floor|guess)|a guess)\b")
INTRODUCTION = """# Constants that are our choice

Made by `python docs/make_constants.py` from the comments in the code; a test compares. A constant with a source (the
thesis, a standard, a data sheet) cites it in the code and is not listed. What moves when a threshold's constant is
changed is shown by the commands of [results](results.md).
"""


class Constant(NamedTuple):
    """name, value: as they stand in the code. why: the comment."""

    name: str
    value: str
    why: str


def choices(source: str) -> Iterator[Constant]:
    """The constants of a module that are our choice."""
    lines = source.splitlines()
    statements = ast.parse(source).body
    for statement in statements:
        if isinstance(statement, ast.ClassDef):
            statements += statement.body  # which this loop reaches
        if not isinstance(statement, ast.Assign | ast.AnnAssign) or statement.value is None:
            continue
        target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
        name = ast.unparse(target).strip("()")
        why = comment_of(lines, statement.lineno, statement.end_lineno or statement.lineno)
        if name.isupper() and OURS.search(why):
            value = " ".join(ast.unparse(statement.value).split())
            yield Constant(name, value if len(value) <= 60 else value[:57] + "...", why)


def comment_of(lines: list[str], first: int, last: int) -> str:
    """The comments of the lines of a statement (from 1), and those right above it."""
    found = []
    above = first - 2
    while above >= 0 and lines[above].lstrip().startswith("#"):
        found.insert(0, lines[above].lstrip())
        above -= 1
    inside = lines[first - 1 : last] if last - first < MOST_LINES else []
    found += [line[line.index("#") :] for line in inside if "#" in line]
    return " ".join(text.lstrip("# ") for text in found)


def table() -> str:
    """The whole document."""
    out = [INTRODUCTION]
    for path in sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        found = sorted(set(choices(path.read_text(encoding="utf-8"))))
        if found:
            out.append(f"## {path.relative_to(ROOT).as_posix()}\n\n| constant | value | why |\n|---|---|---|")
            out += [f"| `{name}` | `{escaped(value)}` | {escaped(why)} |" for name, value, why in found]
            out.append("")
    return "\n".join(out)


def escaped(text: str) -> str:
    """Text that does not end a cell of a table."""
    return text.replace("|", "\\|")


if __name__ == "__main__":
    TABLE.write_text(table(), encoding="utf-8")
