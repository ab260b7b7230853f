"""The compiled loop: one call flies the vehicle for many steps.

Order within a step at time t_k: sensors read the state, the estimator and the cascade act on it (or the given motor
commands take the cascade's place), everything is recorded, then noise, rotors and body advance to t_(k+1) with the new
command. So a row of the output belongs to one instant.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.attitude import Estimator, advance_estimate
from sitl_plant.physics.controller import Controller, ControlState, control
from sitl_plant.physics.dynamics import RIGID, STAGES, Body, Ground, derivative, grip, rk4_step, support
from sitl_plant.physics.jit import cached, inline, jit, source_digest
from sitl_plant.physics.mocap import Mocap, MocapState, deliver_pose, hold_if_lost, observe
from sitl_plant.physics.mount import Mount, advance_mount
from sitl_plant.physics.rotors import Condition, Rotors, RotorState, advance_noise, advance_rotors
from sitl_plant.physics.sensors import CHANNELS, Imu, ImuState, SensorCondition, advance_imu, feel
from sitl_plant.physics.supply import Air, Battery, advance_battery, advance_wind
from sitl_plant.physics.trajectory import DISARMED, FLYING, REFERENCE, Path, reference

__all__ = ["Fly", "Model", "Noise", "Rows", "Scratch", "State", "fly", "move", "obey", "record"]


class Model(NamedTuple):
    """All constants of one flight."""

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
    """All that changes, updated in place.

    rigid: (13,), wrench: (3, 8), wind: (3,), battery: (2,), mount: (6, 2), estimate: (9,).
    """

    rigid: FloatArray
    wrench: FloatArray
    wind: FloatArray
    battery: FloatArray
    rotors: RotorState
    imu: ImuState
    mount: FloatArray
    mocap: MocapState
    estimate: FloatArray
    accel_filtered: FloatArray
    control: ControlState


class Noise(NamedTuple):
    """Standard normal and uniform numbers for the steps ahead, one row a step; for the cameras, one row a frame."""

    rotors: FloatArray  # (steps, 2 n)
    imu: FloatArray  # (steps, 6)
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


class Scratch(NamedTuple):
    """Arrays that one step needs and the next forgets. work: (5, 13), truth: (6,), path: (9,), command: (n,)."""

    work: FloatArray
    truth: FloatArray
    path: FloatArray
    command: FloatArray


@inline
def _sense(
    state: State, model: Model, condition: SensorCondition, noise: Noise, row: int, step: int, scratch: Scratch
) -> None:
    """Read the IMU, and receive what the cameras saw."""
    derivative(state.rigid, state.wrench, STAGES - 1, model.body, state.wind, scratch.work, 0)
    support(state.rigid, model.body, model.ground, scratch.work, 0)
    feel(state.rigid, scratch.work, model.imu.position, scratch.truth)
    advance_mount(state.mount, model.mount, scratch.truth)
    advance_imu(state.imu, model.imu, condition, scratch.truth, noise.imu, row, model.dt)
    deliver_pose(state.mocap, model.mocap, step)


@inline
def _decide(state: State, model: Model, commands: FloatArray, row: int, step: int, scratch: Scratch) -> None:
    """Estimate the attitude; then take the given motor commands, or pass the cascade once if there are none."""
    advance_estimate(
        state.estimate, state.accel_filtered, model.estimator, state.imu.reading, state.mocap.pose[3], model.dt
    )
    if len(commands) > 0:
        obey(state.control, commands, row)
        return
    reference(model.path, step * model.dt, scratch.path)
    hold_if_lost(state.mocap, model.mocap, step, scratch.path)
    control(
        state.control, model.controller, scratch.path, state.mocap.pose, state.mocap.velocity, state.estimate, model.dt
    )


@jit
def obey(state: ControlState, commands: FloatArray, row: int) -> None:
    """Take the duties of one row of commands. Nobody commands an attitude."""
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


@inline
def record(state: State, row: int, rows: Rows) -> None:
    """Write what is known at this instant into one row."""
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


@inline
def _command(state: State, model: Model, condition: Condition, scratch: Scratch) -> None:
    """The speeds that the duties ask for (T Eq 2.10)."""
    for i in range(len(scratch.command)):
        full = model.battery.speed_per_volt * state.battery[0]
        scratch.command[i] = full * state.control.duty[i] * condition.speed_gain[i]


@inline
def move(state: State, model: Model, condition: Condition, noise: Noise, row: int, scratch: Scratch) -> None:
    """Advance wind, noise, rotors, body and battery by one step under the speeds in scratch.command."""
    advance_wind(state.wind, model.air, noise.wind, row)
    advance_noise(state.rotors, model.rotors, condition, noise.rotors, row)
    advance_rotors(state.rotors, model.rotors, condition, scratch.command, model.dt, state.wrench)
    rk4_step(state.rigid, state.wrench, model.body, model.ground, state.wind, scratch.work, model.dt)
    grip(state.rigid, model.ground)
    advance_battery(state.battery, model.battery, state.rotors.speed, model.dt)


@jit
def _steps(
    first: int,
    count: int,
    model: Model,
    condition: Condition,
    sensors: SensorCondition,
    state: State,
    noise: Noise,
    commands: FloatArray,
    rows: Rows,
    scratch: Scratch,
) -> None:
    frame = 0
    for row in range(count):
        step = first + row
        if step % model.mocap.period == 0:
            observe(state.mocap, model.mocap, state.rigid, step, noise.markers, noise.occlusion, frame)
            frame += 1
        _sense(state, model, sensors, noise, row, step, scratch)
        _decide(state, model, commands, row, step, scratch)
        record(state, row, rows)
        _command(state, model, condition, scratch)
        move(state, model, condition, noise, row, scratch)


Fly: TypeAlias = Callable[[int, int, Model, Condition, SensorCondition, State, Noise, FloatArray, Rows], int]


def _compiled_for(digest: int) -> Fly:
    """The loop for these sources: numba's cache key holds the digest, because the loop closes over it."""

    @cached
    def fly(
        first: int,
        count: int,
        model: Model,
        condition: Condition,
        sensors: SensorCondition,
        state: State,
        noise: Noise,
        commands: FloatArray,
        rows: Rows,
    ) -> int:
        scratch = Scratch(
            np.empty((5, RIGID)), np.empty(CHANNELS), np.empty(REFERENCE), np.empty(len(state.rotors.speed))
        )
        _steps(first, count, model, condition, sensors, state, noise, commands, rows, scratch)
        return digest

    return fly


fly: Fly = _compiled_for(source_digest())
"""fly(first, count, model, condition, sensors, state, noise, commands, rows): `count` steps from `first`; 0 is t = 0.

commands: (count, n) duties, or (0, n) to let the cascade fly.
`state` is updated in place and `rows` filled from row 0. Returns the digest of the sources it was compiled from.
"""
