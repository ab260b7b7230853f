"""`mavdiag report` as it is run: logs of each kind, folders, what cannot be read, a campaign's results."""

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from made_baselines import healthy, whole
from page_reading import Page, check
from shared_data import shared
from typer.testing import CliRunner

from mavdiag import cli
from mavdiag.errors import MavdiagError, UsageError
from mavdiag.face import learn
from mavdiag.judging import judge_in_full
from mavdiag.report.flight import flight_report
from mavdiag.report.page import Made, flights_page

ROOT = Path(__file__).resolve().parents[2]
SECTIONS = 14


def run(*arguments: object) -> str:
    """The output of the command. Raises what it raised."""
    result = CliRunner().invoke(cli.app, ["report", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture
def baseline(tmp_path: Path) -> Path:
    path = tmp_path / "baseline.json"
    whole().save(path)
    return path


def page_at(path: Path) -> Page:
    return check(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("log", "own"),
    [
        ("data/crazypad/cut_propeller_M3_4mm_4mm_39mm/E8_log00", "data/crazypad/normal_flight/*"),
        ("data/arducopter_sitl/fault_quad3kg_m1_080_sq1.tlog", "data/arducopter_sitl/healthy_quad3kg_sq*.tlog"),
        ("data/ardupilot_real/log171.bin", None),
        ("data/px4_real/pyulog_sample.ulg", None),
    ],
)
def test_logs_of_each_kind_have_a_page(log: str, own: str | None, tmp_path: Path, baseline: Path) -> None:
    path, out = shared(log), tmp_path / "report.html"
    if own is not None:
        learn([str(one) for one in sorted(shared("data").parent.glob(own))]).save(baseline)
    run(path, "--baseline", baseline, "-o", out)
    page = page_at(out)
    figures = [one for one in page.ids if re.fullmatch(r"log-1-[a-z-]+", one) and "title" not in one]
    assert len([one for tag, name, one in page.attributes if (tag, name) == ("figure", "id")]) == SECTIONS, figures
    drawn = len(page.drawings)
    assert drawn + page.said.count("Not drawn: ") == SECTIONS
    assert drawn >= (9 if own else 3)  # attitude, height or link, and the airframe, can always be drawn
    assert ("A propeller fault of rotor" in page.said) == (own is not None)
    assert out.stat().st_size < 1_000_000


def test_a_folder_makes_one_page_and_a_bad_file_does_not_lose_the_others(tmp_path: Path, baseline: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "<b>notes.txt").write_text("no log")
    (folder / "empty.bin").write_bytes(b"")
    (folder / ".hidden").write_text("not looked at")
    out = tmp_path / "report.html"
    said = run(folder, "--baseline", baseline, "-o", out)
    page = page_at(out)
    assert "2 not readable" in page.said
    assert "b" not in page.tags or "<b>notes.txt" in page.said
    assert said.splitlines()[-1].startswith("written to ")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((), "name logs and --baseline FILE"),
        (("x.tlog",), "name logs and --baseline FILE"),
        (("x.tlog", "--baseline", "gone.json"), "gone.json: no such file"),
        (("--campaign", "gone.jsonl"), "gone.jsonl: no such file"),
        (("x.tlog", "--campaign", "c.jsonl"), "neither logs nor --baseline"),
        (("x.tlog", "-o", "no-folder/x.html"), "no folder"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    arguments: tuple[str, ...], reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MavdiagError, match=reason) as caught:
        run(*arguments)
    assert "\n" not in str(caught.value)


def test_an_empty_folder_and_a_missing_log_are_said(tmp_path: Path, baseline: Path) -> None:
    folder = tmp_path / "empty"
    folder.mkdir()
    with pytest.raises(MavdiagError, match="no file in this folder"):
        run(folder, "--baseline", baseline, "-o", tmp_path / "r.html")
    out = tmp_path / "r.html"
    run(tmp_path / "gone.tlog", "--baseline", baseline, "-o", out)
    assert "This file could not be read: no such file" in page_at(out).said


def test_without_matplotlib_one_line_says_what_to_install(baseline: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_svg", None)
    with pytest.raises(UsageError, match=r"pip install 'mavdiag\[report\]'"):
        run("x.tlog", "--baseline", baseline, "-o", baseline.with_suffix(".html"))


def test_a_long_flight_has_no_longer_page() -> None:
    def size(n: int) -> int:
        (log,) = healthy(1, n)
        report = flight_report(log, whole(), judge_in_full(log, whole()))
        return len(flights_page([report], whole(), Made("", "")).encode())

    short, long = size(6000), size(60_000)
    assert long < 1.3 * short
    assert long < 900_000


def test_the_results_of_a_campaign_are_read_as_it_writes_them(tmp_path: Path) -> None:
    if importlib.util.find_spec("numba") is None:
        pytest.skip("the plant is an extra")
    results, out = tmp_path / "c.jsonl", tmp_path / "c.html"
    few = ("--airframes", "1", "--learn-flights", "3", "--flights", "2", "--hours", "0.01", "--duration", "20")
    where = ("link=qdrone2@200", "cause=F1/SV3,F2/SV3", "wind=0", "payload=0", "phenomenology=1")
    levels = [one for level in where for one in ("--conditions", level)]
    command = [sys.executable, "-m", "sitl_plant", "campaign", "-o", str(results), "--workers", "1", "--json"]
    summary = subprocess.run([*command, *few, *levels], capture_output=True, text=True, check=True, cwd=ROOT).stdout
    told = json.loads(summary.splitlines()[-1])
    run("--campaign", results, "-o", out)
    page = page_at(out)
    found = next(row for row in told["detection"] if row["factor"] == "all")["detected"]
    assert f"Of {found['of']} judged flights with a damaged propeller {found['hits']} had an alarm" in page.said
    assert "no healthy flight has a score" not in page.said


def test_the_pictures_of_the_readme_are_drawn(tmp_path: Path) -> None:
    if importlib.util.find_spec("numba") is None:
        pytest.skip("the plant is an extra")
    subprocess.run([sys.executable, str(ROOT / "docs/draw_report.py"), str(tmp_path)], check=True, cwd=ROOT)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for name in ("report-evidence.svg", "report-residual.svg"):
        assert f"(docs/{name})" in readme
        drawn, kept = (ElementTree.parse(folder / name).getroot() for folder in (tmp_path, ROOT / "docs"))
        # Other versions of the libraries may place a line otherwise; what is said must be the same.
        assert [one.text for one in drawn.iter() if one.text] == [one.text for one in kept.iter() if one.text]
