"""A fleet, one daemon, one page, one history: are all faults told, how soon is the page there, is the history complete?

    python benchmarks/fleet.py [--vehicles 20] [--faulty 5] [--seconds 45] [--rate 50] [--wait 600]

`sitl-plant fleet` takes off, flies and lands; the first `--faulty` vehicles crack a propeller in flight. The daemon
judges all by one baseline of the type. The page's answer is timed once a second, and so is how old the figures of all
vehicles are when a reader of its stream gets them. After the landing the history is
read until it is complete, for --wait seconds at most.
"""

import argparse
import itertools
import json
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from dataclasses import replace
from pathlib import Path

from mavdiag.airframe.load import airframe_named
from mavdiag.errors import MavdiagError
from mavdiag.history.store import open_history
from mavdiag.learning import LearnOptions, learn
from mavdiag.logs.tlog import read_tlog

TEACH_S = 40


def baseline_file(folder: Path, options: argparse.Namespace) -> Path:
    """A baseline of the type, by four flights."""
    paths = [folder / f"healthy-{number}.tlog" for number in range(4)]
    for number, path in enumerate(paths):
        plant = [sys.executable, "-m", "sitl_plant", "record", "-o", str(path), "--profile", "ardupilot", "--takeoff"]
        plant += ["--rate", str(options.rate), "--duration", str(TEACH_S), "--seed", str(100 + number)]
        subprocess.run(plant, check=True, capture_output=True)
    airframe = replace(airframe_named("qdrone2"), scope="type")
    baseline = learn(
        (read_tlog(path) for path in paths), LearnOptions(airframe=airframe), created="2026-01-01T00:00:00Z"
    )
    baseline.save(folder / "baseline.json")
    return folder / "baseline.json"


def read_page(url: str, ended: threading.Event, answers_s: list[float], fleets: list[tuple[float, int]]) -> None:
    """Ask for the page once a second, and note when the stream told of the fleet, and of how many vehicles."""

    def follow() -> None:
        with urllib.request.urlopen(f"{url}stream?vehicle=1", timeout=30) as stream:
            kind = b""
            for line in stream:
                if line.startswith(b"event:"):
                    kind = line.split(b":", 1)[1].strip()
                elif line.startswith(b"data:") and kind == b"fleet":
                    fleets.append((time.monotonic(), len(json.loads(line[5:])["vehicles"])))
                if ended.is_set():
                    return

    threading.Thread(target=follow, daemon=True).start()
    while not ended.wait(1.0):
        began = time.monotonic()
        with urllib.request.urlopen(url, timeout=30) as page:
            page.read()
        answers_s.append(time.monotonic() - began)


def recorded(database: Path) -> int:
    """How many flights the history has."""
    try:
        with open_history(str(database)) as history:
            return sum(len(history.flights(name)) for name in history.names())
    except MavdiagError:
        return 0


def main() -> None:
    """Run it and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("vehicles", 20), ("faulty", 5), ("seconds", 45), ("rate", 50), ("wait", 600)):
        parser.add_argument(f"--{name}", type=int, default=default)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, database = Path(name), Path(name, "history.sqlite")
        command = [sys.executable, "-m", "detector", "--connect", "udpin:127.0.0.1:0", "--web", "0", "--history"]
        command += [
            str(database),
            "--flights",
            str(folder / "flights"),
            "--baseline",
            str(baseline_file(folder, options)),
        ]
        with (folder / "detector.log").open("w+") as log:
            detector = subprocess.Popen(command, stderr=log)
            while not (found := re.findall(r"ready: udpin:[\d.]+:(\d+)[^~]*page: (\S+)", Path(log.name).read_text())):
                time.sleep(0.1)
            (port, url), ended, answers_s, fleets = (
                found[0],
                threading.Event(),
                list[float](),
                list[tuple[float, int]](),
            )
            threading.Thread(target=read_page, args=(url, ended, answers_s, fleets), daemon=True).start()
            faulty = set(range(1, options.faulty + 1))
            fleet = [sys.executable, "-m", "sitl_plant", "fleet", "-n", str(options.vehicles), "--profile", "ardupilot"]
            fleet += ["--rate", str(options.rate), "--takeoff", "--duration", str(options.seconds), "--fault", "F2/SV2"]
            fleet += ["--onset", str(options.seconds // 2), "--faulty", ",".join(map(str, sorted(faulty)))]
            subprocess.run([*fleet, "--out", f"udpout:127.0.0.1:{port}"], check=True, capture_output=True)
            landed = time.monotonic()
            while recorded(database) < options.vehicles and time.monotonic() - landed < options.wait:
                time.sleep(0.5)
            complete_s = time.monotonic() - landed
            ended.set()
            detector.terminate()
            detector.wait()
        lines = Path(log.name).read_text().splitlines()
        told = {int(one) for line in lines for one in re.findall(r"vehicle (\d+): decision: fault", line)}
        gaps = [b - a for (a, _), (b, _) in itertools.pairwise(fleets)]
        print(f"{options.vehicles} vehicles at {options.rate} Hz, {options.faulty} crack at {options.seconds // 2} s")
        print(f"  told {len(told & faulty)} of {len(faulty)} faults, {len(told - faulty)} of the others")
        print(f"  page in {1e3 * statistics.median(answers_s):.0f} ms, {1e3 * max(answers_s):.0f} at most; all of "
              f"up to {max(count for _, count in fleets)} vehicles told anew within {max(gaps):.2f} s")  # fmt: skip
        print(
            f"  history: {recorded(database)} of {options.vehicles} flights, {complete_s:.0f} s after the last landing"
        )
        print(f"  {lines[-1].rpartition('; ')[2]}")
        print("\n".join(f"  said: {line}" for line in lines if "much to do" in line or "history" in line))


if __name__ == "__main__":
    main()
