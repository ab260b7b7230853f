"""Emulated flights in mixed conditions, on airframes drawn by a seed, as rows for the monitors."""

from dataclasses import dataclass

import numpy as np

from mavdiag.chain import Front
from mavdiag.learning import gate_for, rows_of
from mavdiag.monitors.base import Rows
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.savgol import window_samples
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.physics.airframe import Airframe, Payload, draw_airframe
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import qdrone2

__all__ = ["FAULT_CODES", "HOVER", "Fault", "airframe_of", "fly"]

DT_S = 0.001
FAULT_CODES = tuple(f"F{kind}/SV{severity}" for kind in (1, 2, 3) for severity in (1, 2, 3))
HOVER = (1.504, 1047.2)  # kg and rad/s (10,000 rpm): T Table 5.1, 3.2.2
# shape, speed [m/s], heading [deg]
PATHS = (
    ("square", 0.5, 0),
    ("square", 0.8, 0),
    ("square", 0.5, 45),
    ("square", 0.8, 45),
    ("hover", 0.5, 0),
    ("circle", 0.5, 0),
    ("figure8", 0.5, 0),
)
FRONT = Front(AlignSpec(DT_S, Grid.NATIVE), gate_for("qdrone2"), RateSpec.of(DT_S, window_samples(DT_S)))


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault on a rotor from `onset_s` on, with its fitted fluctuation at `strength` 0..1."""

    code: str
    rotor: int
    onset_s: float
    strength: float


def airframe_of(seed: int) -> Airframe:
    """A specimen, aged or new by chance."""
    rng = np.random.default_rng([seed, 1])
    return draw_airframe(qdrone2(), aged=bool(rng.random() < 0.5), rng=rng)


def fly(
    airframe: Airframe,
    rng: np.random.Generator,
    duration_s: float,
    *,
    wind_m_s: float = 1.5,
    fault: Fault | None = None,
) -> list[Rows]:
    """One flight under conditions drawn by `rng`: path, wind up to `wind_m_s` from anywhere, payload up to 100 g."""
    shape, speed, heading = PATHS[int(rng.integers(len(PATHS)))]
    config = PlantConfig(
        airframe=airframe,
        trajectory=shape,
        speed_m_s=speed,
        heading_rad=float(np.radians(heading)),
        wind_m_s=float(rng.uniform(0, wind_m_s)),
        wind_towards_rad=float(rng.uniform(0, 2 * np.pi)),
        payload=Payload(float(rng.uniform(0, 0.1))),
        seed=int(rng.integers(2**31)),
        fault=None if fault is None else fault.code,
        rotor=1 if fault is None else fault.rotor,
        onset_s=0.0 if fault is None else fault.onset_s,
        phenomenology=1.0 if fault is None else fault.strength,
    )
    telemetry, _ = flight_telemetry(config, duration_s)
    return list(rows_of(FRONT, telemetry))
