"""Healthy flights of another kind than was learnt: faults, suspicions and flights that are not judged, kind by kind.

    python benchmarks/other_kinds.py [--seed 500] [--flights 2] [--profile ardupilot] [--wind M_S] [--turbulence W20]

A kind is a trajectory, where the nose points, and calm air or 2.5 m/s of wind with gusts. A baseline is of three
flights of 60 s of one kind, on three days of the first specimen; flights of every kind on other days are judged. A cell
has faults F, suspicions S and flights that are not judgeable N, or "." for none of them; the diagonal is of the kind
that was learnt. All flights are healthy, so each F is a false alarm. `--wind` and `--turbulence` are of the flights
that are judged, in place of their own air: taught in calm air, flown in another.
"""

import argparse
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import Log
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.campaign.worker import CREATED
from sitl_plant.physics.airframe import drone, in_session_number
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import airframe_of, qdrone2

DURATION_S, WIND_M_S, LEARNT_DAYS = 60.0, 2.5, (1, 2, 3)
CALM = ("hover fixed", "square fixed", "square path", "circle fixed", "circle path", "figure8 fixed", "figure8 path")
KINDS = (*CALM, "hover spin", "hover fixed wind", "square fixed wind", "square path wind")
Air = tuple[float, float]  # mean wind, and W20 of the turbulence [m/s]
TOLD = {Verdict.FAULT: "F", Verdict.SUSPECTED: "S", Verdict.NOT_JUDGEABLE: "N"}


def flight(kind: str, day: int, seed: int, profile: str, air: Air | None = None) -> Log:
    """A healthy flight of a kind on a day of the specimen. air: in place of its own."""
    (trajectory, nose, *wind), airframe = kind.split(), in_session_number(drone(qdrone2(), 1), day, 0.0)
    mean, turbulence = air or (WIND_M_S if wind else 0.0, 0.0)
    config = PlantConfig(
        trajectory=trajectory, nose=nose, wind_m_s=mean, turbulence_m_s=turbulence, airframe=airframe, seed=seed
    )
    telemetry, _ = flight_telemetry(config, DURATION_S, LinkSpec(profile))
    return Log(f"{kind}, day {day}", telemetry.digest, profile, telemetry)


def told(learnt: str, seed: int, flights: int, profile: str, air: Air | None) -> list[Counter[Verdict]]:
    """The verdicts on flights of each kind, by a baseline of one."""
    teaching = [flight(learnt, day, seed + day, profile) for day in LEARNT_DAYS]
    base = learn(teaching, LearnOptions(airframe=airframe_of(qdrone2(), "specimen")), created=CREATED)
    days = range(11, 11 + flights)
    flown = [[flight(one, day, seed + 100 + day, profile, air) for day in days] for one in KINDS]
    return [Counter(judge(log, base).verdict for log in logs) for logs in flown]


def main() -> None:
    """Fly, learn, judge and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=500)
    parser.add_argument("--flights", type=int, default=2)
    parser.add_argument("--profile", default="ardupilot")
    parser.add_argument("--wind", type=float, default=0.0)
    parser.add_argument("--turbulence", type=float, default=0.0)
    asked, n = parser.parse_args(), len(KINDS)
    air = (asked.wind, asked.turbulence) if asked.wind or asked.turbulence else None
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        found = list(pool.map(told, KINDS, [asked.seed] * n, [asked.flights] * n, [asked.profile] * n, [air] * n))
    print(f"{'learnt | flown':<18}", *(f"{kind.replace(' ', '-')[:17]:>17}" for kind in KINDS))
    for kind, row in zip(KINDS, found, strict=True):
        cells = (" ".join(f"{one[verdict]}{letter}" for verdict, letter in TOLD.items() if one[verdict]) for one in row)
        print(f"{kind:<18}", *(f"{cell or '.':>17}" for cell in cells))
    own = sum((row[number] for number, row in enumerate(found)), Counter[Verdict]())
    others = sum((one for row in found for one in row), Counter[Verdict]()) - own
    for name, counts in (("of the kind that was learnt", own), ("of another kind", others)):
        print(f"{name}: {counts.total()} flights,", ", ".join(f"{counts[verdict]} {verdict}" for verdict in Verdict))


if __name__ == "__main__":
    main()
