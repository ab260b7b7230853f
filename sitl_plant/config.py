"""What one flight of the plant is to be: vehicle, path, faults, wind, payload, seed."""

import math
from dataclasses import dataclass, field
from typing import Literal

from mavdiag.errors import UsageError
from sitl_plant.physics.airframe import NO_PAYLOAD, Airframe, Payload
from sitl_plant.physics.faults import parse_fault
from sitl_plant.physics.injections import Injection
from sitl_plant.physics.loading import PickUp
from sitl_plant.physics.sessions import Wear
from sitl_plant.physics.streams import MOST_OUTAGES_PER_MIN
from sitl_plant.physics.trajectory import ARM_S, LIFT_S, Nose, Path, Shape, landing_time, path
from sitl_plant.physics.turbulence import Dryden, dryden
from sitl_plant.vehicle import Vehicle, qdrone2

__all__ = ["PlantConfig", "fault_injection"]


@dataclass(frozen=True, slots=True)
class PlantConfig:
    """One flight. Raises UsageError if it cannot be.

    drone: 1 (aged), 2, 3 (new).
    nose: "fixed" along the heading, "path" along the path, "spin" turns steadily.
    fault: a code such as "F2/SV2".
    rotor: the damaged one, numbered as in the vehicle's file; T Eq 2.2-2.4 has 1 rear right, 2 front right,
        3 rear left, 4 front left.
    onset_s: flight time at which the fault begins; 0 for a fault from the start.
    phenomenology: scale of the fitted part of the fault, see `sitl_plant.physics.faults`.
    injections: other causes.
    wind_m_s: mean speed.
    wind_towards_rad: where the wind blows to; 0 is north, pi/2 east.
    turbulence_m_s: wind W20 of Dryden turbulence, in place of the gusts of the vehicle's file; 0 for the latter.
    pickup: a payload taken up, and perhaps dropped, in flight.
    outages_per_min: how often motion capture is lost for `streams.OUTAGE_S`.
    wear: what the propellers lose with the hours.
    vehicle: the type of which drones 1 to 3 are specimens.
    airframe: another specimen instead.
    start: "hover" in the air, where there is no ground; "ground" disarmed on the ground.
    landed_s: flight time at which a flight from the ground is over, disarmed; None for never.
    """

    drone: int = 1
    trajectory: str = "square"
    speed_m_s: float = 0.5
    size_m: float = 1.0
    heading_rad: float = 0.0
    nose: str = "fixed"
    altitude_m: float = 1.0
    fault: str | None = None
    rotor: int = 1
    onset_s: float = 0.0
    phenomenology: float = 1.0
    injections: tuple[Injection, ...] = ()
    wind_m_s: float = 0.0
    wind_towards_rad: float = math.pi / 4
    payload: Payload = NO_PAYLOAD
    turbulence_m_s: float = 0.0
    pickup: PickUp | None = None
    outages_per_min: float = 0.0
    wear: Wear | None = None
    seed: int = 0
    vehicle: Vehicle = field(default_factory=qdrone2, repr=False)
    airframe: Airframe | None = None
    start: Literal["hover", "ground"] = "hover"
    landed_s: float | None = None

    def __post_init__(self) -> None:
        if self.trajectory not in list(Shape):
            raise UsageError(f"no trajectory {self.trajectory!r}: give one of {', '.join(Shape)}")
        if self.nose not in list(Nose):
            raise UsageError(f"no nose {self.nose!r}: give one of {', '.join(Nose)}")
        self._check_ground()
        for name in ("speed_m_s", "size_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise UsageError(f"{name} must be positive, not {value:g}")
        for name in ("heading_rad", "altitude_m", "wind_m_s", "wind_towards_rad"):
            if not math.isfinite(getattr(self, name)):
                raise UsageError(f"{name} must be a finite number")
        if self.outages_per_min and self.flown_vehicle.recorded is not None:
            raise UsageError("the recorded QDrone 2 does not fly through outages of motion capture; leave them out")
        if self.seed < 0:
            raise UsageError(f"seed must be zero or more, not {self.seed}")
        self.all_injections()  # refuses a fault that does not exist
        self.gusts()
        if not 0.0 <= self.outages_per_min <= MOST_OUTAGES_PER_MIN:
            most = f"{MOST_OUTAGES_PER_MIN:g} times a minute"
            raise UsageError(f"motion capture may fail up to {most}, not {self.outages_per_min:g}")
        if self.wear is not None and len(self.wear.loss_per_h) != len(self.flown_vehicle.rotors):
            raise UsageError(f"wear needs a loss for each of {len(self.flown_vehicle.rotors)} rotors")

    def gusts(self) -> Dryden | None:
        """The turbulence at the height of the path, None if it was not asked for."""
        if not self.turbulence_m_s:
            return None
        return dryden(self.turbulence_m_s, self.altitude_m, self.wind_m_s)

    def _check_ground(self) -> None:
        if self.commanded and (self.start != "ground" or self.landed_s is not None or self.flown_vehicle.recorded):
            raise UsageError(
                "a commanded flight starts on the ground and lands when told to; not with recorded vehicles"
            )
        if self.start == "ground" and not self.altitude_m > 0.0:
            raise UsageError(f"altitude_m must be positive for a start on the ground, not {self.altitude_m:g}")
        flight = self.path()
        if self.start == "ground" and flight.land < flight.start:
            shortest = flight.start + landing_time(self.altitude_m, Shape(self.trajectory))
            raise UsageError(f"a flight with take-off and landing needs {shortest:.1f} s, not {self.landed_s:g}")

    def path(self) -> Path:
        """What the cascade follows."""
        shape, form = Shape(self.trajectory), (self.size_m, self.speed_m_s, self.heading_rad, self.altitude_m)
        land_s = math.inf if self.landed_s is None else self.landed_s - landing_time(self.altitude_m, shape)
        recorded, ground = self.flown_vehicle.recorded, self.start == "ground"
        ground_s = (recorded.ground.arm_s, recorded.ground.lift_s) if recorded else (ARM_S, LIFT_S)
        return path(shape, *form, Nose(self.nose), ground, land_s if ground else math.inf, ground_s)

    @property
    def commanded(self) -> bool:
        """Whether the vehicle waits for commands, see `Plant.lead`."""
        return self.trajectory == Shape.COMMANDED

    @property
    def flown_vehicle(self) -> Vehicle:
        """The type of the specimen that flies."""
        return self.vehicle if self.airframe is None else self.airframe.vehicle

    def all_injections(self) -> tuple[Injection, ...]:
        """The fault by code, if any, and the other injections."""
        if self.fault is None:
            return self.injections
        return (fault_injection(self.fault, self.rotor, self.onset_s, self.phenomenology), *self.injections)


def fault_injection(code: str, rotor: int, onset_s: float = 0.0, phenomenology: float = 1.0) -> Injection:
    """A fault of the thesis, by its code such as "F2/SV2", as a cause. Raises UsageError for an unknown code."""
    return Injection(parse_fault(code).damage(phenomenology), rotor, onset_s, name=code)
