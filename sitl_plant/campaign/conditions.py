"""What a campaign flies in: manoeuvres, and the named conditions of healthy flight, as tables.

A condition is either of the flight (turbulence, a pick-up, ...) or of the airframe's build (resonance, filters, link).
A baseline is learnt without the first and with the second. Sizes are estimates unless a source is named.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from mavdiag.errors import UsageError
from mavdiag.units import G
from sitl_plant.autopilot.telemetry import LinkSpec
from sitl_plant.physics.parameters import STEP_S
from sitl_plant.physics.sensors import isolating_hz
from sitl_plant.vehicle import SoftMount, Vehicle

__all__ = [
    "CALM",
    "CONDITIONS",
    "MANOEUVRES",
    "USUAL",
    "Condition",
    "Conditions",
    "Manoeuvre",
    "built",
    "built_link",
    "parse_link",
]

CALM = "calm"
MOUNT_DAMPING = 0.1  # of isolators (estimate)


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """A named path.

    speed_m_s: along it.
    heading_rad: how far it is turned.
    nose: where the nose points, see `sitl_plant.physics.trajectory.Nose`.
    takeoff: it begins and ends on the ground.
    """

    shape: str
    speed_m_s: float = 0.5
    heading_rad: float = 0.0
    nose: str = "fixed"
    takeoff: bool = False


MANOEUVRES: Mapping[str, Manoeuvre] = {
    "square": Manoeuvre("square"),  # T 5.2
    "square-fast": Manoeuvre("square", speed_m_s=0.8),
    "square-turned": Manoeuvre("square", heading_rad=math.pi / 4),
    "hover": Manoeuvre("hover"),
    "circle": Manoeuvre("circle"),
    "figure8": Manoeuvre("figure8"),
    "square-nose": Manoeuvre("square", nose="path"),
    "circle-nose": Manoeuvre("circle", nose="path"),
    "figure8-nose": Manoeuvre("figure8", nose="path"),
    "hover-spin": Manoeuvre("hover", nose="spin"),
    "square-spin": Manoeuvre("square", nose="spin"),
    "square-takeoff": Manoeuvre("square", takeoff=True),
}
USUAL = tuple(name for name, one in MANOEUVRES.items() if one.nose == "fixed" and not one.takeoff)


@dataclass(frozen=True, slots=True)
class Condition:
    """One named condition. What is None or empty is left to the other factors of the design.

    manoeuvres: flown in turn.
    duration_s: of each flight.
    turbulence_m_s: wind W20 of Dryden turbulence.
    pickup_g, pickup_offset_mm: taken up early in the flight, so far beside the centre; half of the flights drop it.
    outages_per_min: of motion capture.
    session: the flight is on another day, with what changes from day to day.
    propellers: as share, how far each thrust coefficient of a new set may differ; another day as well.
    wear_per_h: as share, the most that a rotor loses per hour; up to `WEAR_H` hours have passed.
    filter_hz: on-chip corner of the IMU.
    resonance_hz: of the frame below the IMU, with its damping ratio.
    isolation: share of the rotors' line in hover that a soft mount of the IMU passes.
    rate_hz: of the link.
    """

    manoeuvres: tuple[str, ...] = ()
    duration_s: float | None = None
    wind_m_s: float | None = None
    payload_g: float | None = None
    turbulence_m_s: float = 0.0
    pickup_g: float = 0.0
    pickup_offset_mm: float = 0.0
    outages_per_min: float = 0.0
    session: bool = False
    propellers: float = 0.0
    wear_per_h: float = 0.0
    filter_hz: float | None = None
    resonance_hz: tuple[float, float] | None = None
    isolation: float | None = None
    rate_hz: float | None = None

    @property
    def another_day(self) -> bool:
        """Whether the flight belongs to another session than the baseline's flights."""
        return self.session or self.propellers > 0.0 or self.wear_per_h > 0.0


