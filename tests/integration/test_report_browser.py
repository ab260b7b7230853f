"""The pages of reports in Debian's Chromium: nothing scrolls sideways, all can be read, charts zoom, tables sort."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from made_report import pages
from screenshots import look_as, open_whole
from web_page import browser, violations

webdriver = pytest.importorskip("selenium.webdriver")
pytestmark = pytest.mark.realtime
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
