"""The plant: configure a flight, advance it, read what the vehicle and its sensors did.

    plant = Plant(PlantConfig(drone=1, fault="F2/SV2", rotor=3, onset_s=10.0, seed=7))
    samples = plant.advance(1000)          # one second, flown by the thesis's cascade
    samples = plant.drive(duty, 4)         # four steps with these motor commands, from whatever autopilot

Equal configurations give equal bits, however the flight is cut into calls of `advance` and `drive`.
"""

import math
from dataclasses import dataclass, field, fields, replace
from typing import Literal

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray, IntArray
from sitl_plant.physics.airframe import NO_PAYLOAD, Airframe, Payload, drone
from sitl_plant.physics.attitude import ESTIMATE
from sitl_plant.physics.dynamics import RIGID
from sitl_plant.physics.faults import parse_fault
from sitl_plant.physics.injections import NEVER, Injection, rotor_condition, sensor_condition
from sitl_plant.physics.kernel import Model, Rows, fly
from sitl_plant.physics.loading import PickUp, carried, reload
from sitl_plant.physics.parameters import STEP_S, initial_state, make_model
from sitl_plant.physics.recorded_log import RecordedLog
from sitl_plant.physics.recorded_set import recorded_flight
from sitl_plant.physics.sessions import Wear
from sitl_plant.physics.streams import MOST_OUTAGES_PER_MIN, Streams
from sitl_plant.physics.trajectory import ARM_S, LIFT_S, Nose, Path, Shape, landing_time, path
from sitl_plant.physics.turbulence import Dryden, dryden
from sitl_plant.vehicle import Vehicle, qdrone2

__all__ = ["STEP_NS", "Plant", "PlantConfig", "PlantSamples"]

STEP_NS = round(STEP_S * 1e9)
WEAR_STEPS = 1000  # wear is held for a second
SETTLING_STEPS = 10_000  # hover flown, and not shown, before t = 0: filters, integrals and the wind are settled


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
    def flown_vehicle(self) -> Vehicle:
        """The type of the specimen that flies."""
        return self.vehicle if self.airframe is None else self.airframe.vehicle

    def all_injections(self) -> tuple[Injection, ...]:
        """The fault by code, if any, and the other injections."""
        if self.fault is None:
            return self.injections
        damage = parse_fault(self.fault).damage(self.phenomenology)
        return (Injection(damage, self.rotor, self.onset_s), *self.injections)


@dataclass(frozen=True, slots=True, eq=False)
class PlantSamples:
    """n steps of a flight at 1 kHz with r rotors; body FRD, world NED, SI units.

    The set-points are those of the cascade, NaN where `Plant.drive` was given the commands.

    t_ns: (n,) since the start.
    setpoint: (n, 3) commanded roll, pitch, yaw [rad].
    rate_setpoint: (n, 3) commanded body rates [rad/s].
    thrust_setpoint: (n,) 0..1 of the thrust at full duty.
    gyro: (n, 3) measured [rad/s].
    accel: (n, 3) measured specific force, (0, 0, -9.81) at rest.
    attitude: (n, 9) T's estimate (Eq 2.33).
    duty: (n, r) 0..1, commanded.
    battery_v: (n,) measured.
    motors: (n,) 0 disarmed, 1 armed and idle, 2 flying.
    quaternion: (n, 4) truth, body to world, w first.
    position: (n, 3) truth, of the centre of gravity.
    velocity: (n, 3) truth, of the centre of gravity.
    omega: (n, 3) truth, body rates [rad/s].
    rotor_speed: (n, r) truth [rad/s].
    esc_speed: (n, r) as the motors' telemetry reports it [rad/s]: the truth, but for a vehicle as it was recorded.
    log: (n, k) for `sitl_plant.physics.recorded_log.RecordedLog`; k is 0 for a vehicle that keeps none.
    """

    t_ns: IntArray
    setpoint: FloatArray
    rate_setpoint: FloatArray
    thrust_setpoint: FloatArray
    gyro: FloatArray
    accel: FloatArray
    attitude: FloatArray
    duty: FloatArray
    battery_v: FloatArray
    motors: IntArray
    quaternion: FloatArray
    position: FloatArray
    velocity: FloatArray
    omega: FloatArray
    rotor_speed: FloatArray
    esc_speed: FloatArray
    log: FloatArray

    def __len__(self) -> int:
        return len(self.t_ns)

    def rows(self, first: int, end: int) -> "PlantSamples":
        """The samples from `first` to before `end`."""
        return PlantSamples(*(getattr(self, column.name)[first:end] for column in fields(self)))


