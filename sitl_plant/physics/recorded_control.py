"""The controller that flew the recordings: the manufacturer's attitude loop, mixer and position PID, at 1 kHz.

The manufacturer writes it in FLU; here it is in FRD and NED, where pitch, yaw and height change sign.

    rate, acceleration = second-order low-pass of each gyro and its slope, wn 120 rad/s, zeta 1
    angle   = complementary filter of each IMU: ∫ gyro + kp (seen - angle) + ki ∫(seen - angle); yaw: ∫ gyro, it drifts
    feedback: mean of both IMUs

    v         = slope of a second-order low-pass of the cameras' pose, wn 50 rad/s
    phi_ref   = +(P e_right - D v_right + I ∫e_right)     within +-pi/4
    theta_ref = -(P e_ahead - D v_ahead + I ∫e_ahead)     within +-pi/4
    T         = trim - (P e_z - D v_z + I ∫e_z)           z is down
    r_ref     = P e_psi

    rate_cmd = 12 (ref - angle) - 0.1 rate,  yaw: 2 r_ref,           within +-10 pi/3
    tau      = g (rate_cmd - rate) - h acceleration,                  within +-[1.0915 0.8984 0.0984] N m
    F_i      = mixer @ [T, tau]
    duty_i   = V(F_i) / V_bat,  F = a V^2 + b V + c                   battery compensated

That D acts on the measured speed and that the gyro enters the complementary filter unfiltered is inferred; the yaw gain
is an estimate. While the motors spin on the ground the attitude loop runs on a small thrust and its integrals wait.
"""

import math
from typing import NamedTuple

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.attitude import tilt_from_accel, wrapped
from sitl_plant.physics.controller import LANDED_M, ControlState
from sitl_plant.physics.jit import jit
from sitl_plant.physics.recorded_sensors import IMUS
from sitl_plant.physics.trajectory import DISARMED, FLYING, IDLE, LANDING

__all__ = ["Feedback", "Loop", "LoopState", "decide", "estimate_attitude", "second_order", "thrust_of", "voltage_of"]

Transition = tuple[float, float, float, float]


class Feedback(NamedTuple):
    """Filters by `second_order`, and the complementary filter's gains."""

    rate: Transition
    accel: Transition
    velocity: Transition
    correction_p: float
    correction_i: float


class Loop(NamedTuple):
    """Gains and limits; pid: (3, 3) rows horizontal, height, yaw, columns P, D, I. mixer: (n, 4). Others (3,)."""

    angle: float
    rate_damping: float
    yaw_rate: float
    rate_limit: float
    torque_per_rate: FloatArray
    torque_per_acceleration: FloatArray
    torque_limit: FloatArray
    pid: FloatArray
    integral_limit: FloatArray
    trim: float
    tilt_limit: float
    thrust_limit: FloatArray
    mixer: FloatArray
    thrust_map: tuple[float, float, float]
    minimum_duty: float
    ground_thrust: float


class LoopState(NamedTuple):
    """What the estimators and the loops remember beside `ControlState`.

    angle, rate, acceleration: (2, 3) of each IMU.
    accel, accel_slope: (2, 3) filtered accelerometers and their slope.
    correction: (2, 2) integral of the complementary filter, roll and pitch.
    seen, velocity: (4,) filtered pose and its slope; x, y, z, yaw.
    asked: (3,) torques before their limit.
    pid: (4,) outputs: roll and pitch [rad], thrust deviation [N], yaw rate [rad/s].
    desired: (4,) set-point: x, y, z, yaw.
    """

    angle: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    accel: FloatArray
    accel_slope: FloatArray
    correction: FloatArray
    seen: FloatArray
    velocity: FloatArray
    asked: FloatArray
    pid: FloatArray
    desired: FloatArray


