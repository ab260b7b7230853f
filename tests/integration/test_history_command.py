"""`mavdiag history` as a user meets it: on recordings of the emulator, and on a history of many flights."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_history import DAY_NS, START_NS, records
from plant_process import record

from mavdiag.history.warn import Mark, MarkKind

pytest.importorskip("sqlalchemy", reason="the history is an extra")

from mavdiag.history.store import open_history


@pytest.fixture
def wearing(tmp_path: Path) -> Path:
    """One airframe that wears and one that does not."""
    path = tmp_path / "fleet.sqlite"
    rng = np.random.default_rng(1)
    worn = 0.4 + 0.6 * np.arange(1, 141) / 150 + 0.03 * rng.standard_normal(140)
    calm = 0.4 + 0.03 * rng.standard_normal(60)
    with open_history(str(path), create=True) as history:
        for one in (*records(worn.tolist(), airframe="worn"), *records(calm.tolist(), airframe="calm")):
            history.add(one)
    return path


def test_flights_are_judged_kept_once_and_listed(mavdiag: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba", reason="the plant is an extra")
    monkeypatch.chdir(tmp_path)
    record(tmp_path / "logs.tlog", "--flights", "4", "--duration", "16", "--seed", "70")
    logs = sorted(tmp_path.glob("*.tlog"))
    assert mavdiag("identify", *logs[:3], "-o", "b.json", "--airframe", "qdrone2", "--name", "drone 1")[0] == 0
    (tmp_path / "damaged.tlog").write_bytes(b"")
    code, out, _ = mavdiag("history", "add", *logs[2:], "damaged.tlog", "--baseline", "b.json")
    said = out.splitlines()
    assert (code, len(said)) == (2, 3)
    assert [": added, healthy, " in line for line in said] == [True, True, False]
    assert said[2].startswith("damaged.tlog: error, ")
    code, out, _ = mavdiag("history", "add", logs[2], "--baseline", "b.json", "--airframe", "drone 2")
    assert (code, out) == (0, f"{logs[2]}: is there already, of drone 1\n")
    code, out, _ = mavdiag("history", "add", logs[2], "--baseline", "b.json", "--vehicle", 1)
    assert (code, out) == (0, f"{logs[2]}: is there already, of drone 1\n")  # its only vehicle, named or not
    code, out, _ = mavdiag("history", "add", logs[2], "--baseline", "b.json", "--again")
    assert (code, f"{logs[2]}: judged again, healthy" in out) == (0, True)
    code, out, _ = mavdiag("history", "list", "--json")
    flights = [json.loads(line) for line in out.splitlines()]
    assert (code, [one["flight"] for one in flights]) == (0, [1, 2])
    assert {one["airframe"] for one in flights} == {"drone 1"}
    assert len(flights[0]["rotor_trim"]) == 4
    names = [one["monitor"] for one in flights[0]["monitors"]]
    assert names[:2] == ["fsd", "fsd"]
    assert {"innovation", "unbalance", "rotor_trim"} <= set(names)
    assert all(one["median"] <= one["peak"] for one in flights[0]["monitors"])
    assert mavdiag("history")[0] == 0


def test_a_wearing_airframe_is_warned_of_until_its_propellers_are_new(mavdiag: Any, wearing: Path) -> None:
    code, out, err = mavdiag("history", "--database", wearing)
    assert (code, err) == (1, "")
    (warning,) = (line for line in out.splitlines() if "soon" in line)
    assert warning.startswith("  unbalance: reaches the threshold soon")
    assert [line.split(":")[0] for line in out.splitlines() if not line.startswith(" ")] == ["calm", "worn"]
    assert mavdiag("history", "show", "--database", wearing, "--airframe", "calm")[0] == 0
    code, out, _ = mavdiag("history", "show", "--database", wearing, "--airframe", "worn", "--json")
    found = json.loads(out)
    assert (code, found["warned"]) == (1, ["unbalance"])
    (trend,) = (one for one in found["trends"] if one["monitor"] == "unbalance")
    assert trend["outlook"] == "warning"
    assert trend["remaining_low"] <= trend["remaining"] <= trend["remaining_high"]
    at = np.datetime64(START_NS + 200 * DAY_NS, "ns")
    told = ("--airframe", "worn", "--database", wearing, "--new-propellers", "--at", str(at)[:19])
    assert mavdiag("history", "mark", *told) == (0, "worn: new propellers, 2026-07-20\n", "")
    code, out, _ = mavdiag("history", "--database", wearing)
    assert code == 0
    assert "new propellers after the last flight: no trend yet" in out


def test_csv_has_a_row_for_each_monitor_and_each_trend(mavdiag: Any, wearing: Path, tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    code, out, _ = mavdiag("history", "list", "--airframe", "calm", "--csv", table, "--database", wearing)
    rows = list(csv.DictReader(io.StringIO(table.read_text())))
    assert (code, len(rows), len(out.splitlines())) == (0, 60 * 8, 60)
    assert {row["monitor"] for row in rows} >= {"fsd", "unbalance", "trim of rotor 4"}
    code, out, _ = mavdiag("history", "--csv", table, "--database", wearing)
    rows = list(csv.DictReader(io.StringIO(table.read_text())))
    assert code == 1
    assert {(row["airframe"], row["outlook"]) for row in rows if row["monitor"] == "unbalance"} == {
        ("calm", "steady"),
        ("worn", "warning"),
    }


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "no history there; make one with `mavdiag history add`"),
        (("list", "--csv"), "'--csv' requires an argument"),
        (("--airframe", "x", "list"), "unexpected extra argument"),
        (("mark", "--airframe", "x"), "say what was done"),
        (("mark", "--airframe", "x", "--repair", "--at", "yesterday"), "write it like 2026-03-01"),
        (("show", "--database", "postgresql://me:secret@127.0.0.1:1/fleet"), "Connection refused"),
        (("add", "x.tlog", "--baseline", "none.json"), "none.json: no such file"),
        (("show", "--database", "/etc/passwd"), "file is not a database"),
        (("show", "--database", "/tmp"), "/tmp: is a folder"),
        (("show", "--database", "mysql://a@b/c"), "an SQLite file or a postgresql"),
        (("show", "--database", ""), "name the history"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(
    mavdiag: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = mavdiag("history", *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err
    assert "secret" not in err
    assert list(tmp_path.iterdir()) == []


def test_a_page_shows_the_trends_and_what_asks_for_attention_first(mavdiag: Any, wearing: Path) -> None:
    with open_history(str(wearing), write=True) as history:
        history.mark(Mark("calm", history.flights("calm")[30].t_ns - 1, MarkKind.NEW_PROPELLERS))
    page = wearing.with_suffix(".html")
    assert mavdiag("history", "show", "--database", wearing, "--html", page)[0] == 1
    text = page.read_text()
    assert text.index("<h2>worn</h2>") < text.index("<h2>calm</h2>")
    assert text.count("<svg") >= 2
    assert "unbalance: warned of" in text
    assert "new propellers" in text[text.index("<h2>calm</h2>") :]
    assert str(wearing) not in text
