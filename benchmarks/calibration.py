"""Do the two promises hold for airframes and sessions that taught nothing? Emulated airframes, by teaching flights.

    python benchmarks/calibration.py [--airframes 200] [--judged 100] [--flight 20] [--rate 100] [--seed 81]
        [--propellers 0.03]

Each airframe is a new specimen of one of three vehicles in turn. A session has its own battery, centre of gravity, gyro
bias and seating of the propellers (`in_session`), and other propellers, whose thrust differs by up to that share, if it
is above 0. Each session begins with another shape of flight. Baselines are taught by n flights of one session, or of
three; the judged flights are of other sessions, with five in each. All flights are made once. Promised are alarms in
one session of 20, for a session counts as an hour (`mavdiag.thresholds.rule`), and one suspected flight in 50.
Printed for each way of teaching: sessions with an alarm (a verdict of a fault) and suspected flights, declared ones
included, with their rates and 95 % limits; alarms an hour by the clock; and the share of airframes whose own counts
exclude a promise at 95 %, with the 95 % upper limit of that share. Beside stands how often each monitor spoke.
"""

import argparse
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import beta, binom

from mavdiag.archive.pool import run_all
from mavdiag.errors import MavdiagError
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import Log
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, FLIGHTS_PER_SUSPICION
from mavdiag.units import S_PER_H
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.campaign.worker import CREATED, specimen
from sitl_plant.physics.airframe import in_session, with_propellers
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import airframe_of, vehicle_named

VEHICLES = ("qdrone2", "hexa-x", "quad-plus")
TAUGHT = (3, 5, 10, 30)
SESSIONS = (1, 3)
OF_SESSION = 5  # judged flights of one session
WINDS_M_S = (0.0, 1.0, 2.0)
SHAPES = ("square", "hover", "circle", "figure8")

Way = tuple[int, int]  # teaching flights and their sessions


@dataclass(frozen=True, slots=True)
class Count:
    """What one baseline said of healthy flights of other sessions. declared: sessions with an alarm."""

    flights: int
    sessions: int
    hours: float
    alarms: int
    declared: int
    suspected: int
    spoke: Counter[str]


def flights_of(airframe: int, session: int, count: int, options: argparse.Namespace) -> Iterator[Log]:
    """Healthy flights of one session."""
    vehicle = vehicle_named(VEHICLES[airframe % len(VEHICLES)])
    rng = np.random.default_rng([options.seed, airframe, session])
    own = in_session(specimen(options.seed, airframe, vehicle), rng)
    if options.propellers > 0.0:
        own = with_propellers(own, options.propellers, rng)
    for number in range(count):
        config = PlantConfig(
            airframe=own,
            trajectory=SHAPES[(session + number) % len(SHAPES)],
            wind_m_s=float(rng.choice(WINDS_M_S)),
            seed=int(rng.integers(2**31)),
        )
        telemetry, _ = flight_telemetry(config, options.flight, LinkSpec("qdrone2", options.rate))
        yield Log(f"{airframe} {session} {number}", telemetry.digest, "qdrone2", telemetry)


def calibrated(airframe: int, options: argparse.Namespace) -> dict[Way, Count | str]:
    """Learn in every way from an airframe's flights, and judge the others; a refusal is a string."""
    most = max(TAUGHT)
    sessions = [
        list(flights_of(airframe, session, most if session == 0 else most // 3, options)) for session in range(3)
    ]
    others = range(100, 100 + options.judged // OF_SESSION)
    judged = [(session, log) for session in others for log in flights_of(airframe, session, OF_SESSION, options)]
    found: dict[Way, Count | str] = {}
    told = airframe_of(vehicle_named(VEHICLES[airframe % len(VEHICLES)]), f"airframe {airframe}")
    for way in ((taught, count) for taught in TAUGHT for count in SESSIONS):
        taught, count = way
        logs = [log for session in sessions[:count] for log in session[: -(-taught // count)]][:taught]
        try:
            baseline = learn(logs, LearnOptions(airframe=told, sessions=count), created=CREATED)
        except MavdiagError as error:
            found[way] = str(error)
            continue
        verdicts = [(session, judge(log, baseline)) for session, log in judged]
        faults = [session for session, one in verdicts if one.verdict is Verdict.FAULT]
        bad = [one for _, one in verdicts if one.verdict in (Verdict.FAULT, Verdict.SUSPECTED)]
        found[way] = Count(
            sum(one.judged_s > 0 for _, one in verdicts),
            len(others),
            sum(one.judged_s for _, one in verdicts) / S_PER_H,
            len(faults),
            len(set(faults)),
            len(bad),
            Counter({event.monitor for one in bad for event in one.events}),
        )
    return found


def line(way: Way, counts: list[Count]) -> list[str]:
    """The table's row of one way of teaching."""
    flights, sessions, hours, alarms, declared, suspected = (
        sum(getattr(one, name) for one in counts)
        for name in ("flights", "sessions", "hours", "alarms", "declared", "suspected")
    )
    above = [
        binom.sf(one.declared - 1, one.sessions, BUDGET_PER_HOUR) < 0.05
        or binom.sf(one.suspected - 1, one.flights, 1 / FLIGHTS_PER_SUSPICION) < 0.05
        for one in counts
    ]
    spoke = sum((one.spoke for one in counts), Counter[str]())
    return [
        f"{way[0]} in {way[1]}",
        str(len(counts)),
        f"{declared} of {sessions}: {declared / sessions:.4f} (< {upper(declared, sessions):.4f})",
        f"{suspected} of {flights}: {suspected / flights:.4f} (< {upper(suspected, flights):.4f})",
        f"{alarms} in {hours:.1f} h: {alarms / hours:.3f}",
        f"{sum(above)} (< {100 * upper(sum(above), len(above)):.0f} %)",
        ", ".join(f"{name} {times}" for name, times in spoke.most_common()),
    ]


def upper(count: int, of: int) -> float:
    """Upper limit at 95 % of a share (Clopper and Pearson)."""
    return float(beta.ppf(0.95, count + 1, of - count)) if count < of else 1.0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--airframes", type=int, default=200)
    parser.add_argument("--judged", type=int, default=100)
    parser.add_argument("--flight", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--seed", type=int, default=81)
    parser.add_argument("--propellers", type=float, default=0.03)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    counts, refused = defaultdict[Way, list[Count]](list), Counter[str]()
    for airframe, future in run_all(partial(calibrated, options=options), range(options.airframes), options.workers):
        for way, count in future.result().items():
            if isinstance(count, str):
                refused[f"{way[0]} in {way[1]}: {count.split(':')[0]}"] += 1
            else:
                counts[way].append(count)
        spoke = {way: (one.declared, one.suspected) for way, one in future.result().items() if isinstance(one, Count)}
        print(f"airframe {airframe}: (sessions declared, flights suspected) {spoke}", flush=True)
    table = Table(
        "taught by", "airframes", "sessions declared", "suspected", "by the clock", "above a promise", "monitors"
    )
    for way in sorted(counts):
        table.add_row(*line(way, counts[way]))
    Console(width=160, highlight=False).print(table)
    for text, times in refused.most_common():
        print(f"refused {times}: {text}")


if __name__ == "__main__":
    main()
