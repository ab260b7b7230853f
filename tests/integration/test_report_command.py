"""`mavdiag report` as it is run: logs of each kind, folders, what cannot be read, a campaign's results."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from made_archive import content
from made_baselines import whole
from made_report import pages
from page_reading import Page, check
from screenshots import look_as, open_whole
from selenium import webdriver
from shared_data import shared
from typer.testing import CliRunner
from web_page import browser, violations

from mavdiag import cli
from mavdiag.face import learn

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
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "notes.txt").write_text("no log")
    torn = tmp_path / "<b>empty.bin"
    torn.write_bytes(b"")
    (folder / ".hidden").write_text("not looked at")
    out = tmp_path / "report.html"
    sound = tmp_path / "sound.tlog"
    sound.write_bytes(content(1, 400))
    said = run(folder, torn, sound, "--baseline", baseline, "-o", out)
    page = page_at(out)
    assert "2 not readable" in page.said
    assert "<b>empty.bin" in page.said
    assert "no flight logs" in said
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
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    with browser(tmp_path_factory.mktemp("chromium") / "profile") as driver:
        yield driver


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("pages")
    for name, text in pages().items():
        (made / f"{name}.html").write_text(text, encoding="utf-8")
    return made


@pytest.mark.realtime
@pytest.mark.parametrize("name", ["flight", "healthy", "folder", "campaign", "history"])
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (400, "dark")])
def test_a_page_can_be_read(chromium: Any, folder: Path, name: str, width: int, scheme: str) -> None:
    look_as(chromium, width, scheme)
    open_whole(chromium, folder / f"{name}.html")
    ends = "return [document.documentElement.scrollWidth, innerWidth]"
    assert chromium.execute_script(ends) == [width, width]
    sideways = "return [...document.querySelectorAll('main *')].filter((one) => one.scrollWidth > one.clientWidth + 1"
    sideways += " && ['auto', 'scroll'].includes(getComputedStyle(one).overflowX)).length"
    assert chromium.execute_script(sideways) == 0
    size, text = chromium.execute_script(SMALLEST)
    assert size >= LEAST_PX, text
    assert violations(chromium) == []
    assert [one["message"] for one in chromium.get_log("browser") if one["level"] == "SEVERE"] == []


@pytest.mark.realtime
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
