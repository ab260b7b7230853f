"""The price of the longest healthy run: how often does one more healthy flight beat the FML of n?

    python benchmarks/false_alarm_law.py [--flights 1640] [--seed 0]

Healthy flights of drone 1, all different seeds; model and margin come from other flights. Each flight is held against
the FML of the n before it: an alarm if its longest run is longer. Theory says 1/(n + 1), whatever the airframe, because
equal flights are exchangeable. Printed beside: the same over groups of n + 1 that share no flight, which are few.
"""

import argparse
import multiprocessing
from functools import partial

import numpy as np
from emulated import as_flight
from thesis_runs import longest_runs, residuals

from mavdiag.baseline import Baseline, dump, parse
from mavdiag.chain import front_of
from mavdiag.learning import learn, rows_of, thesis_options
from mavdiag.telemetry import Axis
from sitl_plant.plant import PlantConfig

FLIGHT_S = 12.0
TEACHING = 8
GROUPS = (3, 10, 40)


def longest_run(seed: int, text: str) -> float:
    """Longest run above the margin in one healthy flight [s]."""
    baseline = parse(text)
    rows = rows_of(front_of(baseline), as_flight(PlantConfig(drone=1, seed=seed), FLIGHT_S).telemetry)
    spec = baseline.monitors[0].spec
    return float(longest_runs([residuals(rows, Axis.ROLL, spec.model.model())], spec.margin_rad_s)[0])


def teach(seed: int) -> Baseline:
    """Model and margin from flights that are not judged."""
    flights = [as_flight(PlantConfig(drone=1, seed=seed + i), FLIGHT_S) for i in range(TEACHING)]
    return learn(flights, thesis_options(), created="1970-01-01T00:00:00+00:00")


def main() -> None:
    """Print the rate of each group size beside the law."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=1640)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    text = dump(teach(100_000 + arguments.seed))
    seeds = range(200_000 + arguments.seed, 200_000 + arguments.seed + arguments.flights)
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        runs = np.array(pool.map(partial(longest_run, text=text), seeds, chunksize=20))
    for n in GROUPS:
        windows = np.lib.stride_tricks.sliding_window_view(runs, n + 1)
        apart = windows[:: n + 1]
        rate, alone = (float((w[:, -1] > w[:, :-1].max(axis=1)).mean()) for w in (windows, apart))
        own = f"{alone:.3f} of {len(apart)} groups"
        print(f"n = {n:2d}: {rate:.3f} of {len(windows)} flights, law {1 / (n + 1):.3f}; {own}")


if __name__ == "__main__":
    main()
