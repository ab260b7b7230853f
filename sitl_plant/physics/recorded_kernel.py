"""The compiled loop of a vehicle as it was recorded: the same body, rotors, cameras and air as `kernel`, other sensors,
controller and motors.

Motors turn at the speed at which the rotor lifts what the manufacturer's map says of its voltage, times what it really
lifts; the voltage follows the duty after a delay. The order within a step is that of `kernel`.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.dynamics import RIGID, STAGES, derivative, support
from sitl_plant.physics.jit import cached, inline, jit, source_digest
from sitl_plant.physics.kernel import Model, Noise, Rows, Scratch, State, move, obey, record
from sitl_plant.physics.mocap import deliver_pose, observe
from sitl_plant.physics.recorded_control import Feedback, Loop, LoopState, decide, estimate_attitude, thrust_of
from sitl_plant.physics.recorded_log import FIXED_COLUMNS
from sitl_plant.physics.recorded_sensors import IMUS, TwinImu, TwinImuState, advance_imus
from sitl_plant.physics.rotors import Condition
from sitl_plant.physics.sensors import CHANNELS, SensorCondition, feel
from sitl_plant.physics.trajectory import REFERENCE, reference

__all__ = ["OwnModel", "OwnState", "fly_recorded"]


class OwnModel(NamedTuple):
    """What the recorded set has beside `Model`.

    squared_per_thrust: speed^2 of a rotor over its thrust by the map, battery gain included [rad^2/s^2/N].
    delay: of the voltage, in steps.
    esc_period: steps from one motor's telemetry to the next one's. esc_first: step of the first.
    over_read: reported over true speed.
    """

    imus: TwinImu
    feedback: Feedback
    loop: Loop
    squared_per_thrust: float
    delay: int
    esc_period: int
    esc_first: int
    over_read: float


class OwnState(NamedTuple):
    """What it remembers beside `State`.

    queue: (delay + 1, n) duties under way. esc: (n,) reported speeds [rad/s], NaN before the first frame.
    """

    imus: TwinImuState
    loop: LoopState
    queue: FloatArray
    esc: FloatArray


@inline
def _sense(
    state: State,
    own: OwnState,
    model: Model,
    set_: OwnModel,
    condition: SensorCondition,
    normals: FloatArray,
    row: int,
    step: int,
    scratch: Scratch,
    truth: FloatArray,
) -> None:
    """Read both IMUs and the motors' telemetry, and receive what the cameras saw."""
    derivative(state.rigid, state.wrench, STAGES - 1, model.body, state.wind, scratch.work, 0)
    support(state.rigid, model.body, model.ground, scratch.work, 0)
    for k in range(IMUS):
        feel(state.rigid, scratch.work, set_.imus.position[k], truth[k])
    advance_imus(own.imus, set_.imus, condition, truth, state.rotors, normals, row, step, model.dt)
    for i in range(CHANNELS):
        state.imu.reading[i] = own.imus.reading[0, i]
    if step >= set_.esc_first and step % set_.esc_period == 0:
        n = len(own.esc)
        motor = n - 1 - (step // set_.esc_period) % n  # the manufacturer asks the last motor first
        own.esc[motor] = set_.over_read * state.rotors.speed[motor]
    deliver_pose(state.mocap, model.mocap, step)


@inline
def _steer(
    state: State,
    own: OwnState,
    model: Model,
    set_: OwnModel,
    commands: FloatArray,
    row: int,
    t: float,
    scratch: Scratch,
) -> None:
    """Estimate the attitude; then take the given motor commands, or pass the controller once if there are none."""
    estimate_attitude(own.loop, set_.feedback, own.imus.reading, state.estimate, model.dt)
    if len(commands) > 0:
        obey(state.control, commands, row)
        return
    reference(model.path, t, scratch.path)
    volts = state.battery[0]
    decide(
        state.control,
        own.loop,
        set_.loop,
        set_.feedback,
        scratch.path,
        state.mocap.pose,
        state.estimate,
        volts,
        model.dt,
    )


@jit
def _turn(state: State, own: OwnState, set_: OwnModel, condition: Condition, step: int, scratch: Scratch) -> None:
    """The speeds at which the motors settle under the delayed duties, into scratch.command."""
    slots = len(own.queue)
    for i in range(len(state.control.duty)):
        own.queue[step % slots, i] = state.control.duty[i]
        volts = own.queue[(step + 1) % slots, i] * state.battery[0]
        squared = set_.squared_per_thrust * thrust_of(set_.loop.thrust_map, volts)
        scratch.command[i] = np.sqrt(squared) * condition.speed_gain[i]


@jit
def _log_imus(own: OwnState, log: FloatArray, row: int) -> None:
    """Estimates and readings of both IMUs, 30 columns."""
    for k in range(IMUS):
        for axis in range(3):
            at = 3 * k + axis
            log[row, at] = own.loop.angle[k, axis]
            log[row, 6 + at] = own.loop.rate[k, axis]
            log[row, 12 + at] = own.loop.acceleration[k, axis]
            log[row, 18 + at] = own.imus.reading[k, axis]
            log[row, 24 + at] = own.imus.reading[k, 3 + axis]


@jit
def _log(state: State, own: OwnState, log: FloatArray, row: int) -> None:
    """One row of the columns in `recorded_log`."""
    _log_imus(own, log, row)
    for axis in range(3):
        log[row, 30 + axis] = own.loop.asked[axis]
        log[row, 33 + axis] = state.control.wrench[1 + axis]
    log[row, 36] = state.control.wrench[0]
    for i in range(4):
        log[row, 37 + i] = own.loop.pid[i]
        log[row, 41 + i] = own.loop.desired[i]
        log[row, 45 + i] = state.mocap.pose[i]
    for i in range(len(own.esc)):
        log[row, FIXED_COLUMNS + i] = own.esc[i]


FlyRecorded: TypeAlias = Callable[
    [
        int,
        int,
        Model,
        OwnModel,
        Condition,
        SensorCondition,
        State,
        OwnState,
        Noise,
        FloatArray,
        FloatArray,
        Rows,
        FloatArray,
    ],
    int,
]


Chunk: TypeAlias = tuple[int, int, Noise, FloatArray, FloatArray, Rows, FloatArray]


@jit
def _steps(
    chunk: Chunk,
    model: Model,
    set_: OwnModel,
    condition: Condition,
    sensors: SensorCondition,
    state: State,
    own: OwnState,
    scratch: Scratch,
    truth: FloatArray,
) -> None:
    first, count, noise, normals, commands, rows, log = chunk
    frame = 0
    for row in range(count):
        step = first + row
        if step % model.mocap.period == 0:
            observe(state.mocap, model.mocap, state.rigid, step, noise.markers, noise.occlusion, frame)
            frame += 1
        _sense(state, own, model, set_, sensors, normals, row, step, scratch, truth)
        _steer(state, own, model, set_, commands, row, step * model.dt, scratch)
        record(state, row, rows)
        _log(state, own, log, row)
        _turn(state, own, set_, condition, step, scratch)
        move(state, model, condition, noise, row, scratch)


def _compiled_for(digest: int) -> FlyRecorded:
    """The loop for these sources, as in `kernel`."""

    @cached
    def fly_recorded(
        first: int,
        count: int,
        model: Model,
        set_: OwnModel,
        condition: Condition,
        sensors: SensorCondition,
        state: State,
        own: OwnState,
        noise: Noise,
        normals: FloatArray,
        commands: FloatArray,
        rows: Rows,
        log: FloatArray,
    ) -> int:
        scratch = Scratch(
            np.empty((5, RIGID)), np.empty(CHANNELS), np.empty(REFERENCE), np.empty(len(state.rotors.speed))
        )
        truth = np.empty((IMUS, CHANNELS))
        chunk = (first, count, noise, normals, commands, rows, log)
        _steps(chunk, model, set_, condition, sensors, state, own, scratch, truth)
        return digest

    return fly_recorded


fly_recorded: FlyRecorded = _compiled_for(source_digest())
"""As `kernel.fly`, with the recorded set; normals: (count, 24) for the IMUs, log: (count, columns) is filled."""
