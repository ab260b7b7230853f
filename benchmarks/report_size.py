"""Size and cost of a report's page, short flight against long: `python benchmarks/report_size.py [MINUTES]`.

Emulated QDrone 2 at 1 kHz, seed 20; the baseline is of three flights of 40 s, seeds 1 to 3. Drawing is what a report
takes of processor time beyond judging the same flight. Memory is the highest so far of the whole process: of the flight
itself as telemetry, and of what was added by its report.
"""

import resource
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline
from mavdiag.judging import judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.report.page import flight_report, flights_page
from mavdiag.telemetry import Log
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.plant import PlantConfig

CREATED = "2026-01-01T00:00:00+00:00"
SHORT_S, SEED, HEALTHY = 40.0, 20, (1, 2, 3)
MB = 1e6

Found = TypeVar("Found")


def fly(seed: int, seconds: float) -> Log:
    """One healthy flight."""
    telemetry, _ = flight_telemetry(PlantConfig(seed=seed), seconds, LinkSpec("qdrone2"))
    return Log(f"seed {seed}", telemetry.digest, "qdrone2", telemetry)


def timed(work: Callable[[], Found]) -> tuple[Found, float]:
    """What it gives, and its processor time [s]."""
    start = time.process_time()
    return work(), time.process_time() - start


def memory_mb() -> float:
    """The most that this process has used."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def page_of(log: Log, baseline: Baseline) -> str:
    """The page of one flight, judged on the way."""
    return flights_page([flight_report(log, baseline)], baseline, "baseline.json", CREATED)


def main() -> None:
    """Print the table."""
    minutes = float(sys.argv[1]) if len(sys.argv) > 1 else 30.0
    baseline = learn(
        [fly(seed, SHORT_S) for seed in HEALTHY], LearnOptions(airframe=airframe_named("qdrone2")), created=CREATED
    )
    page_of(fly(SEED, SHORT_S), baseline)  # loads what is loaded once
    for seconds in (SHORT_S, 60.0 * minutes):
        flight = fly(SEED, seconds)
        _, judging_s = timed(partial(judge, flight, baseline))
        before = memory_mb()
        page, both_s = timed(partial(page_of, flight, baseline))
        print(
            f"{seconds:6.0f} s of flight at 1 kHz: page {len(page.encode()) / MB:.2f} MB, drawing "
            f"{both_s - judging_s:.1f} s of processor time, judging {judging_s:.1f} s"
        )
        print(f"highest memory before the report {before:.0f} MB, after it {memory_mb():.0f} MB")


if __name__ == "__main__":
    main()
