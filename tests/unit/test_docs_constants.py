"""docs/constants.md: the table of what is our choice is made from the code, and up to date."""

import runpy
from pathlib import Path

ROOT = Path(__file__).parents[2]
MAKER = runpy.run_path(str(ROOT / "docs" / "make_constants.py"))


def test_the_table_is_up_to_date() -> None:
    assert (ROOT / "docs" / "constants.md").read_text(encoding="utf-8") == MAKER["table"](), (
        "run python docs/make_constants.py"
    )
