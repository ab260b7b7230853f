"""The plant: configure a flight, advance it, read what the vehicle and its sensors did.

    plant = Plant(PlantConfig(drone=1, fault="F2/SV2", rotor=3, onset_s=10.0, seed=7))
    samples = plant.advance(1000)          # one second, flown by the thesis's cascade
    samples = plant.drive(duty, 4)         # four steps with these motor commands, from whatever autopilot

Equal configurations give equal bits, however the flight is cut into calls of `advance` and `drive`. What is changed in
flight takes effect with the next step.
"""

import math
from collections import deque
from dataclasses import dataclass, field, fields, replace
from itertools import compress
from typing import Literal, NamedTuple

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.units import S_PER_H
from sitl_plant.physics.air import Dryden, dryden
from sitl_plant.physics.airframe import NEVER, NO_PAYLOAD, Airframe, Payload, drone, step_at
from sitl_plant.physics.control import Controller
from sitl_plant.physics.faults import Injection, fault_injection, rotor_condition, sensor_condition
from sitl_plant.physics.kernel import Model, Recorded, Streams, fly, told_columns
from sitl_plant.physics.parameters import STEP_S, initial_state, make_model, recorded_set, reload
from sitl_plant.physics.trajectory import ARM_S, LIFT_S, REFERENCE, Leg, Nose, Path, Shape, follow, landing_time, path
from sitl_plant.vehicle import Vehicle, qdrone2

STEP_NS = round(STEP_S * 1e9)
WEAR_STEPS = 1000  # wear is held for a second
SETTLING_STEPS = 10_000  # hover flown, and not shown, before t = 0: filters, integrals and the wind are settled
CHANGES_MAX = 1000  # changes kept for who takes them
MOST_OUTAGES_PER_MIN = 20.0


