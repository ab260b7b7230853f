"""From pose error to duty: the thesis's attitude estimate and cascade, and the manufacturer's as another parameter set.

**The thesis's** (T 2.3, Eq 2.22-2.44). T writes it in a frame with y to the left and z up; here it is in FRD and NED,
so pitch, yaw and height change sign. At rest the accelerometer reads (0, 0, -g); a = -specific force points down.

    phi_acc   = atan2(a_y, a_z)                                                                    T Eq 2.31
    theta_acc = atan2(-a_x, sqrt(a_y^2 + a_z^2)),   the root is a_y sin phi_acc + a_z cos phi_acc  T Eq 2.32
    rate, acceleration = low-pass(gyro) and its slope, two states of one filter
    eta'      = W(eta) rate + (eta_seen - eta) / tau      gyro for the short term, the others for the long one
    theta_ref = -(P e_x + V e_vx + I ∫e_x)      nose up is positive, so ahead is negative          T Eq 2.27
    phi_ref   = +(P e_y + V e_vy + I ∫e_y)      right side down is positive, so right is positive  T Eq 2.26
    T_ref     = trim - (P e_z + V e_vz + I ∫e_z)            z is down, trim 0                      T Eq 2.25
    r_ref     = P e_psi + V (r_path - r) + I ∫e_psi                                                T Eq 2.28
    omega_ref = P (eta_ref - eta) + D eta_rate,   D < 0                                            T Eq 2.36
    tau       = I (P (omega_ref - omega) + D omega_rate),   D < 0                                  T Eq 2.40
    F_i       = mixer @ [T_ref, tau]                                                               T Eq 2.43
    duty_i    = sqrt(F_i / K_F) / K_omega                                                          T Eq 2.44, 2.12

Horizontal errors are turned by the yaw; integrals are clamped (anti-windup); every command has a limit. The estimate is
the nine-vector of T Eq 2.33: roll, pitch, yaw [rad], then rates and accelerations about the body axes.

**The manufacturer's** flew the recordings. Its V acts on the measured speed alone (e_v = -v; inferred), it has a trim,
its attitude loop runs on a small thrust while the motors spin on the ground, and

    rate, acceleration = second-order low-pass of each gyro and its slope, wn 120 rad/s, zeta 1
    angle     = complementary filter of each IMU: ∫ gyro (unfiltered: inferred) + kp (seen - angle) + ki ∫(seen - angle)
    feedback: mean of both IMUs;  v = slope of a second-order low-pass of the cameras' pose, wn 50 rad/s
    duty_i    = V(F_i) / V_bat,  F = a V^2 + b V + c                  battery compensated
"""

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from mavdiag.jit import inline, jit
from mavdiag.telemetry import FloatArray
from sitl_plant.physics.dynamics import wrapped
from sitl_plant.physics.sensors import IMUS
from sitl_plant.physics.trajectory import DISARMED, FLYING, IDLE, LANDING, SHUTDOWN

ESTIMATE = 9  # length of T's attitude state
EPSILON = 1e-3  # m/s^2: below this the accelerometer has no direction (T Eq 2.30)
LANDED_M = 0.03  # a vehicle below this height stands on the ground when it is led to land (our choice)

ThrustMap: TypeAlias = tuple[float, float, float]
"""The manufacturer's: a, b, c of F = a V^2 + b V + c, thrust of a rotor by motor voltage."""

Transition: TypeAlias = tuple[float, float, float, float]
"""By rows, how [y - u, dy/dt] goes on over one step of a filter whose input u is held."""


class Estimator(NamedTuple):
    """The thesis's. accel_gain: 1 - exp(-2 pi f dt). correction: dt over tau."""

    gyro_filter: Transition
    accel_gain: float
    correction: float


class TwinEstimator(NamedTuple):
    """The manufacturer's filters, its complementary filter's gains, and what they remember.

    From `angle` on: of each IMU (2, 3), but for the last three.
    """

    rate_filter: Transition
    accel_filter: Transition
    pose_filter: Transition
    correction_p: float
    correction_i: float
    angle: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    accel: FloatArray  # filtered accelerometers, then their slope
    accel_slope: FloatArray
    correction: FloatArray  # (2, 2) integral of the complementary filter, roll and pitch
    seen: FloatArray  # (4,) filtered pose x, y, z, yaw, then its slope
    velocity: FloatArray


