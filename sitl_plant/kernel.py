"""The compiled loop: one call flies the vehicle for many steps.

Order within a step at time t_k: sensors read the state, the estimator and the controller act on it, everything is
recorded, then noise, rotors and body advance to t_(k+1) with the new command. So a row of the output belongs to one
instant.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from mavdiag.quantities import FloatArray
from sitl_plant.attitude import Estimator, advance_estimate
from sitl_plant.controller import Controller, ControlState, control
from sitl_plant.dynamics import GRAVITY, RIGID, Body, derivative, rk4_step, rotate_to_body
from sitl_plant.jit import cached, jit, source_digest
from sitl_plant.mocap import Mocap, MocapState, deliver_pose, observe
from sitl_plant.rotors import Condition, Rotors, RotorState, advance_noise, advance_rotors
from sitl_plant.sensors import CHANNELS, Imu, ImuState, SensorCondition, advance_imu, lever_arm
from sitl_plant.supply import Air, Battery, advance_battery, advance_wind
from sitl_plant.trajectory import Path, reference

__all__ = ["Model", "Noise", "Rows", "State", "fly"]


class Model(NamedTuple):
    """All constants of one flight."""

    dt: float
    body: Body
    rotors: Rotors
    battery: Battery
    air: Air
    imu: Imu
    mocap: Mocap
    estimator: Estimator
    controller: Controller
    path: Path


class State(NamedTuple):
    """All that changes; the arrays are updated in place. rigid: (13,), wrench: (3, 8), estimate: (9,), battery: (2,)."""

    rigid: FloatArray
    wrench: FloatArray
    wind: FloatArray
    battery: FloatArray
    rotors: RotorState
    imu: ImuState
    mocap: MocapState
    estimate: FloatArray
    accel_filtered: FloatArray
    control: ControlState


class Noise(NamedTuple):
    """Standard normal and uniform numbers for the steps ahead, one row a step; for the cameras, one row a frame."""

    rotors: FloatArray  # (steps, 2 n)
    imu: FloatArray  # (steps, 6)
    wind: FloatArray  # (steps, 3)
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


@jit
def _sense(state: State, model: Model, condition: SensorCondition, normals: FloatArray, dx: FloatArray) -> None:
    """Read the IMU at the present state. dx: (13,) scratch."""
    x = state.rigid
    derivative(x, state.wrench[2], model.body, state.wind, dx)
    force, truth = np.empty(3), np.empty(CHANNELS)
    force[0], force[1], force[2] = rotate_to_body(x[6:10], dx[3], dx[4], dx[5] - GRAVITY)
    truth[:3] = x[10:13]
    lever_arm(dx, x, force, model.imu.position, truth[3:])
    advance_imu(state.imu, model.imu, condition, truth, normals, model.dt)


@jit
def _decide(state: State, model: Model, t: float, path: FloatArray) -> None:
    """Estimate the attitude and pass the cascade once. path: (8,) scratch."""
    gyro, accel = state.imu.reading[:3], state.imu.reading[3:]
    advance_estimate(state.estimate, state.accel_filtered, model.estimator, gyro, accel, state.mocap.pose[3], model.dt)
    reference(model.path, t, path)
    control(state.control, model.controller, path, state.mocap.pose, state.mocap.velocity, state.estimate, model.dt)


@jit
def _record(state: State, row: int, rows: Rows) -> None:
    rows.setpoint[row] = state.control.setpoint
    rows.rate_setpoint[row] = state.control.rate
    rows.thrust[row] = state.control.wrench[0]
    rows.imu[row] = state.imu.reading
    rows.attitude[row] = state.estimate
    rows.rigid[row] = state.rigid
    rows.rotor_speed[row] = state.rotors.speed
    rows.duty[row] = state.control.duty
    rows.battery_v[row] = state.battery[0]


@jit
def _move(
    state: State, model: Model, condition: Condition, noise: Noise, row: int, command: FloatArray, work: FloatArray
) -> None:
    """Advance noise, rotors, body and battery by one step. command: (n,), work: (5, 13), scratch."""
    advance_wind(state.wind, model.air, noise.wind[row])
    advance_noise(state.rotors, model.rotors, condition, noise.rotors[row])
    for i in range(len(command)):
        full = model.battery.speed_per_volt * state.battery[0]
        command[i] = full * state.control.duty[i] * condition.speed_gain[i]
    advance_rotors(state.rotors, model.rotors, condition, command, model.dt, state.wrench)
    rk4_step(state.rigid, state.wrench, model.body, state.wind, work, model.dt)
    advance_battery(state.battery, model.battery, state.rotors.speed, model.dt)


Fly: TypeAlias = Callable[[int, int, Model, Condition, SensorCondition, State, Noise, Rows], int]


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
        rows: Rows,
    ) -> int:
        work, dx, path, command = np.empty((5, RIGID)), np.empty(RIGID), np.empty(8), np.empty(len(rows.duty[0]))
        frame = 0
        for row in range(count):
            step = first + row
            _sense(state, model, sensors, noise.imu[row], dx)
            if step % model.mocap.period == 0:
                observe(state.mocap, model.mocap, state.rigid, step, noise.markers[frame], noise.occlusion[frame])
                frame += 1
            deliver_pose(state.mocap, model.mocap, step)
            _decide(state, model, step * model.dt, path)
            _record(state, row, rows)
            _move(state, model, condition, noise, row, command, work)
        return digest

    return fly


fly: Fly = _compiled_for(source_digest())
"""fly(first, count, model, condition, sensors, state, noise, rows): steps first .. first + count - 1; step 0 is at t = 0.

`state` is updated in place and `rows` filled from row 0. Returns the digest of the sources it was compiled from.
"""
