"""`mavdiag report` as it is run, and a judged flight for other tools, by the tools' own readers."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from flying_telemetry import flying
from made_archive import content
from made_baselines import whole
from made_report import pages
from mcap.reader import make_reader
from page_reading import Page, check
from screenshots import look_as, open_whole
from selenium import webdriver
from shared_data import shared
from typer.testing import CliRunner
from web_page import violations

import mavdiag as md
from mavdiag import cli
from mavdiag.cli import app
from mavdiag.export.flight import topics_of, write_mcap
from mavdiag.face import learn
from mavdiag.judging import judge_in_full

SECTIONS = 11


def run(*arguments: object) -> str:
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
    figures = [one for tag, name, one in page.attributes if (tag, name) == ("figure", "id")]
    monitors = [one for one in figures if one.startswith("log-1-monitor-")]
    assert len(figures) - len(monitors) == SECTIONS, figures
    assert bool(monitors) == (own is not None)
    drawn = len(page.drawings) - 1  # of the airframe
    assert drawn + page.said.count("Not drawn: ") == len(figures)
    assert drawn >= (6 if own else 1)  # the flight can always be drawn
    assert ("A propeller fault of rotor" in page.said) == (own is not None)
    assert out.stat().st_size < 1_000_000


def test_a_folder_makes_one_page_and_a_bad_file_does_not_lose_the_others(tmp_path: Path, baseline: Path) -> None:
    (folder := tmp_path / "logs").mkdir()
    (folder / "notes.txt").write_text("no log")
    (torn := tmp_path / "<b>empty.bin").write_bytes(b"")
    (folder / ".hidden").write_text("not looked at")
    out = tmp_path / "report.html"
    (sound := tmp_path / "sound.tlog").write_bytes(content(1, 400))
    said = run(folder, torn, sound, "--baseline", baseline, "-o", out)
    page = page_at(out)
    assert "2 not readable" in page.said
    assert "<b>empty.bin" in page.said
    assert "without a flight log" in said
    assert said.splitlines()[-1].startswith("written to ")


LEAST_PX = 11.0
# Text that is shown, by its size: of what a page says and of what its charts say.
SMALLEST = """const found = [];
const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walk.nextNode()) {
  const at = walk.currentNode.parentElement, box = at.getBoundingClientRect();
  if (!walk.currentNode.textContent.trim() || !box.width || at.closest('script')) continue;
  const scale = at.closest('.airframe') ? at.closest('.airframe').getScreenCTM().a : 1;
  found.push([scale * parseFloat(getComputedStyle(at).fontSize), walk.currentNode.textContent.trim().slice(0, 40)]);
}
return found.sort((a, b) => a[0] - b[0])[0]"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("pages")
    for name, text in pages().items():
        (made / f"{name}.html").write_text(text, encoding="utf-8")
    return made


@pytest.mark.parametrize("name", ["flight", "healthy", "folder", "campaign", "history"])
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (400, "dark")])
def test_a_page_can_be_read(chromium: Any, folder: Path, name: str, width: int, scheme: str) -> None:
    look_as(chromium, width, scheme)
    open_whole(chromium, folder / f"{name}.html")
    assert chromium.execute_script("return [document.documentElement.scrollWidth, innerWidth]") == [width, width]
    sideways = "return [...document.querySelectorAll('main *')].filter((one) => one.scrollWidth > one.clientWidth + 1"
    sideways += " && ['auto', 'scroll'].includes(getComputedStyle(one).overflowX)).length"
    assert chromium.execute_script(sideways) == 0
    size, text = chromium.execute_script(SMALLEST)
    assert size >= LEAST_PX, text
    assert violations(chromium) == []
    assert [one["message"] for one in chromium.get_log("browser") if one["level"] == "SEVERE"] == []


