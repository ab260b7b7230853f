"""Rotors and what feeds them: speed, phase, thrust, drag torque, the forces that turn with an unbalanced propeller.

Per rotor i, with sign s (+1 clockwise seen from above) and azimuth theta:

    dw/dt = (w_cmd - w) / lag                 exact over a step, w_cmd is held
    F     = K_F w^2 (1 + noise) gain (1 + fluctuation)                        T Eq 2.11
    Q     = K_F w^2 (1 + noise) drag / 68.9055                                T Eq 2.5, against the rotation
    f     = U w^2 e(theta)                    in the rotor plane, from the hub
    T     = r_hub × f + d(theta) × (-F e_z)   mass and lift torques, opposed      T Eq 5.3-5.9

`e(theta)` turns with the rotor; d is the offset of the centre of lift, in the direction of f. The phase is carried from
step to step, so the line at one per revolution (167 Hz in hover) has its true amplitude U w^2 / m in the acceleration.
"""

import math
from typing import NamedTuple

from mavdiag.jit import jit
from mavdiag.telemetry import FloatArray
from mavdiag.units import S_PER_H
from sitl_plant.physics.dynamics import STAGES, WRENCH


class Rotors(NamedTuple):
    """Constants of the n rotors of one airframe. hub: (n, 3) from the centre of gravity, FRD. Others (n,) or scalar."""

    hub: FloatArray
    sign: FloatArray
    thrust_coefficient: FloatArray
    lag: FloatArray
    decay: FloatArray  # (n, 3) exp(-t / lag) at start, middle and end of a step
    torque_per_thrust: float
    inertia: float
    noise_rms: float
    noise_decay: float  # exp(-2 pi f_c dt) of the thrust noise


class Condition(NamedTuple):
    """Health of the n rotors, held between two events: (n,), and (n, 2) for the vectors in the rotor's frame."""

    thrust_gain: FloatArray  # 1 is healthy, as of the next two
    drag_gain: FloatArray
    speed_gain: FloatArray
    unbalance: FloatArray  # (n, 2) [kg m]
    lift_offset: FloatArray  # (n, 2) [m]
    fluctuation_rms: FloatArray  # share of thrust
    fluctuation_decay: FloatArray  # exp(-2 pi f_c dt)
    thrust_lag: FloatArray  # [s]


class RotorState(NamedTuple):
    """What the rotors remember, all (n,): speed [rad/s], azimuth [rad], unit noises, lagged thrust [N]."""

    speed: FloatArray
    azimuth: FloatArray
    turn: FloatArray  # (n, 2) its cosine and sine
    noise: FloatArray
    fluctuation: FloatArray
    thrust: FloatArray


class Battery(NamedTuple):
    """Constants. speed_per_volt: rad/s per volt at full duty, gain of the specimen included (T Eq 2.10)."""

    speed_per_volt: float
    open_circuit: float
    resistance: float
    slope: float  # V/(A h)
    power_per_cube: float  # electric power of a rotor over w^3 [W s^3]
    avionics: float  # A


@jit
def advance_battery(state: FloatArray, battery: Battery, speed: FloatArray, dt: float) -> None:
    """Draw current for one step. state: (2,) voltage [V] and charge drawn [A h]."""
    power = 0.0
    for i in range(len(speed)):
        power += battery.power_per_cube * speed[i] ** 3
    current = power / state[0] + battery.avionics
    state[1] += current * dt / S_PER_H
    state[0] = battery.open_circuit - battery.slope * state[1] - battery.resistance * current


@jit
def advance_noise(state: RotorState, rotors: Rotors, condition: Condition, normals: FloatArray, row: int) -> None:
    """Advance the Ornstein-Uhlenbeck noises by one step, exactly. normals: (steps, 2 n), of which `row` is used.

    x' = a x + sqrt(1 - a^2) n has unit variance at every corner frequency.
    """
    n, a = len(state.speed), rotors.noise_decay
    b = math.sqrt(1.0 - a * a)
    for i in range(n):
        state.noise[i] = a * state.noise[i] + b * normals[row, i]
        c = condition.fluctuation_decay[i]
        state.fluctuation[i] = c * state.fluctuation[i] + math.sqrt(1.0 - c * c) * normals[row, n + i]


@jit
def advance_rotors(
    state: RotorState, rotors: Rotors, condition: Condition, command: FloatArray, dt: float, wrench: FloatArray
) -> None:
    """Advance all rotors by dt towards `command` [rad/s] and write their wrench at start, middle and end of the step.

    wrench: (3, 8), rows as in `sitl_plant.physics.dynamics`; overwritten.
    """
    for stage in range(STAGES):
        for k in range(WRENCH):
            wrench[stage, k] = 0.0
    for i in range(len(state.speed)):
        # read once: the compiler cannot know that what is written below is none of it
        wanted, lag, azimuth, sign = command[i], rotors.lag[i], state.azimuth[i], rotors.sign[i]
        x, y, z = rotors.hub[i, 0], rotors.hub[i, 1], rotors.hub[i, 2]
        u_x, u_y = condition.unbalance[i, 0], condition.unbalance[i, 1]
        d_x, d_y = condition.lift_offset[i, 0], condition.lift_offset[i, 1]
        coefficient, drag = rotors.thrust_coefficient[i], condition.drag_gain[i]
        slow, before = condition.thrust_lag[i], state.thrust[i]
        excess, cosine, sine = state.speed[i] - wanted, state.turn[i, 0], state.turn[i, 1]
        noise = 1.0 + rotors.noise_rms * state.noise[i]
        gain = condition.thrust_gain[i] * (1.0 + condition.fluctuation_rms[i] * state.fluctuation[i])
        for stage in range(STAGES):
            decay = rotors.decay[i, stage]
            speed = wanted + excess * decay
            # theta = theta_0 + integral of w, with w = w_cmd + excess exp(-t / lag)
            theta = azimuth + wanted * (0.5 * stage * dt) + excess * lag * (1.0 - decay)
            if stage:
                cosine, sine = math.cos(theta), math.sin(theta)
            squared, across = speed * speed, sign * sine
            lift = coefficient * squared * noise
            thrust = lift * gain
            if slow > 0.0:
                thrust += (before - thrust) * math.exp(-0.5 * stage * dt / slow)
            f_x, f_y = (cosine * u_x - across * u_y) * squared, (across * u_x + cosine * u_y) * squared
            wrench[stage, 0] += f_x
            wrench[stage, 1] += f_y
            wrench[stage, 2] -= thrust
            wrench[stage, 3] -= (y + across * d_x + cosine * d_y) * thrust + z * f_y
            wrench[stage, 4] += (x + cosine * d_x - across * d_y) * thrust + z * f_x
            wrench[stage, 5] += x * f_y - y * f_x - sign * lift * drag * rotors.torque_per_thrust
            wrench[stage, 6] += rotors.inertia * sign * speed
            wrench[stage, 7] -= rotors.inertia * sign * excess * decay / lag
        if 2.0 * math.pi <= theta < 4.0 * math.pi:
            theta -= 2.0 * math.pi
        elif not 0.0 <= theta < 2.0 * math.pi:
            theta %= 2.0 * math.pi
        state.speed[i], state.azimuth[i], state.thrust[i] = speed, theta, thrust
        state.turn[i, 0], state.turn[i, 1] = cosine, sine
