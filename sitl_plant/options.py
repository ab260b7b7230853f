"""The options that the commands of `sitl-plant` share, and how they become a flight."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from mavdiag.errors import UsageError
from sitl_plant.autopilot.dialect import DIALECTS, Dialect, dialect_named
from sitl_plant.physics.airframe import Payload
from sitl_plant.physics.trajectory import Nose, Shape
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import shipped_vehicles, vehicle_from

__all__ = [
    "Drone",
    "Fault",
    "FlightPlan",
    "NoseMode",
    "Onset",
    "PayloadKg",
    "Phenomenology",
    "Profile",
    "Rate",
    "Rotor",
    "Seed",
    "Takeoff",
    "Trajectory",
    "TruthFile",
    "VehicleName",
    "Wind",
    "flight_plan",
    "parse_speed",
]

Drone: TypeAlias = Annotated[int, typer.Option(help="Drone of the fleet: 1 (aged), 2 or 3 (new).")]
Trajectory: TypeAlias = Annotated[Shape, typer.Option(help="Path to fly.")]
NoseMode: TypeAlias = Annotated[Nose, typer.Option(help="Where the nose points: one way, along the path, or around.")]
Takeoff: TypeAlias = Annotated[
    bool, typer.Option("--takeoff", help="Start disarmed on the ground; land before --duration is over.")
]
VehicleName: TypeAlias = Annotated[
    str,
    typer.Option("--vehicle", metavar="NAME|FILE.toml", help=f"One of {', '.join(shipped_vehicles())}, or a file."),
]
Fault: TypeAlias = Annotated[str | None, typer.Option(metavar="CODE", help="Propeller fault, F1/SV1 to F3/SV3.")]
Rotor: TypeAlias = Annotated[
    int,
    typer.Option(
        help="Damaged rotor, as the vehicle's file counts; qdrone2: 1, 2 right rear, front; 3, 4 left rear, front."
    ),
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
    """What to fly and how to send it.

    rate_hz: of set-point and IMU; the profile's own if none was asked for.
    """

    config: PlantConfig
    dialect: Dialect
    rate_hz: float


def flight_plan(
    vehicle: str,
    drone: int,
    trajectory: Shape,
    nose: Nose,
    takeoff: bool,
    fault: str | None,
    rotor: int,
    onset_s: float,
    phenomenology: float,
    rate_hz: float | None,
    duration_s: float | None,
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
    if duration_s is not None and not duration_s > 0.0:
        raise UsageError(f"duration must be positive, not {duration_s:g}")
    config = PlantConfig(
        vehicle=vehicle_from(vehicle),
        drone=drone,
        trajectory=trajectory,
        nose=nose,
        start="ground" if takeoff else "hover",
        landed_s=duration_s if takeoff else None,
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
