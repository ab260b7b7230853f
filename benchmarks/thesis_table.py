"""The thesis's result on the emulator: FSD and margin of nine faults (T Fig 5.9, 5.10, Table 5.2).

    python benchmarks/thesis_table.py [--trials 20] [--phenomenology 1] [--seed 0]

Protocol of T 4.4: drones 2 and 3 train the model; the three drones' healthy flights set margin and FML; drone 1 flies
every fault on rotor 1. Each trial has its own seeds; within a trial the same four flights are flown with every fault,
as the thesis repeats one trajectory, or other ones with --unpaired. A trial holds if, on means of four flights, every
fault's FSD is above the FML, F1 has the lowest margins and the shortest FSDs, F2 the highest and longest, and F3's
margin grows with severity.
"""

import argparse
import multiprocessing
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from emulated import as_flight
from rich.console import Console
from rich.table import Table

from mavdiag.identify import ArxModel, fit
from mavdiag.learning import LearntFlight, airborne, front_for
from mavdiag.monitors.run_length import longest_runs, margin_of, residuals, runs, training_pieces
from mavdiag.telemetry import Axis, FloatArray
from sitl_plant.plant import PlantConfig

FAULTS = tuple(f"F{kind}/SV{severity}" for kind in (1, 2, 3) for severity in (1, 2, 3))
FLIGHTS_PER_FAULT = 4
FLIGHT_S = 40.0
WINDOW_S = 0.1


@dataclass(frozen=True, slots=True)
class Trial:
    """fsd_s, margin_rad_s: (9, 4) per fault and flight; above is the highest |r| - margin during the longest run."""

    margin_rad_s: float
    fml_s: float
    fsd_s: FloatArray
    peak_rad_s: FloatArray


def flight(drone: int, seed: int, fault: str | None = None, phenomenology: float = 1.0) -> LearntFlight:
    """One flight's rows of rates."""
    made = as_flight(PlantConfig(drone=drone, fault=fault, phenomenology=phenomenology, seed=seed), FLIGHT_S)
    return airborne(front_for([made], WINDOW_S), made)


def longest(one: LearntFlight, model: ArxModel, margin: float) -> tuple[float, float]:
    """FSD [s] and peak above the margin [rad/s] of the longest run of a flight."""
    found = [run for piece in residuals(one.rows, Axis.ROLL, model) for run in runs(piece, margin)]
    worst = max(found, key=lambda run: run.fsd_s, default=None)
    return (0.0, 0.0) if worst is None else (worst.fsd_s, worst.peak)


def trial(number: int, *, seed: int, phenomenology: float, unpaired: bool) -> Trial:
    """One repetition of the whole experiment, with seeds of its own."""
    base = 10_000 * seed + 100 * number
    healthy = [flight(drone, base + drone) for drone in (1, 2, 3)]
    pieces = [piece for one in healthy[1:] for piece in training_pieces(one.rows, Axis.ROLL)]
    model = fit([u for u, _ in pieces], [y for _, y in pieces], dt=0.001)
    unexplained = [residuals(one.rows, Axis.ROLL, model) for one in healthy]
    margin = margin_of(unexplained)
    fml = float(longest_runs(unexplained, margin).max())
    figures = np.array(
        [
            [
                longest(flight(1, base + 10 + k + (4 * i if unpaired else 0), code, phenomenology), model, margin)
                for k in range(FLIGHTS_PER_FAULT)
            ]
            for i, code in enumerate(FAULTS)
        ]
    )
    return Trial(margin, fml, figures[:, :, 0], figures[:, :, 1])


def claims(one: Trial) -> dict[str, bool]:
    """What the thesis claims, on means of the four flights."""
    fsd, peak = one.fsd_s.mean(axis=1), one.peak_rad_s.mean(axis=1)
    return {
        "all nine FSD > FML": bool((fsd > one.fml_s).all()),
        "F1 margin lowest": bool(peak[:3].mean() < min(peak[3:6].mean(), peak[6:].mean())),
        "F1 FSD shortest": bool(fsd[:3].mean() < min(fsd[3:6].mean(), fsd[6:].mean())),
        "F2 margin highest": bool(peak[3:6].mean() > max(peak[:3].mean(), peak[6:].mean())),
        "F2 FSD longest": bool(fsd[3:6].mean() > max(fsd[:3].mean(), fsd[6:].mean())),
        "F3 margin grows with severity": bool(peak[6] < peak[7] < peak[8]),
    }


def report(console: Console, trials: Sequence[Trial], phenomenology: float) -> None:
    """Print the table and how often each claim held."""
    table = Table(title=f"phenomenology {phenomenology:g}, {len(trials)} trials of {FLIGHTS_PER_FAULT} flights a fault")
    for heading in (
        "fault",
        "FSD s (mean)",
        "5 %",
        "95 %",
        "FSD > FML, flights",
        "max margin rad/s (mean)",
        "5 %",
        "95 %",
    ):
        table.add_column(heading, justify="right")
    fml = np.array([one.fml_s for one in trials])
    for i, code in enumerate(FAULTS):
        fsd = np.stack([one.fsd_s[i] for one in trials])
        peak = np.stack([one.peak_rad_s[i] for one in trials])
        found = float((fsd > fml[:, None]).mean())
        low, high = np.percentile(fsd.mean(axis=1), [5, 95])
        peak_low, peak_high = np.percentile(peak.mean(axis=1), [5, 95])
        table.add_row(
            code, f"{fsd.mean():.3f}", f"{low:.3f}", f"{high:.3f}", f"{100 * found:.0f} %",
            f"{peak.mean():.4f}", f"{peak_low:.4f}", f"{peak_high:.4f}",
        )  # fmt: skip
    console.print(table)
    margin = np.mean([one.margin_rad_s for one in trials])
    console.print(
        f"healthy: margin {margin:.4f} rad/s (mean), FML {fml.mean():.3f} s (mean; {fml.min():.3f} to {fml.max():.3f})"
    )
    held = [claims(one) for one in trials]
    for name in held[0]:
        console.print(f"{name}: {sum(one[name] for one in held)} of {len(held)} trials")
    console.print(f"all of these: {sum(all(one.values()) for one in held)} of {len(held)} trials")


def main() -> None:
    """Run the trials on all cores and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--phenomenology", type=float, nargs="+", default=[1.0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--unpaired", action="store_true", help="other seeds for every fault")
    parser.add_argument("--workers", type=int, default=None)
    arguments = parser.parse_args()
    console = Console(width=140)
    with multiprocessing.get_context("spawn").Pool(arguments.workers) as pool:
        for scale in arguments.phenomenology:
            one = partial(trial, seed=arguments.seed, phenomenology=scale, unpaired=arguments.unpaired)
            report(console, pool.map(one, range(arguments.trials), chunksize=1), scale)


if __name__ == "__main__":
    main()
