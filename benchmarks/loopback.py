"""The main job in real time over MAVLink UDP: nine faults, and healthy flight, by the thesis rule.

    python benchmarks/loopback.py [--healthy-flights 20] [--healthy-minutes 10] [--seed 0] [--at-once 2]

FML is the maximum of the healthy flights (fast-recorded, drone 1). Each fault on rotor 1 sets in at 10 s of its flight
and must be alerted over MAVLink within 60 s. Then drone 1 flies ten minutes of healthy flights, as long as those that
FML comes from; the alarmed ones stand beside the 1/(n+1) that the rule costs per equal flight. The detector's CPU
share and the datagrams it lost are its own report.
"""

import argparse
import re
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table

from mavdiag.commands.identify import make_baseline
from mavdiag.demo.subprocesses import POLL_S, DemoResult, Flight, closed_loop, run_child
from mavdiag.learning import thesis_options

FAULTS = tuple(f"F{kind}/SV{severity}" for kind in (1, 2, 3) for severity in (1, 2, 3))
ONSET_S, WITHIN_S = 10.0, 60.0
HEALTHY_FLIGHT_S = 40.0


@dataclass(frozen=True, slots=True)
class Result:
    """One flight. cpu: the detector's share of a core in percent; lost: datagrams that it did not read in time."""

    outcome: DemoResult
    cpu: float
    lost: int


def learn(folder: Path, flights: int, seed: int) -> Path:
    """A baseline from fast-recorded healthy flights."""
    run_child(
        "sitl_plant", "record", "-o", str(folder / "h.tlog"), "--flights", str(flights), "--seed", str(seed),
        "--duration", f"{HEALTHY_FLIGHT_S:g}",
    )  # fmt: skip
    path = folder / "baseline.json"
    make_baseline(sorted(folder.glob("*.tlog")), thesis_options()).save(path)
    return path


def fly(flight: Flight, baseline: Path) -> Result:
    """One flight in real time; a fault's ends when it is alerted."""
    with closed_loop(flight, baseline) as (plant, detector, station):
        while plant.running:
            station.listen(POLL_S)
            if flight.fault and DemoResult.of(flight.onset_s, station.texts).detected_s is not None:
                break
        plant.end()
        station.listen(POLL_S)
        detector.end()
        printed = " ".join(detector.lines)
    cpu, lost = re.search(r"([\d.]+) % CPU", printed), re.search(r"(\d+) datagrams overflowed", printed)
    return Result(
        DemoResult.of(flight.onset_s, station.texts),
        float(cpu[1]) if cpu else float("nan"),
        int(lost[1]) if lost else -1,
    )


def main() -> None:
    """Learn, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--healthy-flights", type=int, default=20)
    parser.add_argument("--healthy-minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--at-once", type=int, default=2)
    arguments = parser.parse_args()
    flights = [Flight(ONSET_S + WITHIN_S, code, 1, ONSET_S, 500 + arguments.seed + i) for i, code in enumerate(FAULTS)]
    count = round(60 * arguments.healthy_minutes / HEALTHY_FLIGHT_S)
    healthy = [Flight(HEALTHY_FLIGHT_S, seed=900 + arguments.seed + i) for i in range(count)]
    table = Table(title=f"loopback at 1 kHz, FML from {arguments.healthy_flights} healthy flights")
    for heading in ("flight", "alerted after s", "alarms before onset", "detector CPU %", "datagrams lost"):
        table.add_column(heading, justify="right")
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(arguments.at_once) as pool:
        baseline = learn(Path(folder), arguments.healthy_flights, 100 + arguments.seed)
        results = list(pool.map(partial(fly, baseline=baseline), [*flights, *healthy]))
    for flight, result in zip(flights, results[: len(flights)], strict=True):
        found = result.outcome.detected_s
        latency = "missed" if found is None else f"{found - flight.onset_s:.2f}"
        table.add_row(flight.fault, latency, str(result.outcome.false_alarms), f"{result.cpu:.1f}", str(result.lost))
    console = Console(width=120)
    console.print(table)
    if rest := results[len(flights) :]:
        alarmed, expected = sum(bool(one.outcome.alerts) for one in rest), count / (arguments.healthy_flights + 1)
        flown = f"{count} flights of {HEALTHY_FLIGHT_S:g} s"
        console.print(f"healthy: {alarmed} of {flown} alarmed, {expected:.2f} expected")
        cpu, lost = max(one.cpu for one in rest), sum(one.lost for one in rest)
        console.print(f"detector in healthy flight: at most {cpu:.1f} % CPU, {lost} datagrams lost")


if __name__ == "__main__":
    main()
