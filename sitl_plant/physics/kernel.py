"""The compiled loop: one call flies the vehicle for many steps, with the thesis's parameter set or a recorded one.

Order within a step at time t_k: sensors read the state, the estimator and the controller act on it (or the given motor
commands take the controller's place), everything is recorded, then noise, rotors and body advance to t_(k+1) with the
new command. So a row of the output belongs to one instant. A recorded set (`Recorded`) has its own sensors, estimator
and motors, whose voltage follows the duty after a delay. Without one its steps are not compiled.

The random numbers of a flight come from one independent stream for each purpose, consumed in order of time. How a
flight is cut into calls therefore changes nothing, and a purpose that is not asked for changes no other.
"""

import math
from itertools import accumulate, pairwise, starmap
from typing import NamedTuple, TypeAlias

import numpy as np

from mavdiag.jit import cached_loop, inline
from mavdiag.telemetry import FloatArray
from sitl_plant.physics import control, dynamics, mocap, rotors, sensors
from sitl_plant.physics.air import Air, Dryden, Turbulence, advance_wind
from sitl_plant.physics.trajectory import DISARMED, FLYING, Path, reference

Faults: TypeAlias = sensors.SensorCondition
FLIGHT_STREAM = 0xF17  # our choice: which random streams those of a recorded set are
OUTAGE_S = (0.3, 2.0)  # an outage of the cameras lasts so long, uniform (our choice)


class Model(NamedTuple):
    """All constants of one flight; a recorded set has its own IMUs and estimator."""

    dt: float
    body: dynamics.Body
    ground: dynamics.Ground
    rotors: rotors.Rotors
    battery: rotors.Battery
    air: Air
    imu: sensors.Imu
    mocap: mocap.Mocap
    estimator: control.Estimator
    controller: control.Controller
    path: Path


class State(NamedTuple):
    """All that changes, updated in place; the last four are what the steps overwrite."""

    told: FloatArray  # what is recorded of a step, one after the other; others are views of it, see `told_columns`
    rigid: FloatArray  # (13,)
    wrench: FloatArray  # (3, 8)
    wind: FloatArray  # (3,)
    battery: FloatArray  # (2,)
    rotors: rotors.RotorState
    imu: sensors.ImuState
    mocap: mocap.MocapState
    estimate: FloatArray  # (9,)
    accel_filtered: FloatArray  # (3,)
    control: control.ControlState
    work: FloatArray  # (5, 13)
    truth: FloatArray  # (2, 6)
    path: FloatArray  # (9,)
    command: FloatArray  # (n,)


class Recorded(NamedTuple):
    """What a recorded set has beside `Model` and `State`: constants, and what changes in place."""

    imus: sensors.TwinImu
    estimates: control.TwinEstimator
    thrust_map: control.ThrustMap
    squared_per_thrust: float  # speed^2 of a rotor over its thrust by the map, battery gain included [rad^2/s^2/N]
    esc_period: int  # steps from one motor's telemetry to the next one's
    esc_first: int  # step of the first
    over_read: float  # reported over true speed
    queue: FloatArray  # (delay + 1, n) duties under way
    esc: FloatArray  # (n,) reported speeds [rad/s], NaN before the first frame; a view of `State.told`


class Noise(NamedTuple):
    """Standard normal and uniform numbers for the steps ahead, one row a step; for the cameras, one row a frame."""

    rotors: FloatArray  # (steps, 2 n)
    imu: FloatArray  # (steps, 6), (steps, 24) for a recorded set
    wind: FloatArray  # (steps, 3); gusts in m/s where `Air` passes them on
    markers: FloatArray  # (frames, m, 3)
    occlusion: FloatArray  # (frames, m), uniform


