"""The live page in Chromium: how soon an alert is on it, and what it costs the detector.

    python benchmarks/live_page.py [--pairs 5] [--seconds 20] [--rate 1000] [--alerts 10]

Cost: one emulated vehicle sends to one detector; spans with the page open and closed alternate in the order A B B A, in
one run. Figures are processor time of the daemon's threads, by the system's account, and the ratio of each pair. The
same is done with a reader that takes the page's stream and draws nothing: on a machine of few cores a browser that
draws slows whatever runs beside it. Last, a flight on a virtual clock: the page's share of what the daemon itself does.

Alerts: a made vehicle turns without a command until a text says FAULT, again and again. What is measured is from the
ground station's receipt of the STATUSTEXT until the page has drawn it (wall clock of one machine, 1 ms).
Last, 1,000 events at once: the longest frame of the page while it takes them. Seed: the emulator's default.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from detector_load import baseline_file
from made_session import baseline_for
from made_vehicle import START_NS, TICK_S, Bench, MadeVehicle
from many_vehicles import frames_of, record
from web_page import browser, give, serving

from detector.config import Settings
from detector.fleet import Fleet, Turn
from detector.web.child import ServerProcess
from detector.web.feed import Feed
from mavdiag.baseline import Baseline
from mavdiag.link.codec import Decoder
from mavdiag.link.messages import MessageId
from mavdiag.link.ports import open_endpoint
from mavdiag.telemetry import Instant

SETTLE_S = 8.0  # from the first message until the detector judges everything
REST_S = 1.5  # after a page was opened or closed


def cpu_s(pid: int) -> float:
    """Processor time of all threads of a process [s]."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((one / "schedstat").read_text().split()[0]) for one in tasks) / 1e9


def server_of(pid: int) -> int:
    """The process of the page's server."""
    return int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])


@contextmanager
def detector(baseline: Path) -> Iterator[tuple[subprocess.Popen[str], int, str]]:
    """The daemon with its page: the process, its port for the vehicle and the page's address."""
    command = [sys.executable, "-m", "detector", "--connect", "udpin:127.0.0.1:0", "--web", "0"]
    child = subprocess.Popen([*command, "--baseline", str(baseline)], stderr=subprocess.PIPE, text=True)
    assert child.stderr is not None
    ready, page = child.stderr.readline(), child.stderr.readline()
    threading.Thread(target=lambda: [None for _ in child.stderr or ()], daemon=True).start()  # its log is not read
    try:
        yield child, int(ready.split(",")[0].rsplit(":", 1)[1]), page.split("web page: ")[1].strip()
    finally:
        child.terminate()
        child.wait(20.0)


READER = """
import sys, urllib.request
with urllib.request.urlopen(sys.argv[1] + "stream?vehicle=1") as stream:
    for line in stream:
        pass
"""


def spent(pids: list[int], span_s: float) -> list[float]:
    """Share of a core that each process used in the span [%]."""
    before, since = [cpu_s(one) for one in pids], time.monotonic()
    time.sleep(span_s)
    after, took_s = [cpu_s(one) for one in pids], time.monotonic() - since
    return [100.0 * (b - a) / took_s for a, b in zip(before, after, strict=True)]


def pairs(pids: list[int], count: int, span_s: float, opened: Callable[[], Any], closed: Callable[[], Any]) -> None:
    """Alternate, and print the figures."""
    ratios, shares, servers = [], [], []
    for number in range(count):
        found = {}
        for is_open in (False, True) if number % 2 == 0 else (True, False):
            (opened if is_open else closed)()
            time.sleep(REST_S)
            found[is_open] = spent(pids, span_s)
        ratios.append(found[True][0] / found[False][0])
        shares.append((found[False][0], found[True][0]))
        servers.append(found[True][1])
    closed()
    shut, looked = (statistics.median(column) for column in zip(*shares, strict=True))
    server = statistics.median(servers)
    print(f"    daemon, closed {shut:.2f} % of a core, open {looked:.2f} %; the server's process {server:.2f} %")
    middle, least, most = statistics.median(ratios), min(ratios), max(ratios)
    print(f"    open / closed: median {middle:.3f} of {count} pairs, {least:.3f} to {most:.3f}")


