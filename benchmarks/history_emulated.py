"""Emulated airframes that wear, flight by flight, as the history keeps them; for `history_wear.py`.

An airframe is drawn, every second one aged. Ten flights of 20 s in five sessions teach its baseline. Each day has 1 to
8 flights: battery and its place, gyro bias and how the propellers sit are drawn anew (`sitl_plant.physics.sessions`).
For 50 flights it is healthy; then one rotor wears for 150, in one of four ways:

    unbalance     material is lost on one side
    thrust        thrust is lost, and drag kept
    short blade   thrust and drag are lost alike
    crack         fault F2/SV2 of the thesis, in parts: fluctuation, unbalance, thrust, drag

The size at which it ends is the one whose flights come to the threshold: bisected, before the history begins, until the
median over five sessions of the highest peak/threshold is 1. The law says what share of it is there after each flight.
"""

import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mavdiag.archive.figures import FlightRecord, record_of
from mavdiag.baseline import Baseline
from mavdiag.history.warn import WATCHED
from mavdiag.judging import judge_in_full
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import FloatArray, Log
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.campaign.worker import CREATED, specimen
from sitl_plant.physics.airframe import Airframe, in_session
from sitl_plant.physics.faults import FAULTS, Injection, RotorDamage
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import airframe_of, qdrone2

__all__ = ["HEALTHY_FIRST", "KINDS", "Worn", "flown", "highest"]

DURATION_S = 20.0
LINK = LinkSpec("qdrone2", 100.0)
HEALTHY_FIRST = 50
START_NS, DAY_NS, PAUSE_NS = 1_767_225_600 * NS_PER_S, 86_400 * NS_PER_S, 600 * NS_PER_S
MOST_A_DAY = 8
STEPS, SESSIONS = 7, 5  # of the bisection


def cracked(size: float) -> RotorDamage:
    """So many times F2/SV2."""
    whole = FAULTS["F2/SV2"]
    return RotorDamage(
        thrust_factor=1 - size * (1 - whole.thrust_factor),
        drag_factor=1 + size * (whole.drag_factor - 1),
        unbalance_g_mm=size * whole.unbalance_g_mm,
        fluctuation_rms=size * whole.fluctuation_rms,
        fluctuation_corner_hz=whole.fluctuation_corner_hz,
        thrust_lag_s=size * whole.thrust_lag_s,
    )


# least and largest size that is looked at, and what a size does to a rotor
KINDS: dict[str, tuple[float, float, Callable[[float], RotorDamage]]] = {
    "unbalance": (0.02, 12.8, lambda size: RotorDamage(unbalance_g_mm=size)),
    "thrust": (0.002, 0.4, lambda size: RotorDamage(thrust_factor=1 - size)),
    "short blade": (0.002, 0.4, lambda size: RotorDamage(thrust_factor=1 - size, drag_factor=1 - size)),
    "crack": (0.01, 3.0, cracked),
}


@dataclass(frozen=True, slots=True)
class Worn:
    """An airframe's flights. kind: how it wears; empty if it does not. size: of the damage at the end."""

    number: int
    kind: str
    size: float
    records: tuple[FlightRecord, ...]


class _Hangar:
    """One airframe with its days."""

    def __init__(self, seed: int, number: int) -> None:
        self.rng = np.random.default_rng([seed, number])
        self.airframe = specimen(seed, number, qdrone2())
        self.rotor, self.angle = int(self.rng.integers(1, 5)), float(self.rng.uniform(0, 2 * np.pi))
        self.name = f"airframe {number}"

    def day(self) -> Airframe:
        return in_session(self.airframe, self.rng)

    def fly(self, today: Airframe, t_ns: int, damage: RotorDamage | None = None) -> Log:
        causes = () if damage is None else (Injection(damage, self.rotor, 0.0, angle_rad=self.angle),)
        config = PlantConfig(airframe=today, injections=causes, seed=int(self.rng.integers(2**31)))
        telemetry, _ = flight_telemetry(config, DURATION_S, LINK)
        return Log(self.name, telemetry.digest, LINK.profile, telemetry, t_ns)

    def record(self, log: Log, baseline: Baseline) -> FlightRecord:
        found = judge_in_full(log, baseline)
        return replace(record_of(log, found, baseline), airframe=self.name, added_ns=log.started_ns)


def highest(record: FlightRecord) -> float:
    """The share of its threshold that the nearest watched statistic of a flight reached."""
    return max((one.peak / one.threshold for one in record.slots if one.monitor in WATCHED and one.peak), default=0.0)


def flown(seed: int, number: int, kind: str, growth: FloatArray, keep: Path | None = None) -> Worn:
    """All flights of an airframe, judged. growth: share of the last size after each flight of wear.

    keep: a folder; what is there already is not flown again.
    """
    file = None if keep is None else keep / f"{seed}-{number}.pickle"
    if file is not None and file.exists():
        found: Worn = pickle.loads(file.read_bytes())
        return found
    hangar = _Hangar(seed, number)
    baseline = _taught(hangar)
    size = _reaching(hangar, baseline, kind) if kind else 0.0
    records, day, left = [], 100, 0
    today = hangar.airframe
    for share in growth.tolist():
        if left == 0:
            day, left, today = day + 1, int(hangar.rng.integers(1, MOST_A_DAY + 1)), hangar.day()
        left -= 1
        damage = KINDS[kind][2](size * share) if kind and share > 0 else None
        log = hangar.fly(today, START_NS + day * DAY_NS + (MOST_A_DAY - left) * PAUSE_NS, damage)
        records.append(hangar.record(log, baseline))
    worn = Worn(number, kind, size, tuple(records))
    if file is not None:
        file.write_bytes(pickle.dumps(worn))
    return worn


def _taught(hangar: _Hangar) -> Baseline:
    flights = []
    for session in range(5):
        today = hangar.day()
        flights += [hangar.fly(today, START_NS + session * DAY_NS + i * PAUSE_NS) for i in range(2)]
    frame = replace(airframe_of(hangar.airframe.vehicle, hangar.airframe.name), name=hangar.name)
    return learn(flights, LearnOptions(airframe=frame), created=CREATED)


def _reaching(hangar: _Hangar, baseline: Baseline, kind: str) -> float:
    """The size whose flights come to the threshold."""
    least, most, damage = KINDS[kind]
    low, high = np.log(least), np.log(most)
    for _ in range(STEPS):
        middle = (low + high) / 2
        logs = [hangar.fly(hangar.day(), START_NS, damage(float(np.exp(middle)))) for _ in range(SESSIONS)]
        if np.median([highest(hangar.record(log, baseline)) for log in logs]) >= 1.0:
            high = middle
        else:
            low = middle
    return float(np.exp((low + high) / 2))
