"""The table of a scan: its columns, and the same values from CSV and Parquet."""

import csv
import re
from pathlib import Path

import pytest
from made_archive import MONITORS, asked, made

from mavdiag.archive.scan import Answer, Options, judge_file, refused
from mavdiag.archive.tables import COLUMNS, rows_of, write_csv, write_parquet
from mavdiag.monitors import BY_NAME

PAGE = (Path(__file__).parents[2] / "docs" / "operating.md").read_text(encoding="utf-8")
NAMES = list(COLUMNS)


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> list[Answer]:
    """A healthy log, one with a fault in windows, and one that cannot be read."""
    whole, shaken = made(tmp_path_factory.mktemp("logs"), "a, b.tlog", "crack.tlog", shaken=("crack.tlog",))
    return [
        Answer(whole, judge_file(str(whole), asked()), fresh=True),
        Answer(shaken, judge_file(str(shaken), asked(Options(windows_s=5.0))), fresh=True),
        Answer(Path("x.tlog"), refused("no such file"), fresh=True),
    ]


def dicts(answers: list[Answer]) -> list[dict[str, object]]:
    return [{name: row.get(name) for name in NAMES} for answer in answers for row in rows_of(answer)]


def test_a_row_says_what_the_verdict_says(answers: list[Answer]) -> None:
    healthy, *windows, error = dicts(answers)
    verdict = answers[0].verdict
    assert (healthy["log"], healthy["verdict"], healthy["reason"]) == (verdict.log, "healthy", verdict.reason)
    assert (healthy["judged_s"], healthy["from_s"], healthy["since_s"]) == (verdict.judged_s, None, None)
    for monitor in verdict.monitors:
        assert healthy[f"{monitor.name}_judged_s"] == monitor.judged_s
        assert monitor.maximum is not None
        assert healthy[f"{monitor.name}_ratio"] == monitor.maximum / monitor.threshold
    unused = set(BY_NAME) - set(MONITORS)
    assert {healthy[f"{name}_judged_s"] for name in unused} == {None}
    assert [row["verdict"] for row in windows] == ["healthy", "fault", "fault"]
    assert {row["log_verdict"] for row in windows} == {"fault"}
    assert [row["to_s"] for row in windows] == [10.0, 15.0, 20.0]
    assert {row["since_s"] for row in windows} == {answers[1].verdict.events[-1].t_s} or windows[0]["since_s"]
    assert [row["ratio"] for row in windows] == [one.ratio for one in answers[1].record.windows]
    assert (error["verdict"], error["reason"], error["sha256"]) == ("error", "no such file", None)


def test_csv_and_parquet_hold_the_same(answers: list[Answer], tmp_path: Path) -> None:
    rows = [row for answer in answers for row in rows_of(answer)]
    write_csv(tmp_path / "a.csv", rows)
    with (tmp_path / "a.csv").open(newline="") as file:
        text = list(csv.DictReader(file))
    assert list(text[0]) == NAMES
    back = [{name: COLUMNS[name](value) if value else None for name, value in row.items()} for row in text]
    assert back == dicts(answers)
    pytest.importorskip("pyarrow", reason="it is an extra")
    from pyarrow.parquet import read_table

    write_parquet(tmp_path / "a.parquet", rows)
    table = read_table(str(tmp_path / "a.parquet"))
    assert table.to_pylist() == dicts(answers)
    write_parquet(tmp_path / "none.parquet", [])
    assert read_table(str(tmp_path / "none.parquet")).schema == table.schema


def test_every_column_is_in_the_manual() -> None:
    section = PAGE[PAGE.index("## An archive of logs") :]
    named = set(re.findall(r"`([a-z_A-Z0-9]+)`", section))
    own = [name for name in NAMES if not any(name.startswith(f"{monitor}_") for monitor in BY_NAME)]
    assert set(own) <= named
    assert {"MONITOR_judged_s", "MONITOR_ratio"} <= named
