"""The plant under an autopilot outside: at rest on the ground until the autopilot turns its rotors.

Its outputs become duties of the rotors by the table `[hil]` of the vehicle file, which also has parameters to load.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray, IntArray
from sitl_plant.autopilot.dialect import PX4_KINDS, px4_rotors
from sitl_plant.physics.faults import Injection
from sitl_plant.physics.parameters import STEP_S
from sitl_plant.plant import Change, Plant, PlantConfig, PlantSamples
from sitl_plant.vehicle import Hil, HilPilot, Vehicle

AutopilotName: TypeAlias = Literal["ardupilot", "px4"]
Watch: TypeAlias = Callable[[PlantSamples, Sequence[Change]], None]
FLYING_M = 0.1  # height above the start at which a take-off counts (our choice)
FIRST_MOTOR = 101  # PX4's output function "Motor 1"


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
        duties = np.asarray(shares, dtype=np.float64)[self.places]
        return np.where(duties > 0.0, np.minimum(duties, 1.0), 0.0)

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


def parameter_file(vehicle: Vehicle, autopilot: AutopilotName, *, hardware: bool = False) -> str:
    """ArduPilot: lines of NAME,VALUE (.param). PX4: the tabs of QGroundControl (.params).

    hardware: for a PX4 flight controller in HIL mode, not for PX4 in simulation.
    Raises UsageError if the vehicle's file has no parameters for it.
    """
    pilot = pilot_of(vehicle, autopilot)[1]
    head = f"# {vehicle.name} of sitl-plant: suggested for a simulation, not for a vehicle that flies\n"
    if autopilot == "ardupilot":
        return head + "".join(f"{name},{value}\n" for name, value in pilot.parameters.items())
    rows = {**pilot.parameters, **px4_rotors(vehicle, [vehicle.rotors[number - 1] for number in pilot.rotors])}
    rows |= {"SYS_HITL": 1} if hardware else {}
    output = "HIL_ACT_FUNC" if hardware else "PWM_MAIN_FUNC"
    rows |= {f"{output}{1 + n}": FIRST_MOTOR + n for n in range(len(pilot.rotors))}
    lines = (f"1\t1\t{name}\t{value}\t{PX4_KINDS[type(value)]}\n" for name, value in rows.items())
    return head + "# Vehicle-Id Component-Id Name Value Type\n" + "".join(lines)


class Simulation:
    """One plant, driven for spans of any length; what is left of a step is carried over.

    config: vehicle, wind, payload, seed; it is flown from the ground, and its path is not used. after_takeoff: causes
    whose onset counts from the take-off. watch: is shown the samples of every span, and what was changed before it.
    now: the latest row, in samples of length 1.
    """

    def __init__(
        self, config: PlantConfig, after_takeoff: Sequence[Injection] = (), watch: Watch = lambda samples, changes: None
    ) -> None:
        self._after_takeoff, self._watch = after_takeoff, watch
        self.config = replace(config, start="ground", trajectory="hover", landed_s=None)
        self.restart()

    def restart(self) -> None:
        """A new flight, at rest on the ground, with the same seed."""
        self.plant = Plant(self.config)
        self.rotors = self.plant.rotors
        self.takeoff_s: float | None = None
        self._left = 0.0
        self.now = self.plant.drive(np.zeros(self.rotors), 1)  # the sensors are read once, with motors off
        self._watch(self.now, self.plant.take_changes())

    @property
    def t_s(self) -> float:
        """Flight time so far: of the row after the latest."""
        return self.plant.t_ns * 1e-9

    def step(self, duties: FloatArray, span_s: float) -> PlantSamples:
        """Fly for `span_s` with these duties (n,) and return the latest row, the old one if no whole step was due."""
        due = self._left + span_s / STEP_S
        steps = math.floor(due + 1e-6)
        self._left = due - steps
        if steps > 0:
            samples = self.plant.drive(duties, steps)
            self.now = samples if steps == 1 else samples.rows(steps - 1, steps)
            self._watch(samples, self.plant.take_changes())
            if self.takeoff_s is None and self.now.position[0, 2] < -FLYING_M:
                self.takeoff_s = self.t_s
                for cause in self._after_takeoff:
                    self.plant.inject(replace(cause, onset_s=cause.onset_s + self.t_s))
        return self.now
