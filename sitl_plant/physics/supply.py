"""Battery and wind: what the vehicle flies on and what it flies in."""

from typing import NamedTuple

import numpy as np

from mavdiag.telemetry import FloatArray
from mavdiag.units import S_PER_H
from sitl_plant.physics.jit import jit

__all__ = ["Air", "Battery", "advance_battery", "advance_wind"]


class Battery(NamedTuple):
    """Constants. speed_per_volt: rad/s per volt at full duty, gain of the specimen included (T Eq 2.10)."""

    speed_per_volt: float
    open_circuit: float
    resistance: float
    slope: float  # V/(A h)
    power_per_cube: float  # electric power of a rotor over w^3 [W s^3]
    avionics: float  # A


class Air(NamedTuple):
    """mean: (3,) wind, world NED [m/s]. gust_rms: each axis. decay: exp(-2 pi f_c dt).

    With decay 0 and gust_rms 1 the numbers drawn for the wind are the gusts themselves [m/s].
    """

    mean: FloatArray
    gust_rms: float
    decay: float


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
def advance_wind(wind: FloatArray, air: Air, normals: FloatArray, row: int) -> None:
    """Advance the wind (3,) by one step: an Ornstein-Uhlenbeck gust about the mean, exact for any step.

    normals: (steps, 3), of which `row` is used.
    """
    for i in range(3):
        gust = wind[i] - air.mean[i]
        wind[i] = air.mean[i] + air.decay * gust + air.gust_rms * np.sqrt(1.0 - air.decay**2) * normals[row, i]
