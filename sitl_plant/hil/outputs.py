"""An autopilot's outputs become duties of the rotors, by the table `[hil]` of the vehicle file."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray, IntArray
from sitl_plant.vehicle import Hil, HilPilot, Vehicle

AutopilotName: TypeAlias = Literal["ardupilot", "px4"]


@dataclass(frozen=True, slots=True, eq=False)
class OutputMap:
    """Which output turns which rotor, n of them."""

    places: IntArray  # (n,) for each rotor its output, from 0
    pwm_us: tuple[float, float]  # the pulses of duty 0 and 1

    def from_pwm(self, pwm_us: Sequence[int]) -> FloatArray:
        """Duties (n,) of at least n pulses [us]; a pulse of 0, for an output that is off, is duty 0."""
        low, high = self.pwm_us
        return self.from_share((np.asarray(pwm_us, dtype=np.float64) - low) / (high - low))

    def from_share(self, shares: Sequence[float] | FloatArray) -> FloatArray:
        """Duties (n,) of at least n outputs of 0 to 1; others are held there, and NaN, for no output, is 0."""
        duties = np.clip(np.asarray(shares, dtype=np.float64)[self.places], 0.0, 1.0)
        return np.nan_to_num(duties, nan=0.0)

    def motor(self, rotor: int) -> int:
        """The autopilot's number of a rotor, both from 1."""
        return int(self.places[rotor - 1]) + 1


def output_map(vehicle: Vehicle, autopilot: AutopilotName) -> OutputMap:
    """The outputs of a vehicle under one kind of autopilot. Raises UsageError if its file does not tell them."""
    hil, pilot = pilot_of(vehicle, autopilot)
    return OutputMap(np.argsort(pilot.rotors), hil.pwm_us)


def pilot_of(vehicle: Vehicle, autopilot: AutopilotName) -> tuple[Hil, HilPilot]:
    """The tables `[hil]` and `[hil.NAME]`. Raises UsageError if they are missing, or do not name every rotor once."""
    if vehicle.hil is None:
        raise UsageError(f"{vehicle.name}: no autopilot can fly it: add a table [hil] to its file, as qdrone2.toml has")
    pilot = vehicle.hil.ardupilot if autopilot == "ardupilot" else vehicle.hil.px4
    if sorted(pilot.rotors) != list(range(1, len(vehicle.rotors) + 1)):
        wanted = f"each rotor 1 to {len(vehicle.rotors)} once, not {list(pilot.rotors)}"
        raise UsageError(f"{vehicle.name}: hil.{autopilot}.rotors must name {wanted}")
    return vehicle.hil, pilot