CONDITIONS: Mapping[str, Condition] = {
    CALM: Condition(),
    "turbulence-5": Condition(turbulence_m_s=5.0),
    "turbulence-8": Condition(turbulence_m_s=8.0),
    "wind-2": Condition(wind_m_s=2.0),
    "wind-5": Condition(wind_m_s=5.0),
    "battery-10min": Condition(duration_s=600.0),
    "payload-200": Condition(payload_g=200.0),
    "pick-up": Condition(pickup_g=200.0, pickup_offset_mm=20.0),
    "propellers-1": Condition(propellers=0.01),
    "propellers-3": Condition(propellers=0.03),
    "wear": Condition(wear_per_h=0.002),
    "yaw-turns": Condition(manoeuvres=("square-nose", "hover-spin", "circle-nose", "square-spin", "figure8-nose")),
    "mocap-loss": Condition(outages_per_min=2.0),
    "take-off": Condition(manoeuvres=("square-takeoff",)),
    "sessions": Condition(session=True),
    "resonance": Condition(resonance_hz=(165.0, 0.05)),  # on the rotors' line in hover, 167 Hz
    "isolation-10": Condition(isolation=1 / 10),
    "isolation-30": Condition(isolation=1 / 30),
    "imu-20hz": Condition(filter_hz=20.0),
    "imu-42hz": Condition(filter_hz=42.0),
    "imu-98hz": Condition(filter_hz=98.0),
    "imu-188hz": Condition(filter_hz=188.0),
    "link-100hz": Condition(rate_hz=100.0),
    "link-200hz": Condition(rate_hz=200.0),
    "link-400hz": Condition(rate_hz=400.0),
}
"""Conditions by name."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """What a flight flies, and in what. payload_g hangs 5 cm below the centre, up to 1 cm beside it.

    condition: a name of `CONDITIONS`.
    """

    manoeuvre: str = "square"
    wind_m_s: float = 0.0
    payload_g: float = 0.0
    condition: str = CALM

    def applied(self) -> "Conditions":
        """With what the named condition says of wind and payload."""
        row = CONDITIONS[self.condition]
        wind = self.wind_m_s if row.wind_m_s is None else row.wind_m_s
        payload = self.payload_g if row.payload_g is None else row.payload_g
        return replace(self, wind_m_s=wind, payload_g=payload)


def built(vehicle: Vehicle, condition: str) -> Vehicle:
    """The vehicle as a condition has it built: filter and mount of its IMU."""
    row, imu = CONDITIONS[condition], vehicle.imu
    if row.filter_hz is not None:
        imu = replace(imu, filter_hz=row.filter_hz)
    if row.resonance_hz is not None:
        imu = replace(imu, mount=SoftMount(*row.resonance_hz))
    if row.isolation is not None:
        lift = vehicle.body.mass_kg * G / (len(vehicle.rotors) * vehicle.propulsion.thrust_coefficient_n_s2)
        line_hz = math.sqrt(lift) / (2.0 * math.pi)
        imu = replace(imu, mount=SoftMount(isolating_hz(line_hz, row.isolation, MOUNT_DAMPING, STEP_S), MOUNT_DAMPING))
    return vehicle if imu == vehicle.imu else replace(vehicle, imu=imu)


def built_link(link: str, condition: str) -> str:
    """The link as a condition has it. Raises UsageError for a rate that its profile does not grant."""
    rate_hz = CONDITIONS[condition].rate_hz
    if rate_hz is None:
        return link
    profile = parse_link(link).profile
    return f"{profile}@{LinkSpec(profile, rate_hz).rate_hz:g}"


def parse_link(text: str) -> LinkSpec:
    """A link such as "qdrone2@1000": profile and rate [Hz]. Raises UsageError for what cannot be.

    >>> parse_link("ardupilot@100")
    LinkSpec(profile='ardupilot', rate_hz=100.0, loss=0.0)
    """
    profile, _, rate = text.partition("@")
    try:
        return LinkSpec(profile, float(rate) if rate else None)
    except ValueError:
        raise UsageError(f"link must be a number, not {rate!r}") from None
