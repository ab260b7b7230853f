"""The airframe's fingerprint on emulated flights: who is refused, who is noted, who passes in silence.

    python benchmarks/airframe_likeness.py [--airframes 12] [--seed 20] [--link qdrone2@200]

Each specimen's fingerprint comes from 5 healthy flights of 30 s in conditions drawn at random. Compared with it are:
new healthy flights of the same specimen, flights with each of the nine faults from take-off on at phenomenology 1,
healthy flights of another specimen, and of other vehicles.
"""

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table
from teaching_guards import Session

from mavdiag.airframe.fingerprint import Likeness, Outcome, compare, fingerprint_of
from mavdiag.learning import airborne, front_for
from mavdiag.rows.front import Front, Rows
from mavdiag.telemetry import Log
from sitl_plant.autopilot.telemetry import LinkSpec
from sitl_plant.campaign.plan import injections_of
from sitl_plant.campaign.worker import specimen
from sitl_plant.physics.airframe import draw_airframe
from sitl_plant.physics.faults import FAULTS
from sitl_plant.vehicle import vehicle_from

LEARN_FLIGHTS, DURATION_S = 5, 30.0
OTHERS = ("hexa-x", "octo-x", "quad-plus")


def rows(front: Front, log: Log) -> Sequence[Rows]:
    """Flying rows of a log."""
    return airborne(front, log).rows


def cases(number: int, sessions: Sequence[Session], others: Sequence[Session]) -> Iterator[tuple[str, Log]]:
    """What is compared with specimen `number`, by name."""
    own = sessions[number]
    for _ in range(3):
        yield "same airframe, healthy", own.flight(DURATION_S)
    for at, code in enumerate(FAULTS):
        lost = injections_of(code, 1 + (number + at) % 4, 0.0, 1.0, own.rng)
        yield f"same airframe, {code}", own.flight(DURATION_S, lost)
    for cause in ("bending", "motor-speed", "ejection"):
        onset_s = 12.0 if cause == "ejection" else 0.0
        lost = injections_of(cause, 1 + number % 4, onset_s, 1.0, own.rng)
        yield f"same airframe, {cause}", own.flight(DURATION_S, lost)
    for step in (1, 2, 3):
        yield "another specimen, healthy", sessions[(number + step) % len(sessions)].flight(DURATION_S)
    for other in others:
        yield f"another vehicle, {other.airframe.vehicle.name}", other.flight(DURATION_S)


def main() -> None:
    """Print the shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--airframes", type=int, default=12)
    parser.add_argument("--seed", type=int, default=20)
    parser.add_argument("--link", default="qdrone2@200")
    parser.add_argument("--show", action="store_true", help="print each phrase")
    arguments = parser.parse_args()
    console = Console(width=170, highlight=False)
    profile, _, rate = arguments.link.partition("@")
    link, vehicle = LinkSpec(profile, float(rate)), vehicle_from("qdrone2")
    sessions = [
        Session(specimen(arguments.seed, n, vehicle), link, np.random.default_rng([arguments.seed, n]))
        for n in range(arguments.airframes)
    ]
    rng = np.random.default_rng([arguments.seed, 999])
    others = [replace(sessions[0], airframe=draw_airframe(vehicle_from(n), False, rng), rng=rng) for n in OTHERS]
    counts: dict[str, Counter[Outcome]] = {}
    for number, session in enumerate(sessions):
        flights = [session.flight(DURATION_S) for _ in range(LEARN_FLIGHTS)]
        front = front_for(flights, 0.1)
        learnt = fingerprint_of([rows(front, flight) for flight in flights], session.layout)
        assert learnt is not None
        for name, log in cases(number, sessions, others):
            found: Likeness = compare(learnt, rows(front, log), session.layout)
            counts.setdefault(name, Counter())[found.outcome] += 1
            if arguments.show and found.differing:
                console.print(f"  {number} {name}: {found.outcome}, {', '.join(found.differing)}")
    table = Table(title=f"{arguments.link}: flights by what their comparison says")
    for heading in ("flights of", "number", "refused", "noted", "silent"):
        table.add_column(heading, justify="left" if heading == "flights of" else "right")
    for name, count in counts.items():
        table.add_row(name, *map(str, (count.total(), count[Outcome.FAR], count[Outcome.NEAR], count[Outcome.ALIKE])))
    console.print(table)


if __name__ == "__main__":
    main()
