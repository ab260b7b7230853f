"""Make `mavdiag/thresholds/priors.json`: how the healthy maxima of each monitor differ, pooled over airframes.

    python benchmarks/make_priors.py [BASELINE.json ...] [--emulated 4] [--seed 7300] -o FILE

Each baseline is one airframe: the healthy scores that it keeps are of flights that no fit saw, and it knows the session
of each. `--emulated` learns so many more from emulated airframes of three vehicles in turn, whose sessions have other
propellers and batteries: three sessions of three flights of 30 s over a link of 200 Hz, in calm air or wind, of which
each flies another trajectory. A score below a monitor's least threshold counts as that: no threshold depends on how
such scores differ. With s_k the standard deviation that airframe k shows of a component, by d_k degrees of freedom,

    s0^2 = (nu - 2)/nu (sum d_k s_k^2)/(sum d_k)

which is the scale of the scaled inverse chi-squared law of nu degrees of freedom with their mean (Gelman, BDA, A.1).
It stands beside the estimate, in the present file, of what no emulator shows (`thresholds.rule.prior_of`). Printed:
both, and what each airframe shows itself against a prior of the others (leave one airframe out): ratios far from 1 say
that airframes differ by more than the law of nu degrees of freedom has it. An airframe that is judged must not be a
source.
"""

import argparse
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from mavdiag.baseline import Baseline
from mavdiag.learning import LearnOptions, learn
from mavdiag.monitors import by_name
from mavdiag.storage import write_atomically
from mavdiag.telemetry import Log
from mavdiag.thresholds.heldout import Scores
from mavdiag.thresholds.rule import DEGREES, GUMBEL_SCALE, Prior, part_of, priors_file
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.campaign.worker import CREATED, specimen
from sitl_plant.physics.airframe import in_session, with_propellers
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import airframe_of, vehicle_named

COMPONENTS = ("session", "flight", "block")
SESSIONS, FLIGHTS, FLIGHT_S, RATE_HZ = 3, 3, 30.0, 200.0
VEHICLES, SHAPES, WINDS_M_S = (
    ("qdrone2", "hexa-x", "quad-plus"),
    ("square", "hover", "circle", "figure8"),
    (0.0, 1.0, 2.0),
)
SPREAD = 0.03  # of the thrust of propellers of another session
ALIKE = 1e-3  # of the estimate: no score was above the least threshold

Shown = dict[str, tuple[tuple[float, int], ...]]  # of each monitor what one airframe shows (`shown_spreads`)


def emulated(number: int, seed: int) -> Baseline:
    """A baseline of an emulated airframe."""
    vehicle, rng, logs = vehicle_named(VEHICLES[number % len(VEHICLES)]), np.random.default_rng([seed, number]), []
    airframe = specimen(seed, number, vehicle)
    for session in range(SESSIONS):
        own = with_propellers(in_session(airframe, rng), SPREAD, rng)
        for flight in range(FLIGHTS):
            config = PlantConfig(
                airframe=own,
                trajectory=SHAPES[(session + flight) % len(SHAPES)],
                wind_m_s=float(rng.choice(WINDS_M_S)),
                seed=seed + 100 * number + 10 * session + flight,
            )
            telemetry, _ = flight_telemetry(config, FLIGHT_S, LinkSpec("qdrone2", RATE_HZ))
            name = f"emulated {seed}-{number} session {session} flight {flight}"
            logs.append(Log(name, telemetry.digest, "qdrone2", telemetry))
    told = replace(airframe_of(vehicle, "emulated"), name=f"emulated {seed}-{number}")
    return learn(logs, LearnOptions(airframe=told, sessions=SESSIONS, robust=True), created=CREATED)


