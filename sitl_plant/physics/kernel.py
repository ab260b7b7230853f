"""The compiled loop: one call flies the vehicle for many steps, with the thesis's parameter set or a recorded one.

Order within a step at time t_k: sensors read the state, the estimator and the controller act on it (or the given motor
commands take the controller's place), everything is recorded, then noise, rotors and body advance to t_(k+1) with the
new command. So a row of the output belongs to one instant. A recorded set (`Recorded`) has its own sensors, controller
and motors: these turn at the speed at which the rotor lifts what the manufacturer's map says of its voltage, times what
it really lifts; the voltage follows the duty after a delay. Without one its steps are not compiled.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from mavdiag.jit import cached, inline, jit, source_digest
from mavdiag.telemetry import FloatArray
from sitl_plant.physics.air import Air, advance_wind
from sitl_plant.physics.control import (
    Controller,
    ControlState,
    Estimator,
    Feedback,
    Loop,
    LoopState,
    advance_estimate,
    control,
    decide,
    estimate_attitude,
    thrust_of,
)
from sitl_plant.physics.dynamics import RIGID, STAGES, Body, Ground, derivative, grip, rk4_step
from sitl_plant.physics.mocap import Mocap, MocapState, deliver_pose, hold_if_lost, observe
from sitl_plant.physics.rotors import (
    Battery,
    Condition,
    Rotors,
    RotorState,
    advance_battery,
    advance_noise,
    advance_rotors,
)
from sitl_plant.physics.sensors import (
    CHANNELS,
    IMUS,
    Imu,
    ImuState,
    Mount,
    SensorCondition,
    TwinImu,
    TwinImuState,
    advance_imu,
    advance_imus,
    advance_mount,
    feel,
)
from sitl_plant.physics.trajectory import DISARMED, FLYING, REFERENCE, Path, reference

LOG = 49  # columns of a recorded set's log before the motors' telemetry


class Model(NamedTuple):
    """All constants of one flight; a recorded set has its own IMUs, estimator and controller."""

    dt: float
    body: Body
    ground: Ground
    rotors: Rotors
    battery: Battery
    air: Air
    imu: Imu
    mount: Mount
    mocap: Mocap
    estimator: Estimator
    controller: Controller
    path: Path


class State(NamedTuple):
    """All that changes, updated in place."""

    rigid: FloatArray  # (13,)
    wrench: FloatArray  # (3, 8)
    wind: FloatArray  # (3,)
    battery: FloatArray  # (2,)
    rotors: RotorState
    imu: ImuState
    mount: FloatArray  # (6, 2)
    mocap: MocapState
    estimate: FloatArray  # (9,)
    accel_filtered: FloatArray  # (3,)
    control: ControlState


class Recorded(NamedTuple):
    """What a recorded set has beside `Model` and `State`: constants, and what changes in place."""

    imus: TwinImu
    feedback: Feedback
    loop: Loop
    squared_per_thrust: float  # speed^2 of a rotor over its thrust by the map, battery gain included [rad^2/s^2/N]
    esc_period: int  # steps from one motor's telemetry to the next one's
    esc_first: int  # step of the first
    over_read: float  # reported over true speed
    imu_state: TwinImuState
    loop_state: LoopState
    queue: FloatArray  # (delay + 1, n) duties under way
    esc: FloatArray  # (n,) reported speeds [rad/s], NaN before the first frame


class Noise(NamedTuple):
    """Standard normal and uniform numbers for the steps ahead, one row a step; for the cameras, one row a frame."""

    rotors: FloatArray  # (steps, 2 n)
    imu: FloatArray  # (steps, 6), (steps, 24) for a recorded set
    wind: FloatArray  # (steps, 3); gusts in m/s where `Air` passes them on
    markers: FloatArray  # (frames, m, 3)
    occlusion: FloatArray  # (frames, m), uniform


class Rows(NamedTuple):
    """Where the flight is recorded, one row a step; the columns are those of `PlantSamples`."""

    setpoint: FloatArray
    rate_setpoint: FloatArray
    thrust: FloatArray
    imu: FloatArray
    attitude: FloatArray
    rigid: FloatArray
    rotor_speed: FloatArray
    duty: FloatArray
    battery_v: FloatArray
    charge_ah: FloatArray
    motors: FloatArray
    log: FloatArray  # (steps, LOG + n) of a recorded set, see `RecordedLog`; else (steps, 0)


class Block(NamedTuple):
    """What one call flies: `steps` from step `first`; 0 is t = 0."""

    first: int
    steps: int
    noise: Noise
    commands: FloatArray  # (steps, n) duties, or (0, n) to let the controller fly
    rows: Rows  # filled from row 0


class _Scratch(NamedTuple):
    """Arrays that one step needs and the next forgets."""

    work: FloatArray  # (5, 13)
    truth: FloatArray  # (2, 6)
    path: FloatArray  # (9,)
    command: FloatArray  # (n,)


@inline
def _sense(
    state: State,
    model: Model,
    own: Recorded | None,
    condition: SensorCondition,
    noise: Noise,
    row: int,
    step: int,
    scratch: _Scratch,
) -> None:
    derivative(state.rigid, state.wrench, STAGES - 1, model.body, model.ground, state.wind, scratch.work, 0)
    if own is None:
        felt = scratch.truth[0]
        feel(state.rigid, scratch.work, model.imu.position, felt)
        advance_mount(state.mount, model.mount, felt)
        advance_imu(state.imu, model.imu, condition, felt, noise.imu, row, model.dt)
    else:
        for k in range(IMUS):
            feel(state.rigid, scratch.work, own.imus.position[k], scratch.truth[k])
        advance_imus(own.imu_state, own.imus, condition, scratch.truth, state.rotors, noise.imu, row, step, model.dt)
        for i in range(CHANNELS):
            state.imu.reading[i] = own.imu_state.reading[0, i]
        if step >= own.esc_first and step % own.esc_period == 0:
            motor = len(own.esc) - 1 - (step // own.esc_period) % len(own.esc)  # the last motor is asked first
            own.esc[motor] = own.over_read * state.rotors.speed[motor]
    deliver_pose(state.mocap, model.mocap, step)


@inline
def _decide(
    state: State, model: Model, own: Recorded | None, commands: FloatArray, row: int, step: int, scratch: _Scratch
) -> None:
    reading, pose, dt = state.imu.reading, state.mocap.pose, model.dt
    if own is None:
        advance_estimate(state.estimate, state.accel_filtered, model.estimator, reading, pose[3], dt)
    else:
        estimate_attitude(own.loop_state, own.feedback, own.imu_state.reading, state.estimate, dt)
    if len(commands) > 0:
        _obey(state.control, commands, row)
        return
    path = scratch.path
    reference(model.path, step * dt, path)
    if own is None:
        hold_if_lost(state.mocap, model.mocap, step, path)
        control(state.control, model.controller, path, pose, state.mocap.velocity, state.estimate, dt)
    else:
        volts = state.battery[0]
        decide(state.control, own.loop_state, own.loop, own.feedback, path, pose, state.estimate, volts, dt)


@jit
def _obey(state: ControlState, commands: FloatArray, row: int) -> None:
    state.motors[0] = DISARMED
    for i in range(len(state.duty)):
        state.duty[i] = commands[row, i]
        if commands[row, i] > 0.0:
            state.motors[0] = FLYING
    for axis in range(3):
        state.setpoint[axis] = state.rate[axis] = np.nan
    state.wrench[0] = np.nan


@jit
def _copy(source: FloatArray, rows: FloatArray, row: int) -> None:
    """rows[row] = source; a plain loop, because slice assignment is slow in compiled code."""
    for i in range(len(source)):
        rows[row, i] = source[i]


@jit
def _log(state: State, own: Recorded, log: FloatArray, row: int) -> None:
    loop, reading = own.loop_state, own.imu_state.reading
    for k in range(IMUS):
        for axis in range(3):
            at = 3 * k + axis
            log[row, at], log[row, 6 + at] = loop.angle[k, axis], loop.rate[k, axis]
            log[row, 12 + at] = loop.acceleration[k, axis]
            log[row, 18 + at], log[row, 24 + at] = reading[k, axis], reading[k, 3 + axis]
    for axis in range(3):
        log[row, 30 + axis], log[row, 33 + axis] = loop.asked[axis], state.control.wrench[1 + axis]
    log[row, 36] = state.control.wrench[0]
    for i in range(4):
        log[row, 37 + i], log[row, 41 + i], log[row, 45 + i] = loop.pid[i], loop.desired[i], state.mocap.pose[i]
    for i in range(len(own.esc)):
        log[row, LOG + i] = own.esc[i]


@inline
def _record(state: State, own: Recorded | None, row: int, rows: Rows) -> None:
    _copy(state.control.setpoint, rows.setpoint, row)
    _copy(state.control.rate, rows.rate_setpoint, row)
    _copy(state.imu.reading, rows.imu, row)
    _copy(state.estimate, rows.attitude, row)
    _copy(state.rigid, rows.rigid, row)
    _copy(state.rotors.speed, rows.rotor_speed, row)
    _copy(state.control.duty, rows.duty, row)
    rows.thrust[row] = state.control.wrench[0]
    rows.battery_v[row] = state.battery[0]
    rows.charge_ah[row] = state.battery[1]
    rows.motors[row] = state.control.motors[0]
    if own is not None:
        _log(state, own, rows.log, row)


@inline
def _command(
    state: State, model: Model, own: Recorded | None, condition: Condition, step: int, command: FloatArray
) -> None:
    """The speeds that the duties ask for (T Eq 2.10), or at which the motors settle under the delayed duties."""
    for i in range(len(command)):
        if own is None:
            full = model.battery.speed_per_volt * state.battery[0]
            command[i] = full * state.control.duty[i] * condition.speed_gain[i]
        else:
            slots = len(own.queue)
            own.queue[step % slots, i] = state.control.duty[i]
            volts = own.queue[(step + 1) % slots, i] * state.battery[0]
            squared = own.squared_per_thrust * thrust_of(own.loop.thrust_map, volts)
            command[i] = np.sqrt(squared) * condition.speed_gain[i]


@inline
def _move(state: State, model: Model, condition: Condition, noise: Noise, row: int, scratch: _Scratch) -> None:
    advance_wind(state.wind, model.air, noise.wind, row)
    advance_noise(state.rotors, model.rotors, condition, noise.rotors, row)
    advance_rotors(state.rotors, model.rotors, condition, scratch.command, model.dt, state.wrench)
    rk4_step(state.rigid, state.wrench, model.body, model.ground, state.wind, scratch.work, model.dt)
    grip(state.rigid, model.ground)
    advance_battery(state.battery, model.battery, state.rotors.speed, model.dt)


@jit
def _steps(
    block: Block,
    model: Model,
    own: Recorded | None,
    condition: Condition,
    sensors: SensorCondition,
    state: State,
    scratch: _Scratch,
) -> None:
    first, steps, noise, commands, rows = block
    frame = 0
    for row in range(steps):
        step = first + row
        if step % model.mocap.period == 0:
            observe(state.mocap, model.mocap, state.rigid, step, noise.markers, noise.occlusion, frame)
            frame += 1
        _sense(state, model, own, sensors, noise, row, step, scratch)
        _decide(state, model, own, commands, row, step, scratch)
        _record(state, own, row, rows)
        _command(state, model, own, condition, step, scratch.command)
        _move(state, model, condition, noise, row, scratch)


Fly: TypeAlias = Callable[[Block, Model, Recorded | None, Condition, SensorCondition, State], int]


def _compiled_for(digest: int) -> Fly:

    @cached
    def fly(
        block: Block, model: Model, own: Recorded | None, condition: Condition, sensors: SensorCondition, state: State
    ) -> int:
        work, truth = np.empty((5, RIGID)), np.empty((IMUS, CHANNELS))
        scratch = _Scratch(work, truth, np.empty(REFERENCE), np.empty(len(state.rotors.speed)))
        _steps(block, model, own, condition, sensors, state, scratch)
        return digest

    return fly


fly: Fly = _compiled_for(source_digest())
"""Fly one block. `state` and `own` are updated in place; returns the digest of the sources it was compiled from."""
