"""Pages as people see them: `PYTHONPATH=tests python benchmarks/screenshots.py [FOLDER]`, else build/screenshots.

Reports of a flight, a healthy flight, a folder and a campaign in Chromium: 1280 and 400 pixels wide, dark, and printed.
"""

import base64
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from made_report import CREATED, pages
from web_page import browser

LOOKS = {"1280": (1280, "light", "screen"), "400": (400, "light", "screen"), "dark": (1280, "dark", "screen")}
TALLEST = 12_000  # pixels of a picture


def look_as(driver: Any, width: int, scheme: str = "light", medium: str = "screen") -> None:
    """Have pages shown so wide [px], by a colour scheme and for a medium."""
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": medium, "features": features})
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def open_whole(driver: Any, path: Path) -> None:
    """Open a page with all that is folded away, and wait until its charts are drawn."""
    driver.get(path.as_uri())
    driver.execute_script("document.querySelectorAll('details').forEach((one) => { one.open = true })")
    driver.execute_async_script(
        """const wait = () => new Promise((go) => requestAnimationFrame(() => setTimeout(go, 20)));
        (async () => {
          for (const one of document.querySelectorAll('figure')) { one.scrollIntoView(); await wait() }
          scrollTo(0, 0);
        })().then(arguments[0])"""
    )


def shoot(driver: Any, shown: Mapping[str, str], folder: Path) -> None:
    """Pictures of each page, by its name, and what a printer makes of it."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        for name, text in shown.items():
            path = Path(place) / f"{name}.html"
            path.write_text(text, encoding="utf-8")
            for look, how in LOOKS.items():
                look_as(driver, *how)
                open_whole(driver, path)
                height = driver.execute_script("return document.documentElement.scrollHeight")
                clip = {"x": 0, "y": 0, "width": how[0], "height": min(height, TALLEST), "scale": 1}
                told = {"format": "png", "clip": clip, "captureBeyondViewport": True}
                found = driver.execute_cdp_cmd("Page.captureScreenshot", told)
                (folder / f"{name}-{look}.png").write_bytes(base64.b64decode(found["data"]))
            look_as(driver, 1280, "light", "")
            driver.get(path.as_uri())
            printed = driver.execute_cdp_cmd("Page.printToPDF", {"paperWidth": 8.27, "paperHeight": 11.7})
            (folder / f"{name}-print.pdf").write_bytes(base64.b64decode(printed["data"]))


def main() -> None:
    """Write the pictures."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("build/screenshots")
    try:
        with tempfile.TemporaryDirectory() as place, browser(Path(place) / "profile") as driver:
            shoot(driver, pages(), folder)
    except pytest.skip.Exception as reason:
        print(reason)
    else:
        print(f"{folder}: {', '.join(sorted(path.name for path in folder.iterdir()))}; pages made {CREATED}")


if __name__ == "__main__":
    main()