def shown(baseline: Baseline) -> Shown:
    """What the healthy flights of an airframe show."""
    sessions = [log.session for log in baseline.provenance.logs]
    found: Shown = {}
    for entry in baseline.monitors:
        prior, held = by_name(entry.spec.kind).prior, entry.scores
        maxima = np.maximum(held.maxima, prior.least)
        scores = Scores(maxima, np.array(held.spans_s), np.array(held.flights))
        found.setdefault(entry.spec.kind, shown_spreads(scores, sessions, prior))
    return found


def shown_spreads(scores: Scores, sessions: Sequence[int], prior: Prior) -> tuple[tuple[float, int], ...]:
    """What healthy flights alone show, in the prior's unit: standard deviation between sessions, between flights and
    within a flight, each with its degrees of freedom; with none the prior's own."""
    found, _ = part_of(scores, sessions, prior, nu=1e-9)
    unit = abs(float(scores.maxima.mean())) if prior.shares else 1.0
    sds = found.session_sd, found.flight_sd, found.beta / GUMBEL_SCALE
    degrees = found.sessions - 1, found.flights - found.sessions, len(scores.maxima) - found.flights
    return tuple((sd / unit, count) for sd, count in zip(sds, degrees, strict=True))


def pooled(airframes: Sequence[Shown], monitor: str) -> dict[str, float]:
    """The prior's components that airframes show together, of those that any does."""
    found = {}
    for place, component in enumerate(COMPONENTS):
        told = [one[monitor][place] for one in airframes if monitor in one]
        degrees = sum(count for _, count in told)
        if degrees:
            squares = sum(count * sd * sd for sd, count in told)
            found[component] = float(f"{math.sqrt((DEGREES - 2) / DEGREES * squares / degrees):.2g}")
    return found


def compared(airframes: Mapping[str, Shown], monitor: str) -> Iterator[str]:
    """Of each component the ratios of what an airframe shows to what the others would have it believe."""
    for place, component in enumerate(COMPONENTS):
        ratios = []
        for name, one in airframes.items():
            prior = pooled([other for label, other in airframes.items() if label != name], monitor).get(component)
            if prior and monitor in one and one[monitor][place][1]:
                ratios.append(one[monitor][place][0] / prior)
        yield " ".join(f"{ratio:.1f}" for ratio in ratios)


def main() -> None:
    """Write the file, and print what moved."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("baselines", type=Path, nargs="*")
    parser.add_argument("--emulated", type=int, default=4)
    parser.add_argument("--seed", type=int, default=7300)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    learnt = [*map(Baseline.load, options.baselines), *(emulated(i, options.seed) for i in range(options.emulated))]
    airframes = {f"{number} {one.airframe.name}": shown(one) for number, one in enumerate(learnt)}
    priors: dict[str, dict[str, Any]] = {name: dict(known) for name, known in priors_file()["priors"].items()}
    table = Table("monitor", "estimate", "pooled", *(f"{one}: airframe / others" for one in COMPONENTS))
    for monitor, known in priors.items():
        new = pooled(list(airframes.values()), monitor)
        estimate = ", ".join(f"{one:g}" for one in known["estimate"])
        pool = ", ".join(str(new.get(one, "-")) for one in COMPONENTS)
        table.add_row(monitor, estimate, pool, *compared(airframes, monitor))
        alike = all(sd < ALIKE * own for sd, own in zip(new.values(), known["estimate"], strict=False))
        known["emulated"] = [] if alike else list(new.values())
    sources = [
        {"airframe": one.airframe.name, "profile": one.link.profile, "digest": one.digest}
        | {"flights": len(one.provenance.logs), "sessions": len({log.session for log in one.provenance.logs})}
        for one in learnt
    ]
    made = f"benchmarks/make_priors.py --emulated {options.emulated} --seed {options.seed}"
    content = {"schema": "mavdiag.priors/1", "made": made, "sources": sources, "degrees": DEGREES, "priors": priors}
    write_atomically(options.output, json.dumps(content, indent=1) + "\n")
    Console(width=160, highlight=False).print(table)


if __name__ == "__main__":
    main()
