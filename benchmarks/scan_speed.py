"""How many rows a second a decoded log is judged with, all eleven monitors, and how much memory that takes.

    python benchmarks/scan_speed.py [--repeats 3] [--seed 99] [--json FILE]

Two flights of the emulator, decoded beforehand: 10 minutes at 1 kHz, and 5 minutes at 100 Hz as an archive has
thousands of. The emulated vehicle sends no VIBRATION at these rates, so that message is made up at 10 Hz and all
monitors judge. The time is processor time of this process. The peer in the same run is the work that no chain can
avoid: the Savitzky-Golay filters and one free-run model by scipy, over the flight at once.
"""

import argparse
import json
import platform
import resource
import statistics
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from chain_speed import STAMP, peer_seconds

from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline
from mavdiag.judging import judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import Log, Series, Signal, Telemetry
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.plant import PlantConfig

FLIGHTS = ((1000.0, 600.0), (100.0, 300.0))  # rate [Hz], length [s]
LEARN_FLIGHTS, LEARN_S = 5, 40.0
VIBRATION_EVERY_S = 0.1
MIB = 2**20


@dataclass(frozen=True, slots=True)
class Speed:
    """What one flight took.

    rows: of the gyro. monitors: that judged. rows_per_s: by processor time. peer_ratio: time over the peer's.
    added_mib: most memory that judging held beside the log [MiB], as Python counts it.
    """

    rate_hz: float
    rows: int
    monitors: int
    verdict: str
    seconds: float
    rows_per_s: float
    us_per_row: float
    peer_ratio: float
    added_mib: float


def flown(seed: int, rate_hz: float, duration_s: float) -> Log:
    """A healthy flight with every signal that a monitor may want."""
    telemetry, _ = flight_telemetry(PlantConfig(seed=seed), duration_s, LinkSpec(rate_hz=rate_hz))
    gyro = telemetry.need(Signal.BODY_RATE)
    every = max(1, round(VIBRATION_EVERY_S * rate_hz))
    t_ns, host_ns = gyro.t_ns[::every], gyro.host_ns[::every]
    shaking = np.abs(np.random.default_rng(seed).normal(0.0, [2.0, 2.0, 3.0], (len(t_ns), 3)))
    telemetry = Telemetry((*telemetry.series, Series(Signal.VIBRATION, t_ns, host_ns, shaking)))
    return Log(f"emulated seed {seed}", telemetry.digest, "qdrone2", telemetry)


def taught(rate_hz: float) -> Baseline:
    """A baseline of all monitors."""
    flights = [flown(seed, rate_hz, LEARN_S) for seed in range(LEARN_FLIGHTS)]
    return learn(flights, LearnOptions(airframe=airframe_named("qdrone2")), created=STAMP)


def judged(log: Log, baseline: Baseline) -> float:
    """Processor time of one judgement [s]."""
    started = time.process_time()
    judge(log, baseline)
    return time.process_time() - started


def added_mib(log: Log, baseline: Baseline) -> float:
    """Most memory that is held while judging [MiB]; the log itself is not counted."""
    tracemalloc.start()
    judge(log, baseline)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most / MIB


def median(repeats: int, run: Callable[[], float]) -> float:
    """Median of the runs."""
    return statistics.median(run() for _ in range(repeats))


def measured(seed: int, rate_hz: float, duration_s: float, repeats: int) -> Speed:
    """Judge one flight."""
    baseline, log = taught(rate_hz), flown(seed, rate_hz, duration_s)
    verdict = judge(log, baseline)
    seconds = median(repeats, partial(judged, log, baseline))
    peer = median(repeats, partial(peer_seconds, baseline, log.telemetry))
    rows = len(log.telemetry.need(Signal.BODY_RATE))
    return Speed(
        rate_hz,
        rows,
        sum(one.judged_s > 0 for one in verdict.monitors),
        verdict.verdict.value,
        seconds,
        rows / seconds,
        1e6 * seconds / rows,
        seconds / peer,
        added_mib(log, baseline),
    )


def main() -> None:
    """Print rows a second of each flight."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=99)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    found = [measured(arguments.seed, rate_hz, span_s, arguments.repeats) for rate_hz, span_s in FLIGHTS]
    for one in found:
        print(
            f"{one.rate_hz:.0f} Hz, {one.rows} rows, {one.monitors} monitors, {one.verdict}: "
            f"{1e-6 * one.rows_per_s:.3f} M rows/s, {one.us_per_row:.2f} us a row, "
            f"{one.peer_ratio:.1f} x the peer, {one.added_mib:.0f} MiB"
        )
    print(f"most memory of the process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")
    if arguments.json:
        machine = {"machine": platform.machine(), "python": platform.python_version(), "numpy": np.__version__}
        arguments.json.write_text(json.dumps({**machine, "speeds": [asdict(one) for one in found]}, indent=2) + "\n")


if __name__ == "__main__":
    main()
