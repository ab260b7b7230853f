"""The least loss of thrust that ESC telemetry shows: share of flights found, rotor named, and false alarms.

    python benchmarks/rotor_speed.py [--flights 60] [--airframes 3] [--seed 900] [--load 0.2] [--session 0.0005]

Airframes are drawn, every second one aged. Each teaches a baseline with 5 healthy squares of 40 s, by the defaults,
over an `ardupilot` and a `px4` link: ESCs at 10 Hz in steps of 14 rpm, of which 2 % of the frames are lost. Fresh
flights of 40 s are judged, one rotor damaged at a drawn time 35 to 45 % through, or none; those without damage are as
many as of each size. Damage: thrust and drag lost alike, as with a shorter blade; thrust alone, its drag kept.

load: share of a motor's voltage that its resistance takes in hover (0.15 to 0.25 of small motors, estimate). session:
standard deviation of each motor's speed for its command from flight to flight, of the teaching ones too (magnets and
windings that are warmer or colder than those of the other motors; an estimate, see thresholds/priors.json).

Two counts: by the monitor `rotor_speed` alone (an alarm after the onset), and by the decision (fault after the onset).
Of those found, the rotor that has the most evidence at the first alarm, and that of the decision at the end.
"""

import argparse
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from multiprocessing import get_context

import numpy as np

from mavdiag.baseline import Baseline
from mavdiag.decision.diagnosis import Stage
from mavdiag.judging import judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import Log
from mavdiag.units import NS_PER_S, S_PER_H
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.campaign.plan import parse_link
from sitl_plant.campaign.worker import CREATED, specimen
from sitl_plant.physics.faults import Injection, RotorDamage
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import airframe_of, qdrone2

DURATION_S, LEARN_FLIGHTS, ONSET = 40.0, 5, (0.35, 0.45)
SIZES = (2, 3, 4, 6, 8)  # percent of thrust
DAMAGE: dict[str, Callable[[float], RotorDamage]] = {
    "thrust and drag": lambda loss: RotorDamage(thrust_factor=1 - loss, drag_factor=1 - loss),
    "thrust alone": lambda loss: RotorDamage(thrust_factor=1 - loss),
}


@dataclass(frozen=True, slots=True)
class Setup:
    """An airframe on a link."""

    seed: int
    number: int
    link: str
    load: float
    session: float

    def flight(self, seed: int, injections: tuple[Injection, ...] = ()) -> Log:
        """One flight, whose motors are as warm as they are."""
        vehicle = qdrone2()
        vehicle = replace(vehicle, propulsion=replace(vehicle.propulsion, load_share=self.load))
        airframe = specimen(self.seed, self.number, vehicle)
        warmth = 1 + self.session * np.random.default_rng([self.seed, seed, 1]).standard_normal(4)
        motors = tuple(Injection(RotorDamage(speed_factor=one), k) for k, one in enumerate(warmth.tolist(), 1))
        config = PlantConfig(airframe=airframe, seed=seed, injections=(*motors, *injections))
        telemetry, _ = flight_telemetry(config, DURATION_S, parse_link(self.link))
        return Log(f"flight {seed}", telemetry.digest, self.link.partition("@")[0], telemetry)


@cache
def taught(setup: Setup) -> Baseline:
    """The baseline of its healthy flights."""
    flights = [setup.flight(setup.seed + 10_000 + 100 * setup.number + i) for i in range(LEARN_FLIGHTS)]
    airframe = airframe_of(qdrone2(), f"airframe {setup.number}")
    return learn(flights, LearnOptions(airframe=airframe), created=CREATED)


@dataclass(frozen=True, slots=True)
class Found:
    """What a flight came to: whether the monitor alarmed and named the rotor, and whether the decision did."""

    alarmed: bool
    alarm_right: bool
    fault: bool
    fault_right: bool
    judged_s: float
    threshold: float


def judged(setup: Setup, name: str, loss: float, seed: int) -> Found:
    """Fly and judge one flight."""
    rng = np.random.default_rng([setup.seed, seed])
    onset_s, rotor = DURATION_S * float(rng.uniform(*ONSET)), int(rng.integers(1, 5))
    damage = (Injection(DAMAGE[name](loss), rotor, onset_s, angle_rad=float(rng.uniform(0, 6.283))),) if loss else ()
    found, onset_ns = judge(setup.flight(seed, damage), taught(setup)), round(onset_s * NS_PER_S)
    since = onset_ns if loss else 0
    alarms = [one for one in found.events if one.monitor == "rotor_speed" and one.start_ns >= since]
    fault = any(one.stage is Stage.FAULT and one.t_ns >= since for one in found.changes)
    summary = next(one for one in found.monitors if one.name == "rotor_speed")
    return Found(
        bool(alarms),
        bool(alarms) and alarms[0].rotor == rotor,
        fault,
        fault and found.rotor == rotor,
        summary.judged_s,
        summary.threshold,
    )


def job(task: tuple[Setup, str, float, int]) -> Found:
    """One flight, for a worker."""
    return judged(*task)


def line(name: str, loss: float, found: Sequence[Found]) -> str:
    """A row of the table."""
    count = Counter(field for one in found for field in Found.__dataclass_fields__ if getattr(one, field) is True)
    hours, limits = sum(one.judged_s for one in found) / S_PER_H, sorted(one.threshold for one in found)
    what = f"{name} {loss:.0%}" if loss else f"healthy, {hours:.2f} h judged"
    right = [f", rotor right {count[field]}" if loss else "" for field in ("alarm_right", "fault_right")]
    by = f"rotor_speed {count['alarmed']}{right[0]}; fault {count['fault']}{right[1]}"
    return f"{what:24} of {len(found)}: {by}; thresholds {limits[0]:.4f} to {limits[-1]:.4f} of the speed"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=60, help="for each row, shared by airframes and links")
    parser.add_argument("--airframes", type=int, default=3)
    parser.add_argument("--seed", type=int, default=900)
    parser.add_argument("--load", type=float, default=0.2)
    parser.add_argument("--session", type=float, default=0.0005)
    parser.add_argument("--links", nargs="*", default=["ardupilot@100", "px4@100"])
    parser.add_argument("--sizes", nargs="*", type=float, default=SIZES, help="percent of thrust")
    parser.add_argument("--workers", type=int, default=1)
    arguments = parser.parse_args()
    start_s, seed = time.monotonic(), arguments.seed
    setups = [
        Setup(seed, number, link, arguments.load, arguments.session)
        for number in range(arguments.airframes)
        for link in arguments.links
    ]
    rows = [("thrust and drag", 0.0), *((name, size / 100) for name in DAMAGE for size in arguments.sizes)]
    tasks = [
        (setups[i % len(setups)], name, loss, seed + 20_000 + 1000 * k + i)
        for k, (name, loss) in enumerate(rows)
        for i in range(arguments.flights)
    ]
    with ProcessPoolExecutor(arguments.workers, mp_context=get_context("spawn")) as pool:
        answers = pool.map(job, tasks)
        for name, loss in rows:
            print(line(name, loss, list(islice(answers, arguments.flights))), flush=True)
    print(f"{time.monotonic() - start_s:.0f} s, seed {seed}")


if __name__ == "__main__":
    main()