@dataclass(frozen=True, slots=True)
class PlantConfig:
    """One flight. Raises UsageError if it cannot be.

    rotor: the damaged one, numbered as in the vehicle's file; T Eq 2.2-2.4 has 1 rear right, 2 front right, 3 rear
    left, 4 front left. start: "hover" in the air, where there is no ground; "ground" disarmed on the ground.
    """

    drone: int = 1  # 1 (aged), 2, 3 (new)
    trajectory: str = "square"
    speed_m_s: float = 0.5
    size_m: float = 1.0
    heading_rad: float = 0.0
    nose: str = "fixed"  # along the heading; "path": along the path; "spin": turns steadily
    altitude_m: float = 1.0
    fault: str | None = None  # a code such as "F2/SV2"
    rotor: int = 1
    onset_s: float = 0.0  # flight time at which the fault begins; 0 for a fault from the start
    phenomenology: float = 1.0  # scale of the fitted part of the fault, see `sitl_plant.physics.faults`
    injections: tuple[Injection, ...] = ()  # other causes
    wind_m_s: float = 0.0  # mean speed
    wind_towards_rad: float = math.pi / 4  # where the wind blows to; 0 is north, pi/2 east
    payload: Payload = NO_PAYLOAD
    turbulence_m_s: float = 0.0  # wind W20 of Dryden turbulence, in place of the vehicle file's gusts; 0 for the latter
    pickup: Payload | None = None  # taken up, and perhaps dropped, in flight; it moves as the vehicle does
    pickup_s: tuple[float, float] = (10.0, math.inf)  # flight times at which it is taken up, and dropped
    outages_per_min: float = 0.0  # how often motion capture is lost for `streams.OUTAGE_S`
    wear_per_h: tuple[float, ...] = ()  # share of its thrust that each rotor loses per hour of flight; empty for none
    worn_h: float = 0.0  # flown since the airframe was as drawn
    seed: int = 0
    vehicle: Vehicle = field(default_factory=qdrone2, repr=False)  # the type of which drones 1 to 3 are specimens
    airframe: Airframe | None = None  # another specimen instead
    start: Literal["hover", "ground"] = "hover"
    landed_s: float | None = None  # a flight from the ground is over, disarmed; None for never

    def __post_init__(self) -> None:
        for name, known in (("trajectory", Shape), ("nose", Nose)):
            if getattr(self, name) not in list(known):
                raise UsageError(f"no {name} {getattr(self, name)!r}: give one of {', '.join(known)}")
        recorded, ground = self.flown_vehicle.recorded, self.start == "ground"
        if self.commanded and (not ground or self.landed_s is not None or recorded):
            raise UsageError("a commanded flight starts on the ground, lands when told to; not with recorded vehicles")
        for name in ("speed_m_s", "size_m", "heading_rad", "altitude_m", "wind_m_s", "wind_towards_rad"):
            value, positive = getattr(self, name), name in ("speed_m_s", "size_m") or (ground and name == "altitude_m")
            if not math.isfinite(value) or (positive and value <= 0.0):
                more = " and positive" if positive else ""
                raise UsageError(f"{name} must be finite{more}, not {value:g}")
        flight = self.path()
        if ground and flight.land < flight.start:
            shortest = flight.start + landing_time(self.altitude_m, Shape(self.trajectory))
            raise UsageError(f"a flight with take-off and landing needs {shortest:.1f} s, not {self.landed_s:g}")
        if self.outages_per_min and recorded is not None:
            raise UsageError("the recorded QDrone 2 does not fly through outages of motion capture; leave them out")
        if self.seed < 0:
            raise UsageError(f"seed must be zero or more, not {self.seed}")
        self.all_injections()  # refuses a fault that does not exist
        self.gusts()
        if not 0.0 <= self.outages_per_min <= MOST_OUTAGES_PER_MIN:
            most = f"{MOST_OUTAGES_PER_MIN:g} times a minute"
            raise UsageError(f"motion capture may fail up to {most}, not {self.outages_per_min:g}")
        if not (math.isfinite(self.pickup_s[0]) and 0.0 < self.pickup_s[0] < self.pickup_s[1]):
            raise UsageError(f"a pick-up must be after the start and before the drop, not at {self.pickup_s[0]:g} s")
        fits = len(self.wear_per_h) in (0, len(self.flown_vehicle.rotors)) and self.worn_h >= 0.0
        if not (fits and all(0.0 <= loss <= 1.0 for loss in self.wear_per_h)):
            raise UsageError("wear needs a loss of 0 to 1 per hour for each rotor, and hours of zero or more")

    def gusts(self) -> Dryden | None:
        """The turbulence at the height of the path, None if it was not asked for."""
        return dryden(self.turbulence_m_s, self.altitude_m, self.wind_m_s) if self.turbulence_m_s else None

    def path(self) -> Path:
        """What the controller follows."""
        shape, form = Shape(self.trajectory), (self.size_m, self.speed_m_s, self.heading_rad, self.altitude_m)
        land_s = math.inf if self.landed_s is None else self.landed_s - landing_time(self.altitude_m, shape)
        recorded, ground = self.flown_vehicle.recorded, self.start == "ground"
        ground_s = (recorded.arm_s, recorded.lift_s) if recorded else (ARM_S, LIFT_S)
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


class Change(NamedTuple):
    """One change in flight, in effect from flight time `t_ns` on; an injection from its own onset on."""

    t_ns: int
    what: Injection | Literal["clear"]


@dataclass(frozen=True, slots=True, eq=False)
class PlantSamples:
    """n steps of a flight at 1 kHz with r rotors; body FRD, world NED, SI units.

    The set-points are those of the controller, NaN where `Plant.drive` was given the commands.
    """

    t_ns: IntArray  # (n,) since the start
    setpoint: FloatArray  # (n, 3) commanded roll, pitch, yaw [rad]
    rate_setpoint: FloatArray  # (n, 3) commanded body rates [rad/s]
    thrust_setpoint: FloatArray  # (n,) 0..1 of the thrust at full duty
    gyro: FloatArray  # (n, 3) measured [rad/s]
    accel: FloatArray  # (n, 3) measured specific force, (0, 0, -9.81) at rest
    attitude: FloatArray  # (n, 9) T's estimate (Eq 2.33)
    duty: FloatArray  # (n, r) 0..1, commanded
    battery_v: FloatArray  # (n,) measured
    charge_ah: FloatArray  # (n,) truth, drawn from the battery since it was full
    motors: IntArray  # (n,) 0 disarmed, 1 armed and idle, 2 flying
    quaternion: FloatArray  # (n, 4) truth, body to world, w first
    position: FloatArray  # (n, 3) truth, of the centre of gravity
    velocity: FloatArray  # (n, 3) truth, of the centre of gravity
    omega: FloatArray  # (n, 3) truth, body rates [rad/s]
    rotor_speed: FloatArray  # (n, r) truth [rad/s]
    esc_speed: FloatArray  # (n, r) by the motors' telemetry [rad/s]: the truth, but for a recorded set

    def __len__(self) -> int:
        return len(self.t_ns)

    def rows(self, first: int, end: int) -> "PlantSamples":
        """The samples from `first` to before `end`."""
        return PlantSamples(*(getattr(self, column.name)[first:end] for column in fields(self)))