def second_order(wn_rad_s: float, zeta: float, dt_s: float) -> Transition:
    """Exact step of wn^2 / (s^2 + 2 zeta wn s + wn^2) with its input held, by rows: [y - u, dy/dt] to the next sample.

    exp(A dt) by its series, in the scaled state [y, dy/dt / wn], where ||A dt|| is about wn dt.
    """
    A = wn_rad_s * dt_s * np.array([[0.0, 1.0], [-1.0, -2.0 * zeta]])
    term = total = np.eye(2)
    for n in range(1, 30):
        term = term @ A / n
        total = total + term
    return float(total[0, 0]), float(total[0, 1] / wn_rad_s), float(total[1, 0] * wn_rad_s), float(total[1, 1])


@jit
def thrust_of(thrust_map: tuple[float, float, float], volts: float) -> float:
    """Thrust of a rotor at a motor voltage [N], by the manufacturer's map; never negative."""
    a, b, c = thrust_map
    return max(a * volts * volts + b * volts + c, 0.0)


@jit
def voltage_of(thrust_map: tuple[float, float, float], force: float) -> float:
    """Motor voltage for a thrust [V]: the inverse of the map; 0 for no thrust."""
    a, b, c = thrust_map
    if force <= 0.0:
        return 0.0
    return (-b + math.sqrt(b * b + 4.0 * a * (force - c))) / (2.0 * a)


@jit
def estimate_attitude(
    state: LoopState, feedback: Feedback, reading: FloatArray, estimate: FloatArray, dt: float
) -> None:
    """Advance both IMUs' estimates by one sample, and leave their mean in estimate (9,). reading: (2, 6), FRD."""
    for k in range(IMUS):
        _low_pass3(state.rate[k], state.acceleration[k], feedback.rate, reading[k, :3])
        _low_pass3(state.accel[k], state.accel_slope[k], feedback.accel, reading[k, 3:])
        phi_seen, theta_seen = tilt_from_accel(state.accel[k, 0], state.accel[k, 1], state.accel[k, 2])
        phi, theta = state.angle[k, 0], state.angle[k, 1]
        p, q, r = reading[k, 0], reading[k, 1], reading[k, 2]
        turn = q * math.sin(phi) + r * math.cos(phi)
        error_phi, error_theta = wrapped(phi_seen - phi), theta_seen - theta
        state.correction[k, 0] += dt * feedback.correction_i * error_phi
        state.correction[k, 1] += dt * feedback.correction_i * error_theta
        dphi = p + math.tan(theta) * turn + feedback.correction_p * error_phi + state.correction[k, 0]
        dtheta = q * math.cos(phi) - r * math.sin(phi) + feedback.correction_p * error_theta + state.correction[k, 1]
        state.angle[k, 0] = wrapped(phi + dt * dphi)
        state.angle[k, 1] = wrapped(theta + dt * dtheta)
        state.angle[k, 2] += dt * turn / math.cos(theta)
    for axis in range(3):
        estimate[axis] = 0.5 * (state.angle[0, axis] + state.angle[1, axis])
        estimate[3 + axis] = 0.5 * (state.rate[0, axis] + state.rate[1, axis])
        estimate[6 + axis] = 0.5 * (state.acceleration[0, axis] + state.acceleration[1, axis])


@jit
def _low_pass3(value: FloatArray, slope: FloatArray, transition: Transition, target: FloatArray) -> None:
    """One exact step of three second-order filters."""
    f11, f12, f21, f22 = transition
    for i in range(3):
        behind, rate = value[i] - target[i], slope[i]
        value[i] = target[i] + f11 * behind + f12 * rate
        slope[i] = f21 * behind + f22 * rate


@jit
def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


@jit
def _see(state: LoopState, feedback: Feedback, pose: FloatArray) -> None:
    """Filter the cameras' pose (4,); yaw is unwrapped first."""
    f11, f12, f21, f22 = feedback.velocity
    for i in range(4):
        behind, rate = state.seen[i] - pose[i], state.velocity[i]
        if i == 3:
            behind = wrapped(behind)
        state.seen[i] = pose[i] + f11 * behind + f12 * rate
        state.velocity[i] = f21 * behind + f22 * rate


@jit
def _pid(integral: FloatArray, loop: Loop, row: int, axis: int, error: float, speed: float, dt: float) -> float:
    """P error - D speed + I integral, the last clamped; integral: (4,) in units of the output."""
    p, d, i = loop.pid[row]
    integral[axis] = _clip(integral[axis] + i * error * dt, loop.integral_limit[row])
    return float(p * error - d * speed + integral[axis])


