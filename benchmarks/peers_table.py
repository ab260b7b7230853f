"""The families of T 1.3 beside this project's detectors, on one campaign of emulated flights.

    python benchmarks/peers_table.py [--quick] [--seed 0] [--airframes 4] [--only NAME]...     (group `bench`)

Every contender gets the same healthy flights of each fresh airframe (square, hover, circle, figure-8; wind 0 to 1.5
m/s; up to 0.2 kg of payload in every second flight), and, unless the table says otherwise, its threshold by one rule:
Gumbel on 10 s block maxima of flights that its fit did not see, for 0.05 alarms an hour. The network and the bank also
study faulty flights of other airframes, never of the judged one. Judged: other seeds, healthy flights for the false
alarms, and 30 s flights with one of the nine faults from second 10. The three scales of phenomenology fly the same
conditions.

They are small reference implementations with textbook settings, chosen once and not tuned on the judged flights.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
from peers.campaign import DEFAULT, QUICK, Catch, Tally, run
from peers.contender import Contender
from peers.flights import FAULTY_S, ONSET_S, PHENOMENOLOGIES
from peers.learned import neural_network
from peers.model_based import bank_of_models, fixed_threshold, kalman, sliding_mode
from peers.ours import product, thesis_rule
from peers.signal_based import fft_pca, wavelet
from rich.console import Console
from rich.table import Table
from scipy.stats import chi2

from mavdiag.thresholds.rule import ThresholdRule

CONTENDERS = (
    Contender("fixed threshold on |rate error|", fixed_threshold),
    Contender("Kalman innovation, chi-square", kalman),
    Contender("sliding-mode observer", sliding_mode, names_rotor=True),
    Contender("bank of models *", bank_of_models, needs_faults=True),
    Contender("FFT + PCA, accelerometer", fft_pca),
    Contender("wavelet energies, gyro", wavelet),
    Contender("neural network *", neural_network, needs_faults=True, names_rotor=True),
    Contender("thesis FSD, common rule", thesis_rule),
    Contender("thesis FSD > FML (longest healthy)", thesis_rule, rule=ThresholdRule.MAXIMUM),
    Contender("mavdiag, all its monitors", product, rule=None, names_rotor=True),
)
KINDS = ("F1", "F2", "F3")


def poisson_interval(events: int, hours: float) -> tuple[float, float]:
    """Exact 95 % limits of a rate [1/h] (Garwood, Biometrika 28 (1936) 437-442)."""
    low = float(chi2.ppf(0.025, 2 * events)) / 2.0 if events else 0.0
    return low / hours, float(chi2.ppf(0.975, 2 * events + 2)) / 2.0 / hours


def by_chance(tally: Tally) -> float:
    """How often false alarms alone would count as a detection."""
    return 1.0 - math.exp(-tally.false_alarms / tally.healthy_s * (FAULTY_S - ONSET_S))


def rate(catches: Sequence[Catch]) -> str:
    """Share found, in per cent."""
    return f"{100 * np.mean([one.latency_s is not None for one in catches]):.0f}"


def detection(tallies: Sequence[Tally], scale: float) -> Table:
    """Who finds which type, how soon, and who names the rotor."""
    flights = sum(one.truth.phenomenology == scale for one in tallies[0].catches)
    table = Table(title=f"phenomenology {scale:g}: found of {flights} faulty flights")
    table.add_column("method")
    for heading in (*(f"{kind} %" for kind in KINDS), "all %", "median latency s", "rotor right, % of found"):
        table.add_column(heading, justify="right")
    for tally in tallies:
        judged = [one for one in tally.catches if one.truth.phenomenology == scale]
        found = [one for one in judged if one.latency_s is not None]
        latency = [one.latency_s for one in found if one.latency_s is not None]
        named = f"{100 * np.mean([one.rotor == one.truth.rotor for one in found]):.0f}" if found else "-"
        table.add_row(
            tally.contender.name,
            *(rate([one for one in judged if one.truth.fault.startswith(kind)]) for kind in KINDS),
            rate(judged),
            f"{np.median(latency):.2f}" if latency else "-",
            named if tally.contender.names_rotor else "",
        )
    return table


def price(tallies: Sequence[Tally]) -> Table:
    """False alarms in healthy flight, and computing time."""
    table = Table(title=f"price: {tallies[0].healthy_s / 3600.0:.2f} h of healthy mixed flight; CPU time of this code")
    table.add_column("method")
    for heading in ("alarms", "alarms/h [95 %]", "found by chance %", "us a sample", "fit s, all airframes"):
        table.add_column(heading, justify="right")
    for tally in tallies:
        hours = tally.healthy_s / 3600.0
        low, high = poisson_interval(tally.false_alarms, hours)
        table.add_row(
            tally.contender.name,
            str(tally.false_alarms),
            f"{tally.false_alarms / hours:.1f} [{low:.1f}, {high:.1f}]",
            f"{100 * by_chance(tally):.1f}",
            f"{tally.microseconds:.2f}",
            f"{tally.fitting_s:.1f}",
        )
    return table


def main() -> None:
    """Fly, judge, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one airframe, under a minute")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--airframes", type=int, help="fresh airframes to judge")
    parser.add_argument("--only", action="append", help="contenders whose name contains this")
    arguments = parser.parse_args()
    size = QUICK if arguments.quick else DEFAULT
    if arguments.airframes:
        size = replace(size, airframes=arguments.airframes)
    wanted = arguments.only or [""]
    contenders = [one for one in CONTENDERS if any(part.lower() in one.name.lower() for part in wanted)]
    if not contenders:
        parser.error(f"no contender is called that; there are: {', '.join(one.name for one in CONTENDERS)}")
    needed = {neural_network: "sklearn", wavelet: "pywt"}
    if any(one.study in needed and find_spec(needed[one.study]) is None for one in contenders):
        parser.error(
            "a network and wavelets need the group `bench`: pip install --group bench, or name others by --only"
        )
    console = Console(width=130)
    with console.status("flying") as status:
        tallies = run(contenders, size, arguments.seed, status.update)
    for scale in PHENOMENOLOGIES:
        console.print(detection(tallies, scale))
    console.print(price(tallies))
    console.print("* studied faulty flights of other airframes. Time a sample includes the way from telemetry to rows.")


if __name__ == "__main__":
    main()
