"""Draw docs/live-page.png and docs/report.png: the live page and the report of a real run of the emulator.

PYTHONPATH=tests python docs/draw_pages.py     needs Chromium and its driver (`make system`)
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

from web_page import browser

from mavdiag.baseline import Baseline
from mavdiag.commands.report import write_report
from mavdiag.demo.command import own_baselines
from mavdiag.demo.subprocesses import READY_S, Child, Flight
from mavdiag.logs import read_log

FLIGHT = Flight(duration_s=60.0, fault="F2/SV2", rotor=1, onset_s=15.0, seed=1)
AFTER_S = 30.0  # of flight, when the picture of the live page is taken
DOCS = Path(__file__).parent


def main() -> None:
    """Fly, look at the pages, keep the pictures."""
    fused, _ = own_baselines(quiet=True)
    with TemporaryDirectory() as name, browser(Path(name) / "profile") as driver:
        log, page = Path(name) / "flight.tlog", Path(name) / "report.html"
        link = ("--connect", "udpin:127.0.0.1:0", "--web", "127.0.0.1:0", "--record", str(log))
        with Child("detector", *link, "--baseline", str(fused)) as detector:
            address, served = (detector.wait_for(word, READY_S).partition(word)[2] for word in ("udpin:", "http://"))
            with Child("sitl_plant", "run", "--out", f"udpout:{address.partition(',')[0]}", *FLIGHT.arguments) as plant:
                plant.wait_for("flies", READY_S)
                driver.set_window_size(1280, 900)
                driver.get(f"http://{served}")
                time.sleep(AFTER_S)
                driver.save_screenshot(str(DOCS / "live-page.png"))
                plant.end()
        write_report(read_log(log), Baseline.load(fused), Path("my_drone.json"), page)
        driver.get(page.as_uri())
        driver.save_screenshot(str(DOCS / "report.png"))


if __name__ == "__main__":
    main()
