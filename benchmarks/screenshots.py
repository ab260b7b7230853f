"""Pages as people see them: `PYTHONPATH=tests python benchmarks/screenshots.py [FOLDER]`, else build/screenshots.

Reports of a flight, a healthy flight, a folder, a campaign and a history, the live page with 0, 1, 3, 20 vehicles and
with a fault, and a replay, in Chromium: 1280 and 400 pixels wide, dark, and printed.
"""

import base64
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from made_page import FLEETS, fleet, flown, now
from made_report import CREATED, pages
from made_session import baseline_for
from made_vehicle import record
from web_page import browser, give, serving, wait_for

from mavdiag.decision.diagnosis import Stage

LOOKS = {"1280": (1280, "light", "screen"), "400": (400, "light", "screen"), "dark": (1280, "dark", "screen")}
TALLEST = 12_000  # pixels of a picture
FOUND = "A propeller fault of motor 2 was found: trim 1.8 times its threshold."


def look_as(driver: Any, width: int, scheme: str = "light", medium: str = "screen", height: int = 900) -> None:
    """Have pages shown so wide and high [px], by a colour scheme and for a medium."""
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": medium, "features": features})
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def unfold(driver: Any) -> None:
    """Open all that is folded away, and wait until the charts are drawn."""
    driver.execute_script("document.querySelectorAll('details').forEach((one) => { one.open = true })")
    driver.execute_async_script(
        """const wait = () => new Promise((go) => requestAnimationFrame(() => setTimeout(go, 20)));
        (async () => {
          for (const one of document.querySelectorAll('figure')) { one.scrollIntoView(); await wait() }
          scrollTo(0, 0);
          await wait();
        })().then(arguments[0])"""
    )


def open_whole(driver: Any, path: Path) -> None:
    """Open a page with all that is folded away."""
    driver.get(path.as_uri())
    unfold(driver)


def shoot(driver: Any, name: str, folder: Path) -> None:
    """Pictures of the page that is open, and what a printer makes of it."""
    for look, how in LOOKS.items():
        look_as(driver, *how)
        unfold(driver)
        height = min(driver.execute_script("return document.documentElement.scrollHeight"), TALLEST)
        look_as(driver, *how, height)  # what is below the window is not drawn
        unfold(driver)
        found = driver.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})
        (folder / f"{name}-{look}.png").write_bytes(base64.b64decode(found["data"]))
    look_as(driver, 1280, "light", "")
    driver.execute_script("document.querySelectorAll('details').forEach((one) => { one.open = false })")
    printed = driver.execute_cdp_cmd("Page.printToPDF", {"paperWidth": 8.27, "paperHeight": 11.7})
    (folder / f"{name}-print.pdf").write_bytes(base64.b64decode(printed["data"]))


def shoot_files(driver: Any, shown: Mapping[str, str], folder: Path) -> None:
    """Pages that stand alone, by their names."""
    with tempfile.TemporaryDirectory() as place:
        for name, text in shown.items():
            path = Path(place) / f"{name}.html"
            path.write_text(text, encoding="utf-8")
            driver.get(path.as_uri())
            shoot(driver, name, folder)


def shoot_live(driver: Any, folder: Path) -> None:
    """The live page with each number of vehicles, and with a fault."""
    for count, levels in FLEETS.items():
        lines = (fleet(*range(1, count + 1), levels=levels), *(flown() if count else ()))
        _shoot_live(driver, f"live-{count}", folder, lines)
    fault = (fleet(1, levels={1: (Stage.FAULT, 2)}), *flown(), now(1, 400, Stage.FAULT, 2, FOUND))
    _shoot_live(driver, "live-fault", folder, fault)


def _shoot_live(driver: Any, name: str, folder: Path, lines: Sequence[str]) -> None:
    with serving() as process:
        driver.get(process.place.url)
        give(process, *lines)
        told = "return mavdiag.connection === 'live' && (!arguments[0] || mavdiag.traces.size > 0)"
        wait_for(partial(driver.execute_script, told, len(lines) > 1), name)
        driver.execute_script("mavdiag.heard = Date.now() + 1e9")  # nothing comes any more
        shoot(driver, name, folder)


def shoot_replay(driver: Any, folder: Path) -> None:
    """A replay that stands some seconds behind the onset of a fault."""
    with ExitStack() as stack:
        place = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        record(place / "flight.tlog", ((60.0, 0.0), (20.0, 0.5), (40.0, 0.0)))
        baseline_for().save(place / "b.json")
        given = [str(place / "flight.tlog"), "--baseline", str(place / "b.json"), "--web", "0", "--from", "70"]
        command = [sys.executable, "-m", "mavdiag", "replay", *given]
        child = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(child.terminate)
        assert child.stdout is not None
        driver.get(child.stdout.readline().split(" on ")[1].split(";")[0])
        wait_for(lambda: driver.execute_script("return mavdiag.playing?.done && mavdiag.now?.level === 'fault'"))
        driver.execute_script("document.getElementById('play').click()")
        wait_for(lambda: driver.execute_script("return mavdiag.playing.speed === 0"))
        shoot(driver, "replay", folder)


def main() -> None:
    """Write the pictures."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("build/screenshots")
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryDirectory() as place, browser(Path(place) / "profile") as driver:
            shoot_files(driver, pages(), folder)
            shoot_live(driver, folder)
            shoot_replay(driver, folder)
    except pytest.skip.Exception as reason:
        print(reason)
    else:
        print(f"{folder}: {', '.join(sorted(path.name for path in folder.iterdir()))}; pages made {CREATED}")


if __name__ == "__main__":
    main()
