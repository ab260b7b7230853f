"""The live page's parts for tests: its server as a process, a stream read as a browser does, and Debian's Chromium."""

import gzip
import http.client
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from processes import PATIENCE_S

from detector.web.access import Access
from detector.web.child import ServerProcess
from mavdiag.telemetry import Instant

CHROMIUM, DRIVER = Path("/usr/bin/chromium"), Path("/usr/bin/chromedriver")
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage"),
)


def wait_for(what: Callable[[], Any], words: str = "") -> Any:
    """What it returns as soon as that is true; fails after some time."""
    give_up = time.monotonic() + PATIENCE_S
    while time.monotonic() < give_up:
        if found := what():
            return found
        time.sleep(0.02)
    pytest.fail(f"it did not come: {words or what}")


@contextmanager
def serving(
    token: str | None = None, host: str = "127.0.0.1", run: str = "r1", names: tuple[str, ...] = ()
) -> Iterator[ServerProcess]:
    """The server alone, on a free port; a test is its daemon."""
    process = ServerProcess(Access(host, 0, token, names), run, lambda line: None)
    process.start()
    try:
        yield process
    finally:
        process.close()


@dataclass(frozen=True, slots=True)
class Answered:
    """An answer, read to its end."""

    status: int
    headers: http.client.HTTPMessage
    body: str


def asked(port: int, path: str = "/", method: str = "GET", **headers: str) -> Answered:
    """One request, as it is written here and no browser would; of a stream, only the beginning."""
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)) as connection:
        connection.request(method, path, headers={name.replace("_", "-"): value for name, value in headers.items()})
        with connection.getresponse() as answer:
            endless = answer.headers.get_content_type() == "text/event-stream"
            return Answered(answer.status, answer.headers, "" if endless else answer.read().decode())


class Reader:
    """A stream of server-sent events. query, headers: of the request."""

    def __init__(self, port: int, query: str = "", **headers: str) -> None:
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        sent = {name.replace("_", "-"): value for name, value in headers.items()}
        self._connection.request("GET", f"/stream{query}", headers=sent)
        self.answer = self._connection.getresponse()
        self.events: list[tuple[str, str, Any]] = []
        self.numbers: list[int] = []  # of the entries

    def until(self, done: Callable[["Reader"], bool]) -> None:
        """Read whole events until it is so."""
        kind, number = "", ""
        while not done(self):
            line = self.answer.readline().decode().rstrip("\n")
            name, _, rest = line.partition(": ")
            if name == "event":
                kind, number = rest, ""
            elif name == "id":
                number = rest
            elif name == "data":
                self.events.append((kind, number, json.loads(rest)))
                self.numbers += [int(number.split("-")[1])] if kind == "entry" else []

    def close(self) -> None:
        self.answer.close()
        self._connection.close()


def give(process: ServerProcess, *lines: str) -> list[str]:
    """Hand lines over, as the daemon does; what the server said meanwhile."""
    said: list[str] = []
    parts = ["".join(f"{line}\n" for line in lines[i : i + 200]).encode() for i in range(0, len(lines), 200)]
    for data in (*parts, b""):  # the last one: all before it was written
        while not process.put(data):
            said += process.look(Instant(time.monotonic_ns()))[1]
            time.sleep(0.001)
    return said + process.look(Instant(time.monotonic_ns()))[1]


#: Texts that are smaller than this many CSS pixels, as they are drawn, of what can be seen; SVG is scaled.
SMALL = """return [...document.querySelectorAll('body *')].filter((one) => {
    const own = [...one.childNodes].some((part) => part.nodeType === 3 && part.data.trim());
    if (!own || !one.checkVisibility({visibilityProperty: true})) return false;
    const svg = one.closest('svg'), scale = svg ? svg.getBoundingClientRect().width / svg.viewBox.baseVal.width : 1;
    return scale * parseFloat(getComputedStyle(one).fontSize) < arguments[0];
}).map((one) => `${one.tagName} ${one.className.baseVal ?? one.className}: ${one.textContent}`)"""
#: The right edge of what stands farthest to the right, less the width of the window.
ASIDE = "return document.documentElement.scrollWidth - document.documentElement.clientWidth"
AXE = Path(__file__).parent / "vendor" / "axe.min.js.gz"


def look(chromium: Any, name: str, width: int, *, dark: bool = False) -> None:
    """Show the whole page at a width; nothing may stand aside, and no text below 11 px."""
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
    chromium.execute_script("mavdiag.heard = Date.now() + 1e9; say('live')")  # a test that says nothing is no silence
    size = {"width": width, "deviceScaleFactor": 1, "mobile": width < 500}
    for height in (1000, None):  # as high as its content is at this width
        tall = height or chromium.execute_script("return document.documentElement.scrollHeight")
        chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {**size, "height": tall})
        chromium.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
    assert chromium.execute_script(ASIDE) <= 0, f"{name} at {width} px scrolls sideways"
    assert (chromium.execute_script(SMALL, 11), violations(chromium)) == ([], [])


def violations(chromium: Any) -> list[str]:
    """What axe-core finds wrong with a page for people who see or hear it in another way."""
    chromium.execute_script(gzip.decompress(AXE.read_bytes()).decode() + "; window.axe = axe")
    ran = chromium.execute_async_script("const done = arguments[0]; axe.run().then(done)")
    assert "color-contrast" in {one["id"] for one in ran["passes"]}
    return [
        f"{one['id']}: {one['nodes'][0]['html'][:200]} {one['nodes'][0]['failureSummary']}" for one in ran["violations"]
    ]


@contextmanager
def browser(profile: Path) -> Iterator[Any]:
    """Debian's Chromium, headless, with a profile of its own; skips where it is not installed."""
    if not CHROMIUM.exists() or not DRIVER.exists():
        pytest.skip("no Chromium here: `apt-get install chromium chromium-driver` (`make system`)")
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for flag in (*FLAGS, f"--user-data-dir={profile}", "--window-size=1400,1150"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    environ = {**os.environ, "HOME": str(profile.parent)}
    driver = webdriver.Chrome(options=options, service=Service(str(DRIVER), env=environ))
    try:
        driver.set_script_timeout(PATIENCE_S)
        yield driver
    finally:
        driver.quit()
        shutil.rmtree(profile, ignore_errors=True)
