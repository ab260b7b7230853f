"""docs/constants.md: the table of what is our choice is made from the code, and up to date."""

import runpy
from pathlib import Path

ROOT = Path(__file__).parents[2]
MAKER = runpy.run_path(str(ROOT / "docs" / "make_constants.py"))


def test_the_table_is_up_to_date() -> None:
    assert (ROOT / "docs" / "constants.md").read_text(encoding="utf-8") == MAKER["table"](), (
        "run python docs/make_constants.py"
    )


def test_choices_are_found_with_their_reasons_and_sources_are_left_out() -> None:
    cited, chosen = "SPAN_S = 2.0  # as T has it\n", "# of rows (our choice)\nMOST = 3\n"
    source = cited + chosen + "class One:\n    LEAST = 0.1  # a guess\n"
    found = [tuple(one) for one in MAKER["choices"](source)]
    assert found == [("MOST", "3", "of rows (our choice)"), ("LEAST", "0.1", "a guess")]
