"""A short campaign for each emulated vehicle: T's nine faults found, and on which rotor; alarms in healthy flight.

    python benchmarks/vehicle_campaigns.py [--vehicle NAME]... [--flights 18] [--seed 8]

One new specimen of each vehicle, a baseline of its own from a few healthy flights of the square, then flights with the
faults in turn on each rotor, without the fitted terms and with them, over the 1 kHz link. For more, and for intervals,
see `sitl-plant campaign --vehicle`.
"""

import argparse
import tempfile
from contextlib import closing
from pathlib import Path

from sitl_plant.campaign.plan import CAUSES, Design, Group
from sitl_plant.campaign.summary import Row, summarise
from sitl_plant.campaign.worker import Journal, run_campaign
from sitl_plant.vehicle import vehicle_named

VEHICLES = ("qdrone2", "quad-plus", "hexa-x", "hexa-plus", "octo-x")
FAULTS = tuple(name for name, cause in CAUSES.items() if cause.group is Group.FAULT)


def flown(vehicle: str, flights: int, seed: int) -> Row:
    """One vehicle's campaign."""
    design = Design(
        vehicle=vehicle_named(vehicle),
        seed=seed,
        airframes=1,
        learn="square",
        learn_flights=4,
        flights=flights,
        hours=0.1,
        cause=FAULTS,
        manoeuvre=("square",),
        wind=(0.0,),
        payload=(0.0,),
        duration_s=60.0,
    )
    with tempfile.TemporaryDirectory() as folder, closing(Journal(Path(folder) / "results.jsonl", True)) as journal:
        return summarise(run_campaign(design, journal, 1))


def line(summary: Row, vehicle: str) -> str:
    """The vehicle's row of the table in the documents."""
    row = next(row for row in summary["detection"] if row["factor"] == "all")
    alarms = next(row for row in summary["alarms"] if row["factor"] == "all")["rate"]
    cells = (
        vehicle,
        str(len(vehicle_named(vehicle).rotors)),
        f"{row['detected'].hits} of {row['detected'].of}",
        f"{row['rotor_right'].hits} of {row['rotor_right'].of}",
        "-" if row["latency_median_s"] is None else f"{row['latency_median_s']:.1f} s",
        f"{alarms.count} in {alarms.hours:.2f} h",
    )
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print a row for each vehicle."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", action="append", choices=VEHICLES, help="default: all of them")
    parser.add_argument("--flights", type=int, default=18, help="with a fault, of each vehicle")
    parser.add_argument("--seed", type=int, default=8)
    options = parser.parse_args()
    print("| vehicle | rotors | found | rotor right | latency, median | healthy: alarms |")
    print("|---|---|---|---|---|---|")
    for vehicle in options.vehicle or VEHICLES:
        print(line(flown(vehicle, options.flights, options.seed), vehicle), flush=True)


if __name__ == "__main__":
    main()