class Plant:
    """A vehicle at the first point of its path: hovering in trim, or standing on the ground, as its configuration says.

    Before t = 0 it stays there for 10 s that are not shown.
    """

    def __init__(self, config: PlantConfig) -> None:
        self.config = config
        self.airframe = config.airframe or drone(config.vehicle, config.drone)
        self.rotors = rotors = len(self.airframe.vehicle.rotors)
        gusts = config.gusts()
        blown = None if gusts is None else (gusts, config.wind_towards_rad)
        self._streams = Streams(config.seed, STEP_S, blown, config.outages_per_min)
        azimuth = self._streams.angle.uniform(0.0, 2.0 * np.pi, rotors)
        self._injections = _placed(config.all_injections(), rotors, self._streams.angle)
        self._spans = [injection.span(STEP_S) for injection in self._injections]
        self._model = _model(config, self.airframe)
        self._loaded = False
        self._state = initial_state(self._model, azimuth, self.airframe.charge_used_ah)
        self._recorded = recorded_flight(self.airframe, self._model, self._state, config.seed)
        if self._recorded is not None:
            self._model = self._recorded.model
        self._step = -SETTLING_STEPS
        self._renew_condition()
        self.advance(SETTLING_STEPS)

    @property
    def t_ns(self) -> int:
        """Time of the next sample, from the start of the flight."""
        return self._step * STEP_NS

    def advance(self, steps: int) -> PlantSamples:
        """Fly `steps` of 1 ms by the cascade and return what happened. Raises UsageError if it is negative."""
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

    def _run(self, steps: int, commands: FloatArray) -> PlantSamples:
        if steps < 0:
            raise UsageError(f"cannot advance by {steps} steps")
        rows, log = _empty_rows(steps, self.rotors), np.empty((steps, self._recorded.columns if self._recorded else 0))
        done = 0
        while done < steps:
            if self._step >= self._changes_at:
                self._renew_condition()
            count = min(steps - done, self._changes_at - self._step)
            part = rows if count == steps else Rows(*(column[done : done + count] for column in rows))
            self._fly(count, commands[done : done + count], part, log[done : done + count])
            done += count
        return _samples(rows, log, self._step - steps, self._model)

    def _fly(self, count: int, commands: FloatArray, rows: Rows, log: FloatArray) -> None:
        """Fly `count` steps, over which the condition stays the same."""
        noise, condition = self._streams.draw(self._step, count, self._model), (self._rotors, self._sensors)
        if self._recorded is None:
            fly(self._step, count, self._model, *condition, self._state, noise, commands, rows)
        else:
            self._recorded.fly(self._step, count, *condition, self._state, noise, commands, rows, log)
        self._step += count

    def _renew_condition(self) -> None:
        """Work out the condition at the present step and the step at which it changes next."""
        present = [
            injection
            for injection, (first, end) in zip(self._injections, self._spans, strict=True)
            if first <= self._step < end
        ]
        self._rotors = rotor_condition(self.airframe, present, STEP_S)
        self._sensors = sensor_condition(present)
        changes = [step for span in self._spans for step in span]
        if self.config.wear is not None:
            self._rotors.thrust_gain[:] *= self.config.wear.gain(self._step * STEP_S)
            changes.append(self._step + WEAR_STEPS)
        if self.config.pickup is not None:
            changes += [NEVER if step is None else step for step in self.config.pickup.span(STEP_S)]
            self._load(self.config.pickup)
        self._changes_at = min((step for step in changes if step > self._step), default=NEVER)

    def _load(self, pickup: PickUp) -> None:
        """Take the payload up or drop it, if that happens now."""
        hangs = carried(pickup, self._step, STEP_S)
        if hangs != self._loaded:
            payloads = (self.config.payload, pickup.payload) if hangs else (self.config.payload,)
            self._model = reload(self._model, self._state, self.airframe, payloads, pickup if hangs else None)
            if self._recorded is not None:
                self._recorded.model = self._model
            self._loaded = hangs


def _placed(injections: tuple[Injection, ...], rotors: int, rng: np.random.Generator) -> tuple[Injection, ...]:
    """The injections with every angle drawn that was left open. Raises UsageError for a rotor that is not there."""
    for injection in injections:
        if injection.rotor not in range(1, rotors + 1):
            raise UsageError(f"rotor must be 1 to {rotors}, not {injection.rotor}")
    drawn = rng.uniform(0.0, 2.0 * np.pi, len(injections)).tolist()
    return tuple(
        injection if injection.angle_rad is not None else replace(injection, angle_rad=angle)
        for injection, angle in zip(injections, drawn, strict=True)
    )


def _model(config: PlantConfig, airframe: Airframe) -> Model:
    towards = config.wind_towards_rad
    wind = config.wind_m_s * np.array([math.cos(towards), math.sin(towards), 0.0])
    return make_model(airframe, config.payload, config.path(), wind, config.gusts() is not None)


def _empty_rows(steps: int, rotors: int) -> Rows:
    wide = {"setpoint": 3, "rate_setpoint": 3, "imu": 6, "attitude": ESTIMATE, "rigid": RIGID}
    wide |= {"rotor_speed": rotors, "duty": rotors}
    return Rows(*(np.empty((steps, wide[name]) if name in wide else steps) for name in Rows._fields))


def _samples(rows: Rows, log: FloatArray, first: int, model: Model) -> PlantSamples:
    full = model.controller.full_thrust * len(model.rotors.sign)
    return PlantSamples(
        t_ns=(first + np.arange(len(rows.thrust), dtype=np.int64)) * STEP_NS,
        setpoint=rows.setpoint,
        rate_setpoint=rows.rate_setpoint,
        thrust_setpoint=rows.thrust / full,
        gyro=rows.imu[:, :3],
        accel=rows.imu[:, 3:],
        attitude=rows.attitude,
        duty=rows.duty,
        battery_v=rows.battery_v,
        motors=rows.motors.astype(np.int64),
        quaternion=rows.rigid[:, 6:10],
        position=rows.rigid[:, :3],
        velocity=rows.rigid[:, 3:6],
        omega=rows.rigid[:, 10:13],
        rotor_speed=rows.rotor_speed,
        esc_speed=RecordedLog.of(log).esc if log.shape[1] else rows.rotor_speed,
        log=log,
    )