class Controller(NamedTuple):
    """Gains and limits of a cascade."""

    pose: FloatArray  # (4, 3) rows x, y, z, yaw, columns P, V, I
    trim: float  # thrust without any error [N]
    yaw_rate: float  # yaw rate commanded over the output of the yaw loop
    attitude_p: float
    attitude_d: float
    rate_gain: FloatArray  # (3, 2) P and D, inertia included
    mixer: FloatArray  # (n, 4) pseudo-inverse of the motor mapping matrix; with four rotors its inverse, T Eq 2.43
    full_thrust: float  # of one motor at full duty, K_F K_omega^2 [N]
    ground_thrust: float  # on which the loops run while the motors idle [N]; 0 for loops that rest then
    minimum_duty: float
    tilt_limit: float
    rate_limit: FloatArray  # (3,)
    integral_limit: FloatArray  # (4,) in units of the command
    torque_limit: FloatArray  # (3,)
    thrust_limit: FloatArray  # (2,)


class ControlState(NamedTuple):
    """What a controller remembers and commands."""

    integral: FloatArray  # (4,) integrals of the pose error times I, in units of the command
    setpoint: FloatArray  # (3,) roll, pitch, yaw [rad]
    rate: FloatArray  # (3,) body rates [rad/s]
    wrench: FloatArray  # (4,) thrust [N] and torques [N m]
    duty: FloatArray  # (n,) 0..1
    motors: FloatArray  # (1,) 0 disarmed, 1 armed and idle, 2 flying


def second_order(wn_rad_s: float, zeta: float, dt_s: float) -> Transition:
    """Exact step of wn^2 / (s^2 + 2 zeta wn s + wn^2), with zeta = sqrt(1/2) a Butterworth low-pass."""
    from scipy.linalg import expm

    f = expm(dt_s * np.array([[0.0, 1.0], [-wn_rad_s * wn_rad_s, -2.0 * zeta * wn_rad_s]]))
    return float(f[0, 0]), float(f[0, 1]), float(f[1, 0]), float(f[1, 1])


@jit
def _low_pass(value: FloatArray, slope: FloatArray, transition: Transition, target: FloatArray) -> None:
    f11, f12, f21, f22 = transition
    for i in range(3):
        behind, rate = value[i] - target[i], slope[i]
        value[i] = target[i] + f11 * behind + f12 * rate
        slope[i] = f21 * behind + f22 * rate


@jit
def tilt_from_accel(f_x: float, f_y: float, f_z: float) -> tuple[float, float]:
    """Roll and pitch [rad] that a resting accelerometer reading (specific force, FRD) means, T Eq 2.30-2.32."""
    norm = math.sqrt(f_x * f_x + f_y * f_y + f_z * f_z)
    if norm < EPSILON:
        return 0.0, 0.0
    a_x, a_y, a_z = -f_x / norm, -f_y / norm, -f_z / norm
    return math.atan2(a_y, a_z), math.atan2(-a_x, math.sqrt(a_y * a_y + a_z * a_z))


@jit
def euler_rates(phi: float, theta: float, p: float, q: float, r: float) -> tuple[float, float, float]:
    """The slopes of roll, pitch and yaw under these body rates, W(eta) rate [rad/s]."""
    sine, cosine = math.sin(phi), math.cos(phi)
    turn = (q * sine + r * cosine) / math.cos(theta)
    return p + math.sin(theta) * turn, q * cosine - r * sine, turn


