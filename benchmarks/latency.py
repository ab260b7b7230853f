"""How long one step of the live chain takes, by percentiles: `python benchmarks/latency.py [--seconds 30]`.

An emulated flight at 1 kHz goes through the chain of all monitors in blocks of 40 ms, as a live link brings it. Each
step is timed by the wall clock of this process. The steps that bring a look of the decision (every 0.1 s) are the slow
ones; a step that takes longer than its block cannot keep up.

Then the whole daemon on a virtual clock, over three kinds of links: from the arrival of the first gyro sample of each
turn, which waits for the longest, until it is judged. Work takes no time on that clock.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from chain_speed import STAMP, blocks
from emulated import as_flight
from made_vehicle import Bench
from virtual_flight import VirtualFlight, healthy_flights, learnt

from detector.config import Settings
from detector.fleet import Vehicle
from mavdiag.airframe.load import airframe_named
from mavdiag.chain import chain_of
from mavdiag.learning import LearnOptions, learn
from mavdiag.units import NS_PER_S
from sitl_plant.plant import PlantConfig

BLOCK_S = 0.04


def through_the_daemon(profile: str, seconds: float) -> list[float]:
    """From the first sample of each turn to its verdict [ms], on a virtual clock."""
    found, wait = list[float](), Vehicle.wait

    def noted(*asked: Any) -> float | None:
        latency_s = wait(*asked)
        found.extend(() if latency_s is None else (1e3 * latency_s,))
        return latency_s

    settings = Settings(connect="udpin:127.0.0.1:0", baseline=Path("baseline.json"))
    bench = Bench(settings, baseline=learnt(healthy_flights(range(3), 40.0, profile)))
    with patch.object(Vehicle, "wait", noted):
        VirtualFlight(bench).fly(PlantConfig(seed=9), seconds, profile)
    bench.close()
    return found


def main() -> None:
    """Print percentiles of the steps' times, and of the way through the daemon."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    arguments = parser.parse_args()
    flights = [as_flight(PlantConfig(seed=seed), 30.0) for seed in range(4)]
    telemetry = as_flight(PlantConfig(seed=99), arguments.seconds).telemetry
    chain = chain_of(learn(flights, LearnOptions(airframe=airframe_named("qdrone2")), created=STAMP))
    start = min(int(series.host_ns[0]) for series in telemetry)
    stop = max(int(series.host_ns[-1]) for series in telemetry)
    pieces = blocks(telemetry, np.arange(start, stop + 1, round(BLOCK_S * NS_PER_S)))
    for counts in (False, True):  # the first round loads compiled code
        state, times = chain.start(), []
        for piece in pieces:
            begun = time.perf_counter()
            chain.step(state, piece)
            times.append(1e3 * (time.perf_counter() - begun))
        if counts:
            shares = np.percentile(times, (50, 90, 99))
            print(f"{len(times)} steps of {1e3 * BLOCK_S:.0f} ms of flight at 1 kHz; percentiles of their times [ms]:")
            print(f"50 %: {shares[0]:.2f}, 90 %: {shares[1]:.2f}, 99 %: {shares[2]:.2f}, longest: {max(times):.2f}")
    for profile in ("ardupilot", "px4", "qdrone2"):
        waits = through_the_daemon(profile, arguments.seconds)
        shares = np.percentile(waits, (50, 90, 99))
        print(f"sample to verdict through the daemon, profile {profile}, {len(waits)} turns on a virtual clock [ms]:")
        print(f"50 %: {shares[0]:.0f}, 90 %: {shares[1]:.0f}, 99 %: {shares[2]:.0f}, longest: {max(waits):.0f}")


if __name__ == "__main__":
    main()