def cost(driver: Any, folder: Path, options: argparse.Namespace) -> None:
    """What an open page costs the daemon."""
    with detector(baseline_file(folder, options.rate)) as (child, port, url):
        span_s = 2 * options.pairs * 2 * (options.seconds + REST_S + 3.0) + SETTLE_S + 60.0
        flown = ["--out", f"udpout:127.0.0.1:{port}", "--duration", f"{span_s:.0f}", "--rate", str(options.rate)]
        plant = subprocess.Popen(
            [sys.executable, "-m", "sitl_plant", "run", *flown, "--json"], stdout=subprocess.DEVNULL
        )
        time.sleep(SETTLE_S)
        pids = [child.pid, server_of(child.pid)]
        try:
            print(f"  Chromium, {options.rate} Hz")
            pairs(pids, options.pairs, options.seconds, lambda: driver.get(url), lambda: driver.get("about:blank"))
            print("  a reader that draws nothing")
            looking: list[subprocess.Popen[bytes]] = []

            def shut() -> None:
                while looking:
                    looking[-1].kill()
                    looking.pop().wait()

            def look() -> None:
                shut()
                looking.append(subprocess.Popen([sys.executable, "-c", READER, url], stderr=subprocess.DEVNULL))

            pairs(pids, options.pairs, options.seconds, look, shut)
        finally:
            plant.terminate()
            plant.wait(20.0)


class Deaf:
    """In place of the server; lines go nowhere. says: what it has to say, once."""

    where = ""

    def __init__(self, *says: str) -> None:
        self._says = list(says)

    def look(self, now: Instant) -> tuple[bool, list[str]]:
        """What it has to say."""
        said, self._says = self._says, []
        return False, said

    def put(self, data: bytes) -> bool:
        """There is always room."""
        return True

    def close(self) -> None:
        """Nothing."""


class TimedFeed(Feed):
    """spent_ns: processor time of its looks."""

    spent_ns = 0

    def look(self, fleet: Fleet, turns: Sequence[Turn], now: Instant) -> None:
        """As `Feed`."""
        since_ns = time.thread_time_ns()
        super().look(fleet, turns, now)
        self.spent_ns += time.thread_time_ns() - since_ns


def own_share(folder: Path, rate: int) -> None:
    """What the daemon itself does for a page, of all that it does: one flight on a virtual clock."""
    frames = frames_of(record(folder / "flight.tlog", rate, 60.0, "--seed", "5"))
    shut, looked = _share(folder, frames), _share(folder, frames, "watch 1")
    print(f"    the page's share of the daemon's processor time: {100 * looked:.1f} %, closed {100 * shut:.1f} %")


def _share(folder: Path, frames: list[tuple[float, int, bytes]], *says: str) -> float:
    feed, spent_ns = TimedFeed(cast(ServerProcess, Deaf(*says)), Instant(START_NS)), 0
    baseline = Baseline.load(folder / "baseline.json")
    bench = Bench(Settings(connect="udpin:127.0.0.1:0", baseline=folder / "baseline.json"), baseline, web=feed)
    at = 0
    for tick in range(1, round(60.0 / TICK_S)):
        while at < len(frames) and frames[at][0] < tick * TICK_S:
            bench.far.send(frames[at][2])
            at += 1
        bench.host.sleep(TICK_S)
        since_ns = time.thread_time_ns()
        bench.daemon.tick()
        spent_ns += time.thread_time_ns() - since_ns
    bench.close()
    return feed.spent_ns / spent_ns


