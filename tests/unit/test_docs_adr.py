"""Decision records: one page, numbered in order, one form, at most 100 words each."""

import re
from pathlib import Path

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "adr" / "README.md").read_text(encoding="utf-8")


def test_every_record_is_numbered_short_and_of_one_form() -> None:
    _, *records = re.split(r"^## ", PAGE, flags=re.MULTILINE)
    assert [record[:6] for record in records] == [f"{number:04}: " for number in range(1, len(records) + 1)]
    for record in records:
        assert re.fullmatch(r".+?\n\n\S.+?\n\n\*\*Decision\.\*\*.+?\n\n\*\*Consequence\.\*\*.+", record, re.DOTALL), (
            record
        )
        words = re.sub(r"\]\([^)]*\)", "]", record).split()
        assert len(words) <= 100, (len(words), record)