@jit
def advance_estimate(
    estimate: FloatArray, accel: FloatArray, estimator: Estimator, reading: FloatArray, yaw_seen: float, dt: float
) -> None:
    """Advance the thesis's nine states and the filtered accelerometer (3,) in place by one sample.

    reading: (6,) gyro and accelerometer, FRD. yaw_seen: from motion capture [rad].
    """
    _low_pass(estimate[3:6], estimate[6:9], estimator.gyro_filter, reading)
    for i in range(3):
        accel[i] += estimator.accel_gain * (reading[3 + i] - accel[i])
    phi_acc, theta_acc = tilt_from_accel(accel[0], accel[1], accel[2])
    phi, theta, psi = estimate[0], estimate[1], estimate[2]
    dphi, dtheta, dpsi = euler_rates(phi, theta, estimate[3], estimate[4], estimate[5])
    estimate[0] = wrapped(phi + (dt * dphi + estimator.correction * wrapped(phi_acc - phi)))
    estimate[1] = wrapped(theta + (dt * dtheta + estimator.correction * (theta_acc - theta)))
    estimate[2] = wrapped(psi + (dt * dpsi + estimator.correction * wrapped(yaw_seen - psi)))


@jit
def advance_estimates(state: TwinEstimator, reading: FloatArray, estimate: FloatArray, dt: float) -> None:
    """Advance the estimates of two IMUs by one sample, and leave their mean in estimate (9,). reading: (2, 6), FRD."""
    for k in range(IMUS):
        _low_pass(state.rate[k], state.acceleration[k], state.rate_filter, reading[k, :3])
        _low_pass(state.accel[k], state.accel_slope[k], state.accel_filter, reading[k, 3:])
        phi_seen, theta_seen = tilt_from_accel(state.accel[k, 0], state.accel[k, 1], state.accel[k, 2])
        phi, theta = state.angle[k, 0], state.angle[k, 1]
        dphi, dtheta, dpsi = euler_rates(phi, theta, reading[k, 0], reading[k, 1], reading[k, 2])
        error_phi, error_theta = wrapped(phi_seen - phi), theta_seen - theta
        state.correction[k, 0] += dt * state.correction_i * error_phi
        state.correction[k, 1] += dt * state.correction_i * error_theta
        dphi = dphi + state.correction_p * error_phi + state.correction[k, 0]
        dtheta = dtheta + state.correction_p * error_theta + state.correction[k, 1]
        state.angle[k, 0] = wrapped(phi + dt * dphi)
        state.angle[k, 1] = wrapped(theta + dt * dtheta)
        state.angle[k, 2] += dt * dpsi
    for axis in range(3):
        estimate[axis] = 0.5 * (state.angle[0, axis] + state.angle[1, axis])
        estimate[3 + axis] = 0.5 * (state.rate[0, axis] + state.rate[1, axis])
        estimate[6 + axis] = 0.5 * (state.acceleration[0, axis] + state.acceleration[1, axis])


@jit
def see(state: TwinEstimator, pose: FloatArray) -> None:
    """Filter the cameras' pose (4,) as the manufacturer does; yaw is unwrapped first."""
    f11, f12, f21, f22 = state.pose_filter
    for i in range(4):
        behind, rate = state.seen[i] - pose[i], state.velocity[i]
        if i == 3:
            behind = wrapped(behind)
        state.seen[i] = pose[i] + f11 * behind + f12 * rate
        state.velocity[i] = f21 * behind + f22 * rate


@jit
def thrust_of(thrust_map: ThrustMap, volts: float) -> float:
    """Thrust of a rotor at a motor voltage [N], by the manufacturer's map; never negative."""
    a, b, c = thrust_map
    return max(a * volts * volts + b * volts + c, 0.0)


@jit
def voltage_of(thrust_map: ThrustMap, force: float) -> float:
    """Motor voltage for a thrust [V]: the inverse of the map; 0 for no thrust."""
    a, b, c = thrust_map
    return 0.0 if force <= 0.0 else (-b + math.sqrt(b * b + 4.0 * a * (force - c))) / (2.0 * a)


@jit
def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@inline
def _piv(state: ControlState, gains: Controller, axis: int, error: float, rate_error: float, dt: float) -> float:
    p, v, i = gains.pose[axis]
    limit = gains.integral_limit[axis]
    state.integral[axis] = _clip(state.integral[axis] + i * error * dt, -limit, limit)
    return float(p * error + v * rate_error + state.integral[axis])


