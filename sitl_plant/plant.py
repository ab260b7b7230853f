"""The plant: configure a flight, advance it, read what the vehicle and its sensors did.

    plant = Plant(PlantConfig(drone=1, fault="F2/SV2", rotor=3, onset_s=10.0, seed=7))
    samples = plant.advance(1000)          # one second, flown by the thesis's cascade
    samples = plant.drive(duty, 4)         # four steps with these motor commands, from whatever autopilot
    plant.inject(fault_injection("F2/SV2", rotor=3))       # from the next step on

Equal configurations give equal bits, however the flight is cut into calls of `advance` and `drive`. What is changed in
flight takes effect with the next step.
"""

import math
from collections import deque
from dataclasses import dataclass, fields, replace

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray, IntArray
from sitl_plant.changes import Change, Renewal, SteadyWind
from sitl_plant.config import PlantConfig
from sitl_plant.physics.airframe import Airframe, drone
from sitl_plant.physics.attitude import ESTIMATE
from sitl_plant.physics.dynamics import RIGID
from sitl_plant.physics.injections import NEVER, Injection, rotor_condition, sensor_condition
from sitl_plant.physics.kernel import Model, Rows, fly
from sitl_plant.physics.loading import PickUp, carried, reload
from sitl_plant.physics.parameters import STEP_S, air_of, initial_state, make_model
from sitl_plant.physics.recorded_log import RecordedLog
from sitl_plant.physics.recorded_set import recorded_flight
from sitl_plant.physics.streams import Streams
from sitl_plant.physics.trajectory import Leg

__all__ = ["STEP_NS", "Plant", "PlantConfig", "PlantSamples"]

STEP_NS = round(STEP_S * 1e9)
WEAR_STEPS = 1000  # wear is held for a second
SETTLING_STEPS = 10_000  # hover flown, and not shown, before t = 0: filters, integrals and the wind are settled
CHANGES_MAX = 1000  # changes kept for who takes them


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
    charge_ah: (n,) truth, drawn from the battery since it was full.
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
    charge_ah: FloatArray
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
        self._step = -SETTLING_STEPS
        self._set_injections(_placed(config.all_injections(), rotors, self._streams.angle))
        self._model = _model(config, self.airframe)
        self._loaded = False
        self._state = initial_state(self._model, azimuth, self.airframe.charge_used_ah)
        self._recorded = recorded_flight(self.airframe, self._model, self._state, config.seed)
        if self._recorded is not None:
            self._model = self._recorded.model
        self._changes: deque[Change] = deque(maxlen=CHANGES_MAX)
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

    def inject(self, injection: Injection) -> None:
        """Add a cause to those that are there; an onset that is past means from the next step on.

        Raises UsageError for a rotor that is not there, or a cause that would be over.
        """
        now_s = self._step * STEP_S
        if injection.end_s <= now_s:
            raise UsageError(f"end_s must be later than the present {now_s:g} s, not {injection.end_s:g}")
        coming = replace(injection, onset_s=max(injection.onset_s, now_s))
        placed = _placed((coming,), self.rotors, self._streams.angle)
        self._set_injections((*self._injections, *placed))
        self._note(placed[0])

    def clear(self) -> None:
        """Take all causes away, those of the configuration too; what sensors drifted is taken back."""
        self._set_injections(())
        self._state.imu.drifted[:] = 0.0
        if self._recorded is not None:
            self._recorded.forget_drift()
        self._note(Renewal.CLEAR)

    def set_wind(self, wind: SteadyWind) -> None:
        """Let another mean wind blow, with gusts by the vehicle's file; turbulence that was asked for stays."""
        air = air_of(self.airframe.vehicle, _blowing(wind), self.config.gusts() is not None)
        self._set_model(self._model._replace(air=air))
        self._note(wind)

    def renew_battery(self) -> None:
        """Put a full battery in."""
        self._state.battery[:] = self._model.battery.open_circuit, 0.0
        self._note(Renewal.BATTERY)

    def lead(self, leg: Leg) -> None:
        """Lead a commanded flight along `leg` from the next step on. Raises UsageError for one with its own path."""
        if not self.config.commanded:
            raise UsageError(f"the path {self.config.trajectory} is followed without commands")
        self._set_model(self._model._replace(path=self._model.path._replace(leg=leg)))

    def take_changes(self) -> tuple[Change, ...]:
        """What was changed since the last call, for the truth file; of more than 1000 changes the last."""
        taken = tuple(self._changes)
        self._changes.clear()
        return taken

    def _note(self, what: Injection | SteadyWind | Renewal) -> None:
        self._changes.append(Change(self.t_ns, what))

    def _set_injections(self, injections: tuple[Injection, ...]) -> None:
        self._injections = injections
        self._spans = [injection.span(STEP_S) for injection in injections]
        self._changes_at = self._step  # the condition is worked out before the next step

    def _set_model(self, model: Model) -> None:
        self._model = model
        if self._recorded is not None:
            self._recorded.model = model

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
            self._set_model(reload(self._model, self._state, self.airframe, payloads, pickup if hangs else None))
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
    wind = _blowing(SteadyWind(config.wind_m_s, config.wind_towards_rad))
    return make_model(airframe, config.payload, config.path(), wind, config.gusts() is not None)


def _blowing(wind: SteadyWind) -> FloatArray:
    """(3,) world NED [m/s]."""
    return wind.speed_m_s * np.array([math.cos(wind.towards_rad), math.sin(wind.towards_rad), 0.0])


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
        charge_ah=rows.charge_ah,
        motors=rows.motors.astype(np.int64),
        quaternion=rows.rigid[:, 6:10],
        position=rows.rigid[:, :3],
        velocity=rows.rigid[:, 3:6],
        omega=rows.rigid[:, 10:13],
        rotor_speed=rows.rotor_speed,
        esc_speed=RecordedLog.of(log).esc if log.shape[1] else rows.rotor_speed,
        log=log,
    )