def test_a_zoom_moves_all_charts_of_a_flight_and_a_click_sorts_its_table(chromium: Any, folder: Path) -> None:
    look_as(chromium, 1280)
    open_whole(chromium, folder / "folder.html")
    over, seen = chromium.find_element("css selector", "#log-2-flight .u-over"), "#log-{}-timeline .plot"
    chromium.execute_script("arguments[0].scrollIntoView({block: 'center'})", over)
    assert chromium.execute_script("return document.querySelectorAll('#log-2 .live').length") >= 8
    drag = webdriver.ActionChains(chromium).move_to_element(over).click_and_hold()
    drag.move_by_offset(over.size["width"] // 4, 0).release().perform()
    shown, other = (chromium.find_element("css selector", seen.format(number)) for number in (2, 3))
    zoomed = [float(one) for one in shown.get_dom_attribute("viewBox").split()]
    assert zoomed == pytest.approx([2000, 0, 1000, 1000], abs=20)
    assert other.get_dom_attribute("viewBox") == "0 0 4000 1000"  # another flight's
    webdriver.ActionChains(chromium).double_click(over).perform()
    assert shown.get_dom_attribute("viewBox") == "0 0 4000 1000"
    names = "return [...document.querySelectorAll('table.sorts tbody tr')].map((row) => row.cells[1].textContent)"
    assert chromium.execute_script(names) == ["not readable", "propeller fault", "healthy"]
    for wanted in (["healthy", "not readable", "propeller fault"], ["propeller fault", "not readable", "healthy"]):
        chromium.execute_script("document.querySelectorAll('table.sorts button')[1].click()")
        assert chromium.execute_script(names) == wanted


ROOT = Path(__file__).resolve().parents[2]
WEAK = md.Log("weak.ulg", "", "px4", flying(3000, 5, weak_rotor=3, rise=0.2), started_ns=1_760_000_000 * 10**9)


def test_mcap_has_every_signal_and_statistic_in_order_of_the_wall_clock(tmp_path: Path) -> None:
    judged = judge_in_full(WEAK, whole())
    write_mcap(tmp_path / "x.mcap", WEAK, list(topics_of(WEAK, judged)), judged.verdict.changes)
    with (tmp_path / "x.mcap").open("rb") as stream:
        found = [(channel.topic, message) for _, channel, message in make_reader(stream).iter_messages()]
    times = [message.log_time for _, message in found]
    assert (times, times[0]) == (sorted(times), WEAK.started_ns)
    rates = [json.loads(message.data) for topic, message in found if topic == "/body_rate"]
    assert np.array_equal([list(one.values()) for one in rates], WEAK["body_rate"].values)
    assert list(rates[0]) == ["roll", "pitch", "yaw"]
    ratios = [json.loads(message.data)["ratio"] for topic, message in found if topic == "/monitor/rotor_trim"]
    highest = next(one for one in judged.verdict.monitors if one.name == "rotor_trim")
    assert max(one for one in ratios if one is not None) == pytest.approx(highest.ratio)
    texts = [json.loads(message.data) for topic, message in found if topic == "/log"]
    assert [one["level"] for one in texts].count(4) >= 1
    assert any("rotor 3" in one["message"] for one in texts)
    with pytest.raises(md.InputError, match=r"^weak\.ulg: there is nothing to write"):
        write_mcap(tmp_path / "x.mcap", WEAK, [], ())


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_table_has_each_sample_once(tmp_path: Path, kind: str) -> None:
    log = tmp_path / "flight.csv"
    rate, t_s = WEAK["body_rate"].values, WEAK["body_rate"].t_s
    pd.DataFrame(np.column_stack((t_s, rate)), columns=["t", "p", "q", "r"]).to_csv(log, index=False)
    (tmp_path / "map.toml").write_text('[time]\ncolumn = "t"\n[body_rate]\ncolumns = ["p", "q", "r"]\nunit = "rad/s"\n')
    output = tmp_path / f"out.{kind}"
    arguments = ["export", str(log), f"--{kind}", "--columns", str(tmp_path / "map.toml"), "-o", str(output)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "written to" in result.output
    frame = pd.read_csv(output, index_col="t_s") if kind == "csv" else pd.read_parquet(output)
    assert list(frame.columns) == ["body_rate/roll", "body_rate/pitch", "body_rate/yaw"]
    assert np.allclose(frame.to_numpy(), rate, atol=1e-9)
    assert np.allclose(frame.index, t_s, atol=1e-8)


def test_a_notebook_shows_logs_verdicts_and_baselines_as_tables() -> None:
    verdict = md.judge(WEAK, whole())
    highest = verdict.to_frame()["ratio"].to_dict()
    assert highest["rotor_trim"] == next(one.ratio for one in verdict.monitors if one.name == "rotor_trim") > 1.0
    assert WEAK.to_frame("body_rate").shape == WEAK["body_rate"].values.shape
    rows = {WEAK: len(WEAK.telemetry.series), verdict: len(verdict.monitors), whole(): len(whole().monitors)}
    for value, count in rows.items():
        assert value._repr_html_().count("<tr>") == 1 + count
    assert len(WEAK.plot("body_rate").get_lines()) == 3


def test_every_notebook_runs(tmp_path: Path) -> None:
    for path in (ROOT / "examples").glob("*.ipynb"):
        text = path.read_text()
        slower = text.replace('\\"record\\",', '\\"record\\", \\"--rate\\", \\"200\\",')  # it says the same, sooner
        assert slower != text
        (tmp_path / path.name).write_text(slower.replace('\\"30\\"', '\\"20\\"'))
    copies = sorted(tmp_path.iterdir())
    run = [sys.executable, "-m", "jupyter", "execute", "--inplace", *map(str, copies)]
    subprocess.run(run, cwd=tmp_path, check=True, timeout=300, capture_output=True)
    for copy in copies:
        outputs = [out for cell in json.loads(copy.read_text())["cells"] for out in cell.get("outputs", ())]
        assert {"text/html", "image/png"} <= {kind for out in outputs for kind in out.get("data", ())}
        assert any("<table>" in "".join(out.get("data", {}).get("text/html", "")) for out in outputs)