@inline
def _outer_loop(
    state: ControlState, gains: Controller, path: FloatArray, pose: FloatArray, speed: FloatArray, r: float, dt: float
) -> None:
    """Pose error to attitude, thrust and yaw rate (T Eq 2.22-2.29)."""
    c, s = math.cos(pose[3]), math.sin(pose[3])
    e_n, e_e = path[0] - pose[0], path[1] - pose[1]
    v_n, v_e = path[3] - speed[0], path[4] - speed[1]
    ahead = _piv(state, gains, 0, c * e_n + s * e_e, c * v_n + s * v_e, dt)
    right = _piv(state, gains, 1, c * e_e - s * e_n, c * v_e - s * v_n, dt)
    down = _piv(state, gains, 2, path[2] - pose[2], path[5] - speed[2], dt)
    turn = _piv(state, gains, 3, wrapped(path[6] - pose[3]), path[7] - r, dt)
    state.setpoint[0] = _clip(right, -gains.tilt_limit, gains.tilt_limit)
    state.setpoint[1] = _clip(-ahead, -gains.tilt_limit, gains.tilt_limit)
    state.rate[2] = _clip(gains.yaw_rate * turn, -gains.rate_limit[2], gains.rate_limit[2])
    state.wrench[0] = _clip(gains.trim - down, gains.thrust_limit[0], gains.thrust_limit[1])


@inline
def _inner_loop(
    state: ControlState, gains: Controller, estimate: FloatArray, thrust_map: ThrustMap | None, volts: float
) -> None:
    """Attitude to rates to torques to duties (T Eq 2.36, 2.40, 2.43, 2.44)."""
    for axis in range(2):
        rate = gains.attitude_p * (state.setpoint[axis] - estimate[axis]) + gains.attitude_d * estimate[3 + axis]
        state.rate[axis] = _clip(rate, -gains.rate_limit[axis], gains.rate_limit[axis])
    for axis in range(3):
        torque = gains.rate_gain[axis, 0] * (state.rate[axis] - estimate[3 + axis])
        torque += gains.rate_gain[axis, 1] * estimate[6 + axis]
        state.wrench[1 + axis] = _clip(torque, -gains.torque_limit[axis], gains.torque_limit[axis])
    for i in range(len(state.duty)):
        force = 0.0
        for k in range(4):
            force += gains.mixer[i, k] * state.wrench[k]
        if thrust_map is None:
            duty = math.sqrt(max(force, 0.0) / gains.full_thrust)
        else:
            duty = voltage_of(thrust_map, force) / volts
        state.duty[i] = _clip(duty, gains.minimum_duty, 1.0)


@jit
def _stand(state: ControlState, gains: Controller) -> None:
    idle = state.motors[0] == IDLE
    duty = gains.minimum_duty if idle else 0.0
    rests = len(state.duty) * gains.full_thrust * duty * duty
    state.wrench[0] = gains.ground_thrust if idle and gains.ground_thrust > 0.0 else rests
    for axis in range(3):
        state.setpoint[axis] = state.rate[axis] = state.wrench[1 + axis] = 0.0
    for i in range(len(state.duty)):
        state.duty[i] = duty


@inline
def control(
    state: ControlState,
    gains: Controller,
    path: FloatArray,
    pose: FloatArray,
    velocity: FloatArray,
    yaw_rate: float,
    estimate: FloatArray,
    thrust_map: ThrustMap | None,
    volts: float,
    dt: float,
) -> None:
    """One pass of the cascade; the commands are left in `state`. Without a map duties follow the square law.

    path: (9,) from `trajectory.reference`. pose, velocity: (4,) and (3,) or more from motion capture. yaw_rate: as fed
    back to the yaw loop. estimate: (9,). volts: of the battery.
    """
    state.motors[0], loops_rest = min(path[8], FLYING), gains.ground_thrust == 0.0
    if path[8] >= LANDING and pose[2] > -LANDED_M:
        state.motors[0] = IDLE if loops_rest and path[8] != SHUTDOWN else DISARMED
    if state.motors[0] == FLYING:
        _outer_loop(state, gains, path, pose, velocity, yaw_rate, dt)
    else:
        _stand(state, gains)
    state.setpoint[2] = path[6]
    if state.motors[0] == FLYING or (state.motors[0] == IDLE and not loops_rest):
        _inner_loop(state, gains, estimate, thrust_map, volts)
