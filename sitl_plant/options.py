"""The options that the commands of `sitl-plant` share, and how they become a flight."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps
from inspect import Signature, signature
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from typer import Option

from mavdiag.errors import UsageError
from sitl_plant.autopilot.dialect import DIALECTS, Dialect, dialect_named
from sitl_plant.physics.airframe import Payload, in_session_number
from sitl_plant.physics.airframe import drone as specimen
from sitl_plant.physics.trajectory import Nose, Shape
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import shipped_vehicles, vehicle_from

LONGEST_S = 1e6  # of a flight: 11 days (our choice)
STARTING = "starting the plant; the first start compiles it and takes up to a minute ..."
_VEHICLES = f"One of {', '.join(shipped_vehicles())}, or a file."
_ROTOR = "Damaged rotor, as the vehicle's file counts; qdrone2: 1 rear right, 2 front right, 3 rear left, 4 front left."
_PHENOMENOLOGY = "Scale of the fitted, non-physical part of the fault, 0 to 1."
_TURBULENCE = "Dryden turbulence of this wind at 20 ft, instead of the gusts [m/s]."

VehicleName: TypeAlias = Annotated[str, Option("--vehicle", metavar="NAME|FILE.toml", help=_VEHICLES)]
Drone: TypeAlias = Annotated[int, Option(help="Specimen of the vehicle: 1 (aged), 2 or 3 (new).")]
FaultCode: TypeAlias = Annotated[str | None, Option(metavar="CODE", help="Propeller fault, F1/SV1 to F3/SV3.")]
Phenomenology: TypeAlias = Annotated[float, Option(min=0.0, max=1.0, help=_PHENOMENOLOGY)]
Wind: TypeAlias = Annotated[float, Option(min=0.0, max=30.0, metavar="M_S", help="Mean wind, with gusts.")]
W20: TypeAlias = Annotated[float, Option(metavar="W20", help=_TURBULENCE)]
PayloadKg: TypeAlias = Annotated[float, Option(metavar="KG", help="Point mass below the body.")]
_TRUTH = "Write what really happened; it never goes over the link."
TruthFile: TypeAlias = Annotated[Path | None, Option(metavar="FILE.jsonl", help=_TRUTH)]


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """What to fly and how to send it."""

    config: PlantConfig
    dialect: Dialect
    rate_hz: float  # of set-point and IMU; the profile's own if none was asked for
    duration_s: float | None = None  # of the flight; None if it was left open


def flight_plan(
    vehicle: VehicleName = "qdrone2",
    drone: Drone = 1,
    trajectory: Annotated[Shape, Option(help="Path to fly.")] = Shape.SQUARE,
    nose: Annotated[Nose, Option(help="Nose to one side, along the path, or turning steadily.")] = Nose.FIXED,
    takeoff: Annotated[bool, Option("--takeoff", help="Start disarmed on the ground; end there.")] = False,
    fault: FaultCode = None,
    rotor: Annotated[int, Option(help=_ROTOR)] = 1,
    onset: Annotated[float, Option(metavar="S", help="Flight time at which the fault begins.")] = 0.0,
    phenomenology: Phenomenology = 1.0,
    rate: Annotated[float | None, Option(metavar="HZ", help="Of set-point and IMU.  [default: the profile's]")] = None,
    duration: Annotated[float | None, Option(metavar="S", help="Flight time.  [default: open; record 60 s]")] = None,
    seed: Annotated[int, Option(help="Equal seeds give equal flights, bit for bit.")] = 0,
    wind: Wind = 0.0,
    turbulence: W20 = 0.0,
    payload: PayloadKg = 0.0,
    session: Annotated[
        int, Option(help="Day of the specimen: 0 as drawn; others have their own battery and trim.")
    ] = 0,
    propellers: Annotated[float, Option(metavar="PERCENT", help="New healthy propellers; thrust +- this.")] = 0.0,
    profile: Annotated[str, Option(metavar="NAME", help=f"Link profile: {', '.join(DIALECTS)}.")] = "qdrone2",
    system_id: Annotated[int, Option(metavar="N", min=1, max=255, help="MAVLink system id of the vehicle.")] = 1,
) -> FlightPlan:
    """Check the options and put them together. Raises UsageError for what cannot be flown."""
    dialect = replace(dialect_named(profile), sysid=system_id)
    rates = dialect.rates_hz(rate)
    check_times(fault, onset, duration, rotor, phenomenology)
    commanded, kind = trajectory is Shape.COMMANDED, vehicle_from(vehicle)
    config = PlantConfig(
        vehicle=kind,
        drone=drone,
        airframe=in_session_number(specimen(kind, drone), session, propellers / 100),
        trajectory=trajectory,
        nose=nose,
        start="ground" if takeoff or commanded else "hover",
        landed_s=None if commanded else duration,
        fault=fault,
        rotor=rotor,
        onset_s=onset,
        phenomenology=phenomenology,
        wind_m_s=wind,
        payload=Payload(payload),
        turbulence_m_s=turbulence,
        seed=seed,
    )
    return FlightPlan(config, dialect, rates[dialect.profile.imu], duration)


def check_times(
    fault: str | None, onset_s: float, duration_s: float | None, rotor: int = 1, phenomenology: float = 1.0
) -> None:
    """Raise UsageError for a fault's option without one, an onset after the end, or a time that cannot be."""
    if duration_s is not None and not 0.0 < duration_s <= LONGEST_S:
        raise UsageError(f"duration must be positive and at most {LONGEST_S:g} s, not {duration_s:g}")
    if not (math.isfinite(onset_s) and onset_s >= 0.0):
        raise UsageError(f"--onset must be zero or more, not {onset_s:g}")
    if fault is None and (onset_s > 0.0 or rotor != 1 or phenomenology != 1.0):
        raise UsageError("--onset, --rotor and --phenomenology are of a fault: add --fault F2/SV2")
    if fault is not None and duration_s is not None and onset_s >= duration_s:
        raise UsageError(f"--onset {onset_s:g} is after the end of the flight: write less than {duration_s:g}")


def with_options(plan: Callable[..., Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A command line with the options of `plan` and the command's own. The command gets what `plan` returns first."""
    shared = signature(plan).parameters

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        own = list(signature(command).parameters.values())[1:]

        @wraps(command)
        def run(**options: Any) -> None:
            command(plan(**{name: options.pop(name) for name in shared}), **options)

        options = Signature([*own, *shared.values()])
        vars(run).update(__signature__=options)
        run.__annotations__ = {name: option.annotation for name, option in options.parameters.items()}
        return run

    return decorate


with_flight = with_options(flight_plan)


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
