"""The common campaign: emulated flights of fresh airframes in mixed conditions, as rows that every contender gets."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from emulated import as_flight

from mavdiag.learning import front_for, rows_of
from mavdiag.telemetry import FloatArray, Log
from sitl_plant.physics.airframe import Airframe, Payload, draw_airframe
from sitl_plant.physics.faults import FAULTS
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import qdrone2

__all__ = ["PHENOMENOLOGIES", "Flown", "Truth", "airframe", "faulty", "flown", "healthy", "mixed", "other_airframe"]

PHENOMENOLOGIES = (1.0, 0.5, 0.0)
WINDOW_S = 0.1
ROTORS = 4
SHAPES = ("square", "hover", "circle", "figure8")
SPEED_M_S, WIND_MAX_M_S, PAYLOAD_MAX_KG = (0.3, 0.6), 1.5, 0.2
ONSET_S, FAULTY_S = 10.0, 30.0  # of a judged faulty flight: 10 s healthy, 20 s damaged


@dataclass(frozen=True, slots=True)
class Truth:
    """What was injected. fault: "F1/SV1" to "F3/SV3". onset_s: flight time, 0 for damage from the start."""

    fault: str
    rotor: int
    phenomenology: float
    onset_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """n judgeable rows of one flight at a uniform period `dt_s`, body FRD, and the telemetry that they came from.

    t_s: (n,) flight time. u: (n, 3) commanded and y: (n, 3) measured rate behind the 0.1 s Savitzky-Golay window, gyro:
    (n, 3) the raw one [rad/s]. force: (n, 3) [m/s^2]. duty: (n, 4). delay_s: how much later than t_s a row is known.
    airframe: a name. truth: None if healthy. front_s: CPU time that the rows took [s].
    """

    flight: Log
    airframe: str
    t_s: FloatArray
    dt_s: float
    u: FloatArray
    y: FloatArray
    gyro: FloatArray
    force: FloatArray
    duty: FloatArray
    delay_s: float
    front_s: float
    truth: Truth | None = None

    def __len__(self) -> int:
        return len(self.t_s)

    def forgetting_telemetry(self) -> "Flown":
        """Without the telemetry, which is half of the memory."""
        return replace(self, flight=replace(self.flight, telemetry=type(self.flight.telemetry)()))


def airframe(number: int, seed: int) -> Airframe:
    """A fresh specimen to be judged; every second one is aged."""
    rng = np.random.default_rng((seed, 1, number))
    return draw_airframe(qdrone2(), aged=number % 2 == 1, rng=rng, name=f"judged {number}")


def other_airframe(number: int, seed: int) -> Airframe:
    """A specimen that only lends training flights."""
    rng = np.random.default_rng((seed, 2, number))
    return draw_airframe(qdrone2(), aged=number % 2 == 1, rng=rng, name=f"other {number}")


def mixed(one: Airframe, number: int, seed: tuple[int, ...]) -> PlantConfig:
    """Conditions of flight `number`: the four paths in turn; speed, heading, wind and payload drawn."""
    rng = np.random.default_rng((*seed, number))
    return PlantConfig(
        airframe=one,
        trajectory=SHAPES[number % len(SHAPES)],
        speed_m_s=rng.uniform(*SPEED_M_S),
        heading_rad=rng.uniform(0.0, 2.0 * np.pi),
        wind_m_s=rng.uniform(0.0, WIND_MAX_M_S),
        wind_towards_rad=rng.uniform(0.0, 2.0 * np.pi),
        payload=Payload(PAYLOAD_MAX_KG * rng.random() if rng.random() < 0.5 else 0.0),
        seed=int(rng.integers(2**31)),
    )


def flown(config: PlantConfig, duration_s: float) -> Flown:
    """Fly, and align the telemetry as the product does: its longest unbroken judgeable stretch."""
    flight = as_flight(config, duration_s)
    front = front_for([flight], WINDOW_S)
    started = time.process_time()
    rows = rows_of(front, flight.telemetry)
    front_s = time.process_time() - started
    block_ns = np.concatenate([one.block.t_ns for one in rows])
    rate_ns = np.concatenate([one.rates.t_ns for one in rows])
    valid = np.concatenate([one.rates.commanded for one in rows])
    edges = np.flatnonzero(np.diff(valid, prepend=False, append=False)).reshape(-1, 2)
    first, stop = edges[np.argmax(edges[:, 1] - edges[:, 0])].tolist()
    low, high = np.searchsorted(block_ns, [rate_ns[first], rate_ns[stop - 1]]).tolist()
    raw = slice(low, high + 1)
    truth = None
    if config.fault is not None:
        truth = Truth(config.fault, config.rotor, config.phenomenology, config.onset_s)
    return Flown(
        flight=flight,
        airframe="" if config.airframe is None else config.airframe.name,
        t_s=block_ns[raw] * 1e-9,
        dt_s=front.align.dt_s,
        u=np.concatenate([one.rates.u for one in rows])[first:stop],
        y=np.concatenate([one.rates.y for one in rows])[first:stop],
        gyro=np.concatenate([one.block.rate for one in rows])[raw],
        force=np.concatenate([one.block.force for one in rows])[raw],
        duty=np.concatenate([one.block.actuator for one in rows])[raw, :4],  # the outputs that have a rotor
        delay_s=WINDOW_S / 2,
        front_s=front_s,
        truth=truth,
    )


def healthy(one: Airframe, flights: int, seed: tuple[int, ...]) -> list[PlantConfig]:
    """Healthy flights in mixed conditions; flown one by one, for an hour of rows is half a gigabyte."""
    return [mixed(one, number, seed) for number in range(flights)]


def faulty(
    one: Airframe, first: int, seed: tuple[int, ...], phenomenologies: Sequence[float], onset_s: float
) -> list[PlantConfig]:
    """Every fault once for each phenomenology, on a drawn rotor. Conditions and rotors are the same for each scale.

    Flight `first` and the following ones of `mixed`. Rotors are drawn apart from the paths, so that no path tells one.
    """
    rotors = np.random.default_rng((*seed, first, 0)).permutation(np.arange(len(FAULTS)) % ROTORS + 1).tolist()
    return [
        replace(
            mixed(one, first + number, seed),
            fault=code,
            rotor=rotors[number],
            phenomenology=scale,
            onset_s=onset_s,
        )
        for scale in phenomenologies
        for number, code in enumerate(FAULTS)
    ]
