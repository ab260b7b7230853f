"""Rotors: speed, phase, thrust, drag torque and the forces that turn with an unbalanced propeller.

Per rotor i, with sign s (+1 clockwise seen from above) and azimuth theta:

    dw/dt = (w_cmd - w) / lag                 exact over a step, w_cmd is held
    F     = K_F w^2 (1 + noise) gain (1 + fluctuation)                        T Eq 2.11
    Q     = K_F w^2 (1 + noise) drag / 68.9055                                T Eq 2.5, against the rotation
    f     = U w^2 e(theta)                    in the rotor plane, from the hub
    T     = r_hub × f + d(theta) × (-F e_z)   mass and lift torques, opposed      T Eq 5.3-5.9

`e(theta)` turns with the rotor. d is the offset of the centre of lift, in the direction of f: both point to the whole
blade, so the two torques oppose each other as T 5.5.2 says. The phase is carried from step to step, so the line at one
per revolution (167 Hz in hover) has its true amplitude U w^2 / m in the acceleration.
"""

from typing import NamedTuple

import numpy as np

from mavdiag.quantities import FloatArray
from sitl_plant.dynamics import STAGES
from sitl_plant.jit import jit

__all__ = ["Condition", "RotorState", "Rotors", "advance_noise", "advance_rotors"]


class Rotors(NamedTuple):
    """Constants of the n rotors of one airframe. hub: (n, 3) from the centre of gravity, FRD. Others (n,) or scalar."""

    hub: FloatArray
    sign: FloatArray
    thrust_coefficient: FloatArray
    lag: FloatArray
    torque_per_thrust: float
    inertia: float
    noise_rms: float
    noise_decay: float  # exp(-2 pi f_c dt) of the thrust noise


class Condition(NamedTuple):
    """Health of the n rotors, held between two events. All (n,) but the vectors, which are (n, 2) in the rotor's frame.

    thrust_gain, drag_gain, speed_gain: 1 is healthy. unbalance: [kg m]. lift_offset: [m].
    fluctuation_rms: share of thrust. fluctuation_decay: exp(-2 pi f_c dt). thrust_lag: [s].
    """

    thrust_gain: FloatArray
    drag_gain: FloatArray
    speed_gain: FloatArray
    unbalance: FloatArray
    lift_offset: FloatArray
    fluctuation_rms: FloatArray
    fluctuation_decay: FloatArray
    thrust_lag: FloatArray


class RotorState(NamedTuple):
    """What the rotors remember, all (n,): speed [rad/s], azimuth [rad], unit noises, lagged thrust [N]."""

    speed: FloatArray
    azimuth: FloatArray
    noise: FloatArray
    fluctuation: FloatArray
    thrust: FloatArray


@jit
def advance_noise(state: RotorState, rotors: Rotors, condition: Condition, normals: FloatArray) -> None:
    """Advance the Ornstein-Uhlenbeck noises by one step, exactly. normals: (2 n,) standard normal numbers.

    x' = a x + sqrt(1 - a^2) n has unit variance at every corner frequency.
    """
    n = len(state.speed)
    a = rotors.noise_decay
    b = np.sqrt(1.0 - a * a)
    for i in range(n):
        state.noise[i] = a * state.noise[i] + b * normals[i]
        c = condition.fluctuation_decay[i]
        state.fluctuation[i] = c * state.fluctuation[i] + np.sqrt(1.0 - c * c) * normals[n + i]


@jit
def advance_rotors(
    state: RotorState, rotors: Rotors, condition: Condition, command: FloatArray, dt: float, wrench: FloatArray
) -> None:
    """Advance all rotors by dt towards `command` [rad/s] and write their wrench at start, middle and end of the step.

    wrench: (3, 8), rows as in `sitl_plant.dynamics`; overwritten.
    """
    wrench[:, :] = 0.0
    for i in range(len(state.speed)):
        start, lag, azimuth = state.speed[i], rotors.lag[i], state.azimuth[i]
        excess = start - command[i]
        half = np.exp(-0.5 * dt / lag)
        decay = 1.0
        noise = 1.0 + rotors.noise_rms * state.noise[i]
        gain = condition.thrust_gain[i] * (1.0 + condition.fluctuation_rms[i] * state.fluctuation[i])
        for stage in range(STAGES):
            speed = command[i] + excess * decay
            # theta = theta_0 + integral of w, with w = w_cmd + excess exp(-t / lag)
            theta = azimuth + command[i] * (0.5 * stage * dt) + excess * lag * (1.0 - decay)
            lift = rotors.thrust_coefficient[i] * speed * speed * noise
            thrust = _lagged(state.thrust[i], lift * gain, condition.thrust_lag[i], 0.5 * stage * dt)
            _add_rotor(wrench[stage], rotors, condition, i, speed, theta, thrust, lift)
            wrench[stage, 7] -= rotors.inertia * rotors.sign[i] * excess * decay / lag
            decay *= half
        state.speed[i], state.azimuth[i], state.thrust[i] = speed, theta % (2.0 * np.pi), thrust


@jit
def _lagged(before: float, target: float, lag: float, span: float) -> float:
    """First-order lag of thrust after `span` seconds; no lag at all if it is zero."""
    if lag <= 0.0:
        return target
    return target + (before - target) * np.exp(-span / lag)


@jit
def _add_rotor(
    row: FloatArray,
    rotors: Rotors,
    condition: Condition,
    i: int,
    speed: float,
    theta: float,
    thrust: float,
    lift: float,
) -> None:
    """Add rotor i at azimuth theta to a wrench row."""
    sign = rotors.sign[i]
    cosine, sine = np.cos(theta), sign * np.sin(theta)
    U, d = condition.unbalance[i], condition.lift_offset[i]
    squared = speed * speed
    f_x = (cosine * U[0] - sine * U[1]) * squared
    f_y = (sine * U[0] + cosine * U[1]) * squared
    x = rotors.hub[i, 0] + cosine * d[0] - sine * d[1]
    y = rotors.hub[i, 1] + sine * d[0] + cosine * d[1]
    z = rotors.hub[i, 2]
    row[0] += f_x
    row[1] += f_y
    row[2] -= thrust
    row[3] += -y * thrust - z * f_y
    row[4] += x * thrust + z * f_x
    row[5] += rotors.hub[i, 0] * f_y - rotors.hub[i, 1] * f_x
    row[5] -= sign * lift * condition.drag_gain[i] * rotors.torque_per_thrust
    row[6] += rotors.inertia * sign * speed