@jit
def _position(control: ControlState, state: LoopState, loop: Loop, pose: FloatArray, dt: float) -> None:
    """Pose error to roll and pitch reference, thrust and yaw-rate reference."""
    c, s = math.cos(pose[3]), math.sin(pose[3])
    e_n, e_e, v_n, v_e = state.desired[0] - pose[0], state.desired[1] - pose[1], state.velocity[0], state.velocity[1]
    ahead = _pid(control.integral, loop, 0, 0, c * e_n + s * e_e, c * v_n + s * v_e, dt)
    right = _pid(control.integral, loop, 0, 1, c * e_e - s * e_n, c * v_e - s * v_n, dt)
    down = _pid(control.integral, loop, 1, 2, state.desired[2] - pose[2], state.velocity[2], dt)
    turn = _pid(control.integral, loop, 2, 3, wrapped(state.desired[3] - pose[3]), state.velocity[3], dt)
    state.pid[0], state.pid[1], state.pid[2], state.pid[3] = right, -ahead, -down, turn
    control.setpoint[0], control.setpoint[1] = _clip(right, loop.tilt_limit), _clip(-ahead, loop.tilt_limit)
    control.wrench[0] = min(max(loop.trim - down, loop.thrust_limit[0]), loop.thrust_limit[1])


@jit
def _attitude(control: ControlState, state: LoopState, loop: Loop, estimate: FloatArray) -> None:
    """References to rate commands, torques and their limits."""
    for axis in range(3):
        rate = loop.yaw_rate * state.pid[3]
        if axis < 2:
            rate = loop.angle * (control.setpoint[axis] - estimate[axis]) - loop.rate_damping * estimate[3 + axis]
        control.rate[axis] = _clip(rate, loop.rate_limit)
        torque = loop.torque_per_rate[axis] * (control.rate[axis] - estimate[3 + axis])
        state.asked[axis] = torque - loop.torque_per_acceleration[axis] * estimate[6 + axis]
        control.wrench[1 + axis] = _clip(state.asked[axis], loop.torque_limit[axis])


@jit
def _rest(control: ControlState, state: LoopState) -> None:
    """Disarmed: nothing is commanded."""
    for axis in range(3):
        control.rate[axis] = control.wrench[1 + axis] = state.asked[axis] = 0.0
    control.wrench[0] = 0.0
    for i in range(len(control.duty)):
        control.duty[i] = 0.0


@jit
def decide(
    control: ControlState,
    state: LoopState,
    loop: Loop,
    feedback: Feedback,
    reference: FloatArray,
    pose: FloatArray,
    estimate: FloatArray,
    volts: float,
    dt: float,
) -> None:
    """One pass of the controller; the commands are left in `control`.

    reference: (9,) from `trajectory`. pose: (4,) from motion capture. estimate: (9,) mean of both IMUs. volts: battery.
    """
    control.motors[0] = min(reference[8], FLYING)
    if reference[8] >= LANDING and pose[2] > -LANDED_M:
        control.motors[0] = DISARMED
    _see(state, feedback, pose)
    state.desired[0], state.desired[1], state.desired[2] = reference[0], reference[1], reference[2]
    state.desired[3] = control.setpoint[2] = reference[6]
    for i in range(4):
        state.pid[i] = 0.0
    control.setpoint[0] = control.setpoint[1] = 0.0
    if control.motors[0] == DISARMED:
        _rest(control, state)
        return
    control.wrench[0] = loop.ground_thrust
    if control.motors[0] != IDLE:
        _position(control, state, loop, pose, dt)
    _attitude(control, state, loop, estimate)
    for i in range(len(control.duty)):
        force = 0.0
        for k in range(4):
            force += loop.mixer[i, k] * control.wrench[k]
        duty = voltage_of(loop.thrust_map, force) / volts
        control.duty[i] = min(max(duty, loop.minimum_duty), 1.0)