def fly(far: Any, vehicle: MadeVehicle, done: Callable[[str], bool], limit_s: float) -> tuple[str, float] | None:
    """Fly in real time until a text will do: the text, and when it came [ms, wall clock]."""
    decoder, give_up = Decoder({MessageId.STATUSTEXT}), time.monotonic() + limit_s
    while time.monotonic() < give_up:
        for sent in vehicle.samples(2):
            far.send(sent)
        until = time.monotonic() + 0.02
        while (left_s := until - time.monotonic()) > 0:
            for data, host_ns in far.receive(left_s):
                for frame in decoder.feed(data, host_ns):
                    if done(text := frame.text("text")):
                        return text, 1000.0 * (time.time() - (time.monotonic_ns() - host_ns) / 1e9)
    return None


def alerts(driver: Any, folder: Path, count: int) -> None:
    """How soon alerts are on the page."""
    path, vehicle, delays = folder / "made.json", MadeVehicle(1), list[float]()
    baseline_for().save(path)
    with detector(path) as (_, port, url), open_endpoint(f"udpout:127.0.0.1:{port}") as far:
        driver.get(url)
        fly(far, vehicle, lambda text: "PROP monitoring" in text, 20.0)
        fly(far, vehicle, lambda text: False, 8.0)
        for _ in range(count):
            driver.execute_script("document.querySelectorAll('#list li').forEach((one) => { one.dataset.old = 1 })")
            vehicle.turning = 0.5
            found = fly(far, vehicle, lambda text: "FAULT" in text or "seen again" in text, 20.0)
            if found is None:
                print("    no text came; is the machine too slow?")
                return
            vehicle.turning = 0.0
            fly(far, vehicle, lambda text: "no longer seen" in text, 20.0)
            shown = driver.execute_script(
                """return [...document.querySelectorAll('#list li:not([data-old])')]
                    .filter((one) => one.querySelector('.words').textContent === arguments[0])
                    .map((one) => Number(one.dataset.painted || one.dataset.shown))""",
                found[0],
            )
            delays += [min(shown) - found[1]] if shown else [float("inf")]
            fly(far, vehicle, lambda text: False, 3.0)
    ordered = sorted(delays)
    print(
        f"    STATUSTEXT to page: median {statistics.median(ordered):.0f} ms, longest {ordered[-1]:.0f} ms of {count}"
    )


def burst(driver: Any) -> None:
    """The longest frame while 1,000 events come at once, and without."""
    script = """window.longest = 0; let before = performance.now();
        const one = (at) => { longest = Math.max(longest, at - before); before = at; requestAnimationFrame(one); };
        requestAnimationFrame(one)"""
    with serving() as process:
        driver.get(process.place.url)
        time.sleep(1.0)
        driver.execute_script(script)
        time.sleep(2.0)
        still = driver.execute_script("const was = longest; longest = 0; return was")
        entry = '{"kind":"text","utc":"2026-05-01T10:00:00Z","vehicle":1,"severity":4,"text":"PROP event %d"}'
        since = time.monotonic()
        give(process, "".join(f"J {k} {entry % k}\n" for k in range(1, 1001)).rstrip("\n"))
        while driver.execute_script("return mavdiag.last") < 1000:
            time.sleep(0.01)
        all_s = time.monotonic() - since
        time.sleep(0.5)
        busy = driver.execute_script("return longest")
        rows = driver.execute_script("return document.querySelectorAll('#list li').length")
    print(f"    1,000 events: all shown after {1000 * all_s:.0f} ms, in a list of {rows}")
    print(f"    longest frame meanwhile {busy:.0f} ms, before {still:.0f} ms")


def main() -> None:
    """Run all and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=int, default=1000)
    parser.add_argument("--alerts", type=int, default=10)
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, Python {sys.version.split()[0]}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with browser(folder / "profile") as driver:
            print("alerts")
            alerts(driver, folder, options.alerts)
            print("many events")
            burst(driver)
            print("processor time")
            cost(driver, folder, options)
            print(f"  one flight on a virtual clock, {options.rate} Hz")
            own_share(folder, options.rate)


if __name__ == "__main__":
    main()
