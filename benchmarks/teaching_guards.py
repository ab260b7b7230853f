"""The guards of teaching on emulated flights: healthy sets that they refuse, and made-up cases that they miss.

    python benchmarks/teaching_guards.py [--sets 120] [--seed 0]

Each set is what a campaign would teach one airframe: 2 to 8 flights of 20 to 40 s, manoeuvres, wind, payload, link and
rate drawn at random. The made-up cases put one thing wrong into such a set.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from rich.console import Console
from rich.table import Table

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import InputError
from mavdiag.learning.teaching import one_vehicle, taught
from mavdiag.logs import between
from mavdiag.telemetry import Log, Signal
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.campaign.plan import MANOEUVRES, Conditions, injections_of
from sitl_plant.campaign.worker import PAYLOAD_BELOW_M, PAYLOAD_OFFSET_M, specimen
from sitl_plant.physics.airframe import Airframe, Payload
from sitl_plant.physics.faults import Injection
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import airframe_of, qdrone2

LINKS = ("qdrone2@1000", "qdrone2@200", "px4@160", "ardupilot@100")
WINDS, PAYLOADS = (0.0, 1.0, 2.0), (0.0, 50.0, 100.0)
MANOEUVRE = ("square", "square-fast", "square-turned", "hover", "circle", "figure8", "square-takeoff")


@dataclass(frozen=True, slots=True)
class Session:
    """Draws flights of one airframe over one link."""

    airframe: Airframe
    link: LinkSpec
    rng: np.random.Generator

    @property
    def layout(self) -> RotorLayout | None:
        """Of the airframe's type."""
        return airframe_of(self.airframe.vehicle, "").layout

    def flight(self, duration_s: float | None = None, injections: tuple[Injection, ...] = ()) -> Log:
        """One flight in conditions drawn afresh."""
        rng = self.rng
        conditions = Conditions(str(rng.choice(MANOEUVRE)), float(rng.choice(WINDS)), float(rng.choice(PAYLOADS)))
        return fly(self, conditions, duration_s or float(rng.uniform(20.0, 40.0)), injections)


def fly(session: Session, conditions: Conditions, duration_s: float, injections: tuple[Injection, ...]) -> Log:
    """One emulated flight as a log."""
    manoeuvre, rng = MANOEUVRES[conditions.manoeuvre], session.rng
    beside = rng.uniform(-PAYLOAD_OFFSET_M, PAYLOAD_OFFSET_M, 2)
    config = PlantConfig(
        airframe=session.airframe,
        **manoeuvre,
        landed_s=duration_s if "start" in manoeuvre else None,
        wind_m_s=conditions.wind_m_s,
        wind_towards_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
        payload=Payload(conditions.payload_g * 1e-3, (float(beside[0]), float(beside[1]), PAYLOAD_BELOW_M)),
        injections=injections,
        seed=int(rng.integers(2**31)),
    )
    telemetry, _ = flight_telemetry(config, duration_s, session.link)
    name = f"{session.airframe.name} {conditions.manoeuvre} {config.seed}"
    return Log(name, telemetry.digest, session.link.profile, telemetry)


def session_of(seed: int, number: int) -> Session:
    """A new specimen over one of the links."""
    profile, _, rate = LINKS[number % len(LINKS)].partition("@")
    airframe = specimen(seed, number, qdrone2())
    return Session(airframe, LinkSpec(profile, float(rate)), np.random.default_rng([seed, number]))


def refusal(flights: Sequence[Log], layout: RotorLayout | None) -> str:
    """Why the flights are refused; empty if they are not."""
    try:
        one_vehicle(taught(flights, 0.1, None, robust=False), layout, robust=False)
    except InputError as error:
        return str(error)
    return ""


def _crash(session: Session) -> list[Log]:
    lost = injections_of("ejection", int(session.rng.integers(1, 5)), 12.0, 1.0, session.rng)
    return [session.flight(), session.flight(24.0, lost)]


def _twice(session: Session) -> list[Log]:
    flights = [session.flight(), session.flight()]
    return [*flights, replace(flights[0], name="copy", sha256="0" * 64)]


def _overlap(session: Session) -> list[Log]:
    flight = session.flight()
    start_s = float(flight[Signal.BODY_RATE].t_ns.min()) / NS_PER_S
    part = between(flight.telemetry, start_s + 8.0, None)
    return [flight, session.flight(), replace(flight, name="part", sha256="", telemetry=part)]


def _rate(session: Session) -> list[Log]:
    flights = [session.flight(), session.flight()]
    other = replace(session, link=LinkSpec(session.link.profile, 0.5 * (session.link.rate_hz or 100.0)))
    return [*flights, other.flight()]


CASES: dict[str, Callable[[Session], list[Log]]] = {
    "a crash": _crash,
    "the same flight twice": _twice,
    "a part of another flight": _overlap,
    "another rate": _rate,
}


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=120)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    console = Console(width=150, highlight=False)
    refused = Counter[str]()
    for number in range(arguments.sets):
        session = session_of(arguments.seed, number)
        flights = [session.flight() for _ in range(int(session.rng.integers(2, 9)))]
        if text := refusal(flights, session.layout):
            refused["healthy"] += 1
            console.print(f"  {number} {session.link.profile}: {text}")
    console.print(f"healthy sets refused: {refused['healthy']} of {arguments.sets}")
    table = Table(title="made-up cases refused")
    count = max(1, arguments.sets // 4)
    for name, make in CASES.items():
        found = 0
        for number in range(count):
            session = session_of(arguments.seed + 1, number)
            found += bool(refusal(make(session), session.layout))
        table.add_row(name, f"{found} of {count}")
    console.print(table)


if __name__ == "__main__":
    main()