def told_columns(rotors: int) -> dict[str, slice]:
    """Where the parts of what is recorded stand; in one piece a step is recorded by one copy."""
    widths = {"setpoint": 3, "rate": 3, "wrench": 4, "motors": 1, "imu": sensors.CHANNELS, "estimate": control.ESTIMATE}
    widths |= {"rigid": dynamics.RIGID, "battery": 2, "duty": rotors, "speed": rotors, "esc": rotors}
    ends = accumulate(widths.values(), initial=0)
    return dict(zip(widths, starmap(slice, pairwise(ends)), strict=True))


@inline
def _sense(state: State, model: Model, own: Recorded | None, faults: Faults, noise: Noise, row: int, step: int) -> None:
    x, work, truth, last = state.rigid, state.work, state.truth, dynamics.STAGES - 1
    dynamics.derivative(x, state.wrench, last, model.body, model.ground, state.wind, work, 0)
    if own is None:
        sensors.feel(x, work, model.imu.position, truth[0])
        sensors.advance_imu(state.imu, model.imu, faults, truth[0], noise.imu, row, model.dt)
    else:
        for k in range(sensors.IMUS):
            sensors.feel(x, work, own.imus.position[k], truth[k])
        sensors.advance_imus(own.imus, faults, truth, state.rotors, noise.imu, row, step, model.dt)
        for i in range(sensors.CHANNELS):
            state.imu.reading[i] = own.imus.reading[0, i]
        if step >= own.esc_first and step % own.esc_period == 0:
            motor = len(own.esc) - 1 - (step // own.esc_period) % len(own.esc)  # the last motor is asked first
            own.esc[motor] = own.over_read * state.rotors.speed[motor]
    mocap.deliver_pose(state.mocap, model.mocap, step)


@inline
def _decide(state: State, model: Model, own: Recorded | None, commands: FloatArray, row: int, step: int) -> None:
    pose, estimate, volts, dt = state.mocap.pose, state.estimate, state.battery[0], model.dt
    path = state.path
    if own is None:
        control.advance_estimate(estimate, state.accel_filtered, model.estimator, state.imu.reading, pose[3], dt)
    else:
        control.advance_estimates(own.estimates, own.imus.reading, estimate, dt)
    if len(commands) > 0:
        state.control.motors[0] = DISARMED
        for i in range(len(state.control.duty)):
            state.control.duty[i] = commands[row, i]
            if commands[row, i] > 0.0:
                state.control.motors[0] = FLYING
        for axis in range(3):
            state.control.setpoint[axis] = state.control.rate[axis] = np.nan
        state.control.wrench[0] = np.nan
        return
    reference(model.path, step * dt, path)
    if own is None:
        mocap.hold_if_lost(state.mocap, model.mocap, step, path)
        velocity, r = state.mocap.velocity, estimate[5]
        control.control(state.control, model.controller, path, pose, velocity, r, estimate, None, volts, dt)
    else:
        control.see(own.estimates, pose)
        path[3:6], path[7] = 0.0, 0.0  # its V acts on the measured speed alone
        seen, lifts = own.estimates.velocity, own.thrust_map
        control.control(state.control, model.controller, path, pose, seen, seen[3], estimate, lifts, volts, dt)


@inline
def _move(
    state: State, model: Model, own: Recorded | None, condition: rotors.Condition, noise: Noise, row: int, step: int
) -> None:
    """On to the next step, with the speeds that the duties ask for (T Eq 2.10), or to which the motors settle."""
    command = state.command
    for i in range(len(command)):
        if own is None:
            full = model.battery.speed_per_volt * state.battery[0]
            command[i] = full * state.control.duty[i] * condition.speed_gain[i]
        else:
            slots = len(own.queue)
            own.queue[step % slots, i] = state.control.duty[i]
            volts = own.queue[(step + 1) % slots, i] * state.battery[0]
            squared = own.squared_per_thrust * control.thrust_of(own.thrust_map, volts)
            command[i] = np.sqrt(squared) * condition.speed_gain[i]
    advance_wind(state.wind, model.air, noise.wind, row)
    rotors.advance_noise(state.rotors, model.rotors, condition, noise.rotors, row)
    rotors.advance_rotors(state.rotors, model.rotors, condition, command, model.dt, state.wrench)
    dynamics.rk4_step(state.rigid, state.wrench, model.body, model.ground, state.wind, state.work, model.dt)
    dynamics.grip(state.rigid, model.ground)
    rotors.advance_battery(state.battery, model.battery, state.rotors.speed, model.dt)


@cached_loop
def fly(
    first: int,
    noise: Noise,
    commands: FloatArray,
    rows: FloatArray,
    model: Model,
    own: Recorded | None,
    condition: rotors.Condition,
    faults: Faults,
    state: State,
) -> None:
    """Fly as many steps as there are rows, from step `first` on; 0 is t = 0. `state` and `own` are updated in place.

    commands: (steps, n) duties, or (0, n) to let the controller fly. rows: see `told_columns`.
    """
    frame = 0
    for row in range(len(rows)):
        step = first + row
        if step % model.mocap.period == 0:
            mocap.observe(state.mocap, model.mocap, state.rigid, step, noise.markers, noise.occlusion, frame)
            frame += 1
        _sense(state, model, own, faults, noise, row, step)
        _decide(state, model, own, commands, row, step)
        for i in range(len(state.told)):  # slice assignment is slow in compiled code
            rows[row, i] = state.told[i]
        _move(state, model, own, condition, noise, row, step)


def recorded_streams(seed: int) -> list[np.random.Generator]:
    """Of a flight with a recorded set: for its levels, and for its sensors."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence([seed, FLIGHT_STREAM]).spawn(2)]


class Streams:
    """The streams of one flight.

    turbulence: Dryden gusts and where the wind blows to [rad]; None for the gusts of the vehicle's file.
    outages_per_min: how often on average the cameras see no marker at all; the gaps between are exponential.
    recorded: the vehicle has the two IMUs of a recorded set, which have a stream of their own.
    """

    def __init__(
        self, seed: int, dt_s: float, turbulence: tuple[Dryden, float] | None, outages_per_min: float, recorded: bool
    ) -> None:
        *children, gusts, self._lost = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(8))
        self.angle, self.rotors, self.imu, self.wind, self.markers, self.occlusion = children
        self._dt_s, self._imu_columns = dt_s, sensors.CHANNELS
        if recorded:
            self.imu, self._imu_columns = recorded_streams(seed)[1], 2 * sensors.IMUS * sensors.CHANNELS
        self._gusts = Turbulence(*turbulence, dt_s, gusts) if turbulence is not None else None
        self._outage_gap_s = 60.0 / outages_per_min if outages_per_min else math.inf
        self._outages = [(-math.inf, 0.0)]  # so far; the last one begins after all frames

    def draw(self, first: int, count: int, model: Model) -> Noise:
        """Numbers for `count` steps from step `first` on."""
        period, markers = model.mocap.period, len(model.mocap.markers)
        frame = math.ceil(first / period)
        frames = math.ceil((first + count) / period) - frame
        occlusion = self.occlusion.random((frames, markers))
        if self._outage_gap_s < math.inf:
            at_s = np.arange(frame, frame + frames, dtype=np.float64) * (period * self._dt_s)
            while frames and self._outages[-1][0] <= at_s[-1]:
                start = self._outages[-1][1] + float(self._lost.exponential(self._outage_gap_s))
                self._outages.append((start, start + float(self._lost.uniform(*OUTAGE_S))))
            for start, end in self._outages[1:]:
                occlusion[(start <= at_s) & (at_s < end)] = -1.0  # less than any probability: hidden
        return Noise(
            rotors=self.rotors.standard_normal((count, 2 * len(model.rotors.sign))),
            imu=self.imu.standard_normal((count, self._imu_columns)),
            wind=self.wind.standard_normal((count, 3)) if self._gusts is None else self._gusts.draw(count),
            markers=self.markers.standard_normal((frames, markers, 3)),
            occlusion=occlusion,
        )