class Plant:
    """A vehicle at the first point of its path: hovering in trim, or standing on the ground."""

    def __init__(self, config: PlantConfig) -> None:
        self.config = config
        self.airframe = config.airframe or drone(config.vehicle, config.drone)
        self.rotors = rotors = len(self.airframe.vehicle.rotors)
        self._columns = told_columns(rotors)
        gusts, towards_rad = config.gusts(), config.wind_towards_rad
        wind = config.wind_m_s * np.array([math.cos(towards_rad), math.sin(towards_rad), 0.0])  # world NED
        turbulence = None if gusts is None else (gusts, towards_rad)
        recorded = self.airframe.vehicle.recorded
        self._streams = Streams(config.seed, STEP_S, turbulence, config.outages_per_min, recorded is not None)
        azimuth = self._streams.angle.uniform(0.0, 2.0 * np.pi, rotors)
        self._step, self._loaded = -SETTLING_STEPS, False
        self._set_injections(self._placed(config.all_injections()))
        self._model: Model = make_model(self.airframe, config.payload, config.path(), wind, gusts is not None)
        self._state = initial_state(self._model, azimuth, self.airframe.charge_used_ah)
        self._own: Recorded | None = None
        if recorded is not None:
            self._own = recorded_set(self.airframe, recorded, self._model, self._state, config.seed)
        self._changes: deque[Change] = deque(maxlen=CHANGES_MAX)
        if config.commanded:
            follow(Leg(), 0.0, np.zeros(REFERENCE))  # compiles it for the pilot, which would take a second in flight
        self.advance(SETTLING_STEPS)
        self._state.imu.drifted[:] = 0.0  # it begins with the flight

    @property
    def t_ns(self) -> int:
        """Time of the next sample, from the start of the flight."""
        return self._step * STEP_NS

    def advance(self, steps: int) -> PlantSamples:
        """Fly `steps` of 1 ms by the controller and return what happened. Raises UsageError if it is negative."""
        return self._run(steps, np.empty((0, self.rotors)))

    def drive(self, commands: FloatArray, steps: int) -> PlantSamples:
        """Run `steps` of 1 ms with the motor commands of any autopilot, and return what the sensors measured.

        A row holds what was measured when its command took effect: an autopilot outside answers one step later.
        commands: duty 0..1, (r,) held for all steps or (steps, r). Raises UsageError for another shape or size.
        """
        held = np.asarray(commands, dtype=np.float64)
        if held.shape not in ((self.rotors,), (steps, self.rotors)):
            raise UsageError(f"{self.rotors} motor commands are needed for {steps} steps, not an array of {held.shape}")
        if not np.all((held >= 0.0) & (held <= 1.0)):
            raise UsageError("motor commands must be 0 to 1")
        # a copy that can be written to: for a read-only array the loop would be compiled once more
        return self._run(steps, np.array(np.broadcast_to(held, (max(steps, 0), self.rotors)), order="C"))

    def inject(self, injection: Injection) -> None:
        """Add a cause; an onset that is past means from the next step on. Raises UsageError for one that cannot be."""
        placed = self._placed((replace(injection, onset_s=max(injection.onset_s, self._step * STEP_S)),))
        self._set_injections((*self._injections, *placed))
        self._changes.append(Change(self.t_ns, placed[0]))

    def clear(self) -> None:
        """Take all causes away, those of the configuration too; what sensors drifted is taken back."""
        self._set_injections(())
        self._changes.append(Change(self.t_ns, "clear"))

    def take_controller(self, controller: Controller) -> None:
        """Let another controller fly from the next step on."""
        self._model = self._model._replace(controller=controller)

    def lead(self, leg: Leg) -> None:
        """Lead a commanded flight along `leg` from the next step on. Raises UsageError for one with its own path."""
        if not self.config.commanded:
            raise UsageError(f"the path {self.config.trajectory} is followed without commands")
        self._model = self._model._replace(path=self._model.path._replace(leg=leg))

    def take_changes(self) -> tuple[Change, ...]:
        """What was changed since the last call, for the truth file; of more than 1000 changes the last."""
        taken = tuple(self._changes)
        self._changes.clear()
        return taken

    def _placed(self, injections: tuple[Injection, ...]) -> tuple[Injection, ...]:
        for injection in injections:
            if injection.rotor not in range(1, self.rotors + 1):
                raise UsageError(f"rotor must be 1 to {self.rotors}, not {injection.rotor}")
        drawn = self._streams.angle.uniform(0.0, 2.0 * np.pi, len(injections)).tolist()
        return tuple(
            injection if injection.angle_rad is not None else replace(injection, angle_rad=angle)
            for injection, angle in zip(injections, drawn, strict=True)
        )

    def _set_injections(self, injections: tuple[Injection, ...]) -> None:
        self._injections = injections
        self._changes_at = self._step  # the condition is worked out before the next step

    def _run(self, steps: int, commands: FloatArray) -> PlantSamples:
        if steps < 0:
            raise UsageError(f"cannot advance by {steps} steps")
        rows, first, done = np.empty((steps, len(self._state.told))), self._step, 0
        while done < steps:
            if self._step >= self._changes_at:
                self._renew_condition()
            count = min(steps - done, self._changes_at - self._step)
            noise, part = self._streams.draw(self._step, count, self._model), slice(done, done + count)
            held = self._model, self._own, self._rotors, self._sensors, self._state
            fly(self._step, noise, commands[part], rows[part], *held)
            self._step += count
            done += count
        t_ns = (first + np.arange(steps, dtype=np.int64)) * STEP_NS
        told = {name: rows[:, columns] for name, columns in self._columns.items()}
        thrust = told["wrench"][:, 0] / (self._model.controller.full_thrust * self.rotors)
        imu, rigid, speed, (battery_v, charge_ah) = told["imu"], told["rigid"], told["speed"], told["battery"].T
        sensed = imu[:, :3], imu[:, 3:], told["estimate"], told["duty"], battery_v, charge_ah
        truth = rigid[:, 6:10], rigid[:, :3], rigid[:, 3:6], rigid[:, 10:13], speed
        motors = told["motors"][:, 0].astype(np.int64)
        esc = told["esc"] if self._own else speed
        return PlantSamples(t_ns, told["setpoint"], told["rate"], thrust, *sensed, motors, *truth, esc)

    def _renew_condition(self) -> None:
        changes = [injection.first_step(STEP_S) for injection in self._injections]
        present = list(compress(self._injections, [first <= self._step for first in changes]))
        self._rotors = rotor_condition(self.airframe, present, STEP_S)
        self._sensors = sensor_condition(present)
        self._state.imu.drifted[self._sensors.drift == 0.0] = 0.0
        if self.config.wear_per_h:
            lost = np.array(self.config.wear_per_h) * (self.config.worn_h + max(self._step * STEP_S, 0.0) / S_PER_H)
            self._rotors.thrust_gain[:] *= np.maximum(1.0 - lost, 0.0)
            changes.append(self._step + WEAR_STEPS)
        if self.config.pickup is not None:
            first, end = (step_at(t_s, STEP_S) for t_s in self.config.pickup_s)
            changes += [first, end]
            hangs = first <= self._step < end
            if hangs != self._loaded:
                payloads = (self.config.payload, *((self.config.pickup,) if hangs else ()))
                self._model = reload(self._model, self._state, self.airframe, payloads)
                self._loaded = hangs
        self._changes_at = min((step for step in changes if step > self._step), default=NEVER)
