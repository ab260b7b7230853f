"""The options that every command of `sitl-plant` shares, and how they become a flight."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from mavdiag.errors import UsageError
from sitl_plant.autopilot.dialect import DIALECTS, Dialect, dialect_named
from sitl_plant.physics.airframe import Payload
from sitl_plant.physics.trajectory import Shape
from sitl_plant.plant import PlantConfig

__all__ = [
    "Drone",
    "Fault",
    "FlightPlan",
    "Onset",
    "PayloadKg",
    "Phenomenology",
    "Profile",
    "Rate",
    "Rotor",
    "Seed",
    "Trajectory",
    "TruthFile",
    "Wind",
    "flight_plan",
    "parse_speed",
]

Drone: TypeAlias = Annotated[int, typer.Option(help="Drone of the fleet: 1 (aged), 2 or 3 (new).")]
Trajectory: TypeAlias = Annotated[Shape, typer.Option(help="Path to fly.")]
Fault: TypeAlias = Annotated[str | None, typer.Option(metavar="CODE", help="Propeller fault, F1/SV1 to F3/SV3.")]
Rotor: TypeAlias = Annotated[
    int, typer.Option(help="Damaged rotor: 1 rear right, 2 front right, 3 rear left, 4 front left.")
]
Onset: TypeAlias = Annotated[float, typer.Option(metavar="S", help="Flight time at which the fault begins.")]
Phenomenology: TypeAlias = Annotated[
    float, typer.Option(help="Scale of the fitted, non-physical part of the fault: 0, 0.5 or 1.")
]
Rate: TypeAlias = Annotated[
    float | None, typer.Option(metavar="HZ", help="Rate of setpoint and IMU messages.  [default: the profile's]")
]
Seed: TypeAlias = Annotated[int, typer.Option(help="Equal seeds give equal flights, bit for bit.")]
Wind: TypeAlias = Annotated[float, typer.Option(metavar="M_S", help="Mean wind, with gusts.")]
PayloadKg: TypeAlias = Annotated[float, typer.Option("--payload", metavar="KG", help="Point mass below the body.")]
Profile: TypeAlias = Annotated[str, typer.Option(metavar="NAME", help=f"Link profile: {', '.join(DIALECTS)}.")]
TruthFile: TypeAlias = Annotated[
    Path | None, typer.Option(metavar="FILE.jsonl", help="Write what really happened; it never goes over the link.")
]


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """What to fly and how to tell of it. rate_hz: the link rate, the profile's own if none was asked for."""

    config: PlantConfig
    dialect: Dialect
    rate_hz: float


def flight_plan(
    drone: int,
    trajectory: Shape,
    fault: str | None,
    rotor: int,
    onset_s: float,
    phenomenology: float,
    rate_hz: float | None,
    seed: int,
    wind_m_s: float,
    payload_kg: float,
    profile: str,
) -> FlightPlan:
    """Check the options and put them together. Raises UsageError for what cannot be flown."""
    dialect = dialect_named(profile)
    rates = dialect.rates_hz(rate_hz)
    if fault is None and onset_s > 0.0:
        raise UsageError("--onset needs a fault: add --fault F2/SV2")
    if onset_s < 0.0:
        raise UsageError(f"--onset must be zero or more, not {onset_s:g}")
    config = PlantConfig(
        drone=drone,
        trajectory=trajectory,
        fault=fault,
        rotor=rotor,
        onset_s=onset_s,
        phenomenology=phenomenology,
        wind_m_s=wind_m_s,
        payload=Payload(payload_kg),
        seed=seed,
    )
    return FlightPlan(config, dialect, rates[dialect.profile.imu])


def parse_speed(text: str) -> float | None:
    """Flight seconds a second; None for "max". Raises UsageError for anything else.

    >>> parse_speed("2"), parse_speed("max")
    (2.0, None)
    """
    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0.01 <= speed <= 100.0:
        raise UsageError(f"speed must be 0.01 to 100, or max, not {text!r}")
    return speed
