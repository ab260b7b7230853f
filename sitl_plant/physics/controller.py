"""The cascaded PIV controller of T 2.3, from pose error to the duty cycle of each motor (Eq 2.22-2.44).

T writes it in a frame with y to the left and z up; here it is in FRD and NED, so pitch, yaw and height change sign:

    theta_ref = -(P e_x + V e_vx + I ∫e_x)      nose up is positive, so ahead is negative          T Eq 2.27
    phi_ref   = +(P e_y + V e_vy + I ∫e_y)      right side down is positive, so right is positive  T Eq 2.26
    T_ref     = -(P e_z + V e_vz + I ∫e_z)      z is down                                          T Eq 2.25
    r_ref     = P e_psi + V (r_path - r) + I ∫e_psi                                                T Eq 2.28
    omega_ref = P (eta_ref - eta) + D eta_rate,   D < 0                                            T Eq 2.36
    tau       = I (P (omega_ref - omega) + D omega_rate),   D < 0                                  T Eq 2.40
    F_i       = mixer @ [T_ref, tau]                                                               T Eq 2.43
    duty_i    = sqrt(F_i / K_F) / K_omega                                                          T Eq 2.44, 2.12

Horizontal errors are turned by the yaw. Integrals are clamped (anti-windup); every command has a limit.
"""

from typing import NamedTuple

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.attitude import wrapped
from sitl_plant.physics.jit import jit
from sitl_plant.physics.trajectory import DISARMED, FLYING, IDLE, LANDING, SHUTDOWN

__all__ = ["ControlState", "Controller", "control"]

LANDED_M = 0.03  # a vehicle below this height stands on the ground when it is led to land (our choice)


class Controller(NamedTuple):
    """Gains and limits.

    pose: (4, 3) rows x, y, z, yaw, columns P, V, I.
    rate_gain: (3, 2) P and D, times inertia.
    mixer: (n, 4) pseudo-inverse of the motor mapping matrix; with four rotors its inverse, T Eq 2.43.
    full_thrust: K_F K_omega^2 [N] of one motor at full duty.
    integral_limit: (4,) in units of the command.
    """

    pose: FloatArray
    attitude_p: float
    attitude_d: float
    rate_gain: FloatArray
    mixer: FloatArray
    full_thrust: float
    minimum_duty: float
    tilt_limit: float
    rate_limit: float
    yaw_rate_limit: float
    integral_limit: FloatArray
    torque_limit: FloatArray  # (3,)
    thrust_limit: FloatArray  # (2,)


class ControlState(NamedTuple):
    """What the cascade remembers and commands.

    integral: (4,) integrals of the pose error times I, in units of the command.
    setpoint: (3,) commanded roll, pitch, yaw [rad].
    rate: (3,) commanded body rates [rad/s].
    wrench: (4,) commanded thrust [N] and torques [N m].
    duty: (n,) commanded duty, 0..1.
    motors: (1,) 0 disarmed, 1 armed and idle, 2 flying.
    """

    integral: FloatArray
    setpoint: FloatArray
    rate: FloatArray
    wrench: FloatArray
    duty: FloatArray
    motors: FloatArray


@jit
def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@jit
def _piv(state: ControlState, gains: Controller, axis: int, error: float, rate_error: float, dt: float) -> float:
    """P error + V rate error + I integral, the last clamped (T Eq 2.25-2.28)."""
    p, v, i = gains.pose[axis]
    limit = gains.integral_limit[axis]
    state.integral[axis] = _clip(state.integral[axis] + i * error * dt, -limit, limit)
    return float(p * error + v * rate_error + state.integral[axis])


@jit
def _outer_loop(
    state: ControlState,
    gains: Controller,
    reference: FloatArray,
    pose: FloatArray,
    velocity: FloatArray,
    yaw_rate: float,
    dt: float,
) -> None:
    """Pose error to attitude, thrust and yaw rate (T Eq 2.22-2.29)."""
    c, s = np.cos(pose[3]), np.sin(pose[3])
    e_n, e_e = reference[0] - pose[0], reference[1] - pose[1]
    v_n, v_e = reference[3] - velocity[0], reference[4] - velocity[1]
    ahead = _piv(state, gains, 0, c * e_n + s * e_e, c * v_n + s * v_e, dt)
    right = _piv(state, gains, 1, c * e_e - s * e_n, c * v_e - s * v_n, dt)
    down = _piv(state, gains, 2, reference[2] - pose[2], reference[5] - velocity[2], dt)
    turn = _piv(state, gains, 3, wrapped(reference[6] - pose[3]), reference[7] - yaw_rate, dt)
    state.setpoint[0] = _clip(right, -gains.tilt_limit, gains.tilt_limit)
    state.setpoint[1] = _clip(-ahead, -gains.tilt_limit, gains.tilt_limit)
    state.setpoint[2] = reference[6]
    state.wrench[0] = _clip(-down, gains.thrust_limit[0], gains.thrust_limit[1])
    state.rate[2] = _clip(turn, -gains.yaw_rate_limit, gains.yaw_rate_limit)


@jit
def _stand(state: ControlState, gains: Controller, yaw: float) -> None:
    """On the ground: all motors idle, or off. The integrals wait."""
    duty = gains.minimum_duty if state.motors[0] == IDLE else 0.0
    for axis in range(3):
        state.setpoint[axis] = state.rate[axis] = state.wrench[1 + axis] = 0.0
    state.setpoint[2] = yaw
    state.wrench[0] = len(state.duty) * gains.full_thrust * duty * duty
    for i in range(len(state.duty)):
        state.duty[i] = duty


@jit
def control(
    state: ControlState,
    gains: Controller,
    reference: FloatArray,
    pose: FloatArray,
    velocity: FloatArray,
    estimate: FloatArray,
    dt: float,
) -> None:
    """One pass of the cascade; the commands are left in `state`.

    reference: (9,) from `trajectory`.
    pose: (4,) from motion capture.
    velocity: (3,) from motion capture.
    estimate: (9,) from `attitude`.
    """
    state.motors[0] = min(reference[8], FLYING)
    if reference[8] >= LANDING and pose[2] > -LANDED_M:
        state.motors[0] = DISARMED if reference[8] == SHUTDOWN else IDLE
    if state.motors[0] != FLYING:
        _stand(state, gains, reference[6])
        return
    _outer_loop(state, gains, reference, pose, velocity, estimate[5], dt)
    for axis in range(2):
        rate = gains.attitude_p * (state.setpoint[axis] - estimate[axis]) + gains.attitude_d * estimate[3 + axis]
        state.rate[axis] = _clip(rate, -gains.rate_limit, gains.rate_limit)
    for axis in range(3):
        torque = gains.rate_gain[axis, 0] * (state.rate[axis] - estimate[3 + axis])
        torque += gains.rate_gain[axis, 1] * estimate[6 + axis]
        state.wrench[1 + axis] = _clip(torque, -gains.torque_limit[axis], gains.torque_limit[axis])
    for i in range(len(state.duty)):
        force = 0.0
        for k in range(4):
            force += gains.mixer[i, k] * state.wrench[k]
        state.duty[i] = _clip(np.sqrt(max(force, 0.0) / gains.full_thrust), gains.minimum_duty, 1.0)
