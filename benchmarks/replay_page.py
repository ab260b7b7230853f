"""A replay in Chromium: how long a log takes to be judged, how far the page is behind, and how soon a jump is shown.

    python benchmarks/replay_page.py [LOG BASELINE] [--speed 10] [--jumps 20]

Without a log it is a made flight of 10 minutes at 100 Hz with one monitor. Behind: where the replay ought to be by the
clock, less the newest point that the page has drawn, in seconds of the clock. A jump takes from the slider's move to a
page that draws that time; half of the jumps come while the log is played. Seed: the vehicle's.
"""

import argparse
import random
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from made_session import baseline_for
from made_vehicle import record
from web_page import browser, wait_for

AT = "return (mavdiag.traces.get('roll')?.newest() ?? 0) * 0.05 - (mavdiag.playing?.begin_s ?? 0)"
MOVE = "const one = document.getElementById('scrub'); one.value = {}; one.dispatchEvent(new Event('input'))"


def main() -> None:
    """Play, jump, print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("log", nargs="*", type=Path)
    parser.add_argument("--speed", type=float, default=10.0)
    parser.add_argument("--jumps", type=int, default=20)
    given, rng = parser.parse_args(), random.Random(0)
    with tempfile.TemporaryDirectory() as kept:
        log, baseline = given.log or (Path(kept, "flight.tlog"), Path(kept, "b.json"))
        if not given.log:
            record(log, ((60.0, 0.0), (20.0, 0.5), (520.0, 0.0)))
            baseline_for().save(baseline)
        command = ["replay", str(log), "--baseline", str(baseline), "--web", "0", "--speed", str(given.speed)]
        with (
            subprocess.Popen([sys.executable, "-m", "mavdiag", *command], stdout=subprocess.PIPE, text=True) as child,
            browser(Path(kept, "profile")) as chromium,
        ):
            assert child.stdout is not None
            chromium.get(child.stdout.readline().split(" on ")[1].split(";")[0])
            wait_for(lambda: chromium.execute_script(AT) > 1)
            from_s, since_s, behind_s = chromium.execute_script("return mavdiag.playing.at_s"), time.monotonic(), []
            while time.monotonic() - since_s < 20:
                time.sleep(0.1)
                due_s = from_s + given.speed * (time.monotonic() - since_s)
                behind_s.append((due_s - chromium.execute_script(AT)) / given.speed)
            print(
                f"behind at {given.speed:g} x: median {statistics.median(behind_s):.2f} s, most {max(behind_s):.2f} s"
            )
            wait_for(lambda: chromium.execute_script("return mavdiag.playing.done"), "all is judged")
            span_s, took_s = chromium.execute_script("return mavdiag.playing.span_s"), list[float]()
            for number in range(given.jumps):
                if number == given.jumps // 2:
                    chromium.execute_script("document.getElementById('play').click()")
                to_s, since_s = rng.uniform(20, span_s - 40), time.monotonic()
                chromium.execute_script(MOVE.format(to_s))
                there = AT.replace("return", "const at =")
                while not chromium.execute_script(f"{there}; return at > {to_s} - 1 && at < {to_s} + 15"):
                    time.sleep(0.01)
                took_s.append(time.monotonic() - since_s)
            print(f"jump: median {statistics.median(took_s):.2f} s, most {max(took_s):.2f} s of {len(took_s)}")
            child.terminate()


if __name__ == "__main__":
    main()
