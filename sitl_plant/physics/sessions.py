"""What changes on one airframe from day to day: a session, a set of propellers, wear.

The spreads are estimates; no measurement of them is known to us. `sitl_plant.physics.airframe` draws the airframe.
"""

from dataclasses import dataclass, replace

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from mavdiag.units import S_PER_H
from sitl_plant.physics.airframe import Airframe

__all__ = ["Wear", "in_session", "in_session_number", "with_propellers"]

CHARGE_USED_AH = 0.4  # uniform, 0 to this: flights before this one on the battery, or a charge not finished (estimate)
BATTERY_GAIN_RMS = 0.01  # another battery of the type, warm or cold: share of speed per volt (estimate)
BATTERY_SHIFT_RMS_M = 0.0007  # of the centre of gravity, x and y: 358 of 1504 g put back 3 mm elsewhere (estimate)
SEATING_SHARE_MAX = 0.2  # of the permissible unbalance: a propeller taken off and put on again (estimate)
MOST_SPREAD = 0.2


@dataclass(frozen=True, slots=True)
class Wear:
    """Blades that wear: each rotor's thrust coefficient falls in proportion to the hours flown.

    loss_per_h: share of thrust per hour of flight, one for each rotor.
    hours: flown since the airframe was as drawn.
    """

    loss_per_h: tuple[float, ...]
    hours: float = 0.0

    def __post_init__(self) -> None:
        if not all(0.0 <= loss <= 1.0 for loss in self.loss_per_h) or not self.hours >= 0.0:
            raise UsageError("wear needs a loss of 0 to 1 per hour for each rotor, and hours of zero or more")

    def gain(self, t_s: float) -> FloatArray:
        """What is left of each rotor's thrust, (n,), at a flight time."""
        lost = np.array(self.loss_per_h) * (self.hours + max(t_s, 0.0) / S_PER_H)
        return np.maximum(1.0 - lost, 0.0)


def with_propellers(airframe: Airframe, spread: float, rng: np.random.Generator) -> Airframe:
    """The airframe with a new healthy set of propellers.

    Each thrust coefficient is that of the old set times 1 ± `spread`, uniform; each unbalance is uniform up to the
    permissible one, at any angle. Raises UsageError for a spread that is no small share.
    """
    if not 0.0 <= spread <= MOST_SPREAD:
        raise UsageError(f"propellers must spread by 0 to {MOST_SPREAD:g}, not {spread:g}")
    n = len(airframe.vehicle.rotors)
    thrust = 1.0 + rng.uniform(-spread, spread, n)
    size = airframe.vehicle.propulsion.unbalance_max_g_mm * rng.random(n)
    return replace(
        airframe,
        thrust_coefficient_n_s2=airframe.thrust_coefficient_n_s2 * thrust,
        unbalance_g_mm=_vectors(size, rng.uniform(0.0, 2.0 * np.pi, n)),
    )


def in_session(airframe: Airframe, rng: np.random.Generator) -> Airframe:
    """The airframe on another day: battery and its place, gyro bias, and how the propellers sit are drawn anew."""
    n = len(airframe.vehicle.rotors)
    shift = BATTERY_SHIFT_RMS_M * rng.standard_normal(2)
    seating = SEATING_SHARE_MAX * airframe.vehicle.propulsion.unbalance_max_g_mm * rng.random(n)
    return replace(
        airframe,
        battery_gain=airframe.battery_gain * (1.0 + BATTERY_GAIN_RMS * float(rng.standard_normal())),
        charge_used_ah=CHARGE_USED_AH * float(rng.random()),
        centre_of_gravity_m=airframe.centre_of_gravity_m + np.array([shift[0], shift[1], 0.0]),
        gyro_bias=airframe.vehicle.imu.gyro_bias_rms * rng.standard_normal(3),
        unbalance_g_mm=airframe.unbalance_g_mm + _vectors(seating, rng.uniform(0.0, 2.0 * np.pi, n)),
    )


def in_session_number(airframe: Airframe, session: int, spread: float = 0.0) -> Airframe:
    """The airframe in session 0, 1, 2, ...: 0 as it was drawn, the others by their number alone.

    spread: above zero, each session has a new set of propellers, see `with_propellers`.
    Raises UsageError for a negative number.
    """
    if session < 0:
        raise UsageError(f"session must be zero or more, not {session}")
    if session == 0 and spread == 0.0:
        return airframe
    rng = np.random.default_rng([0x5E55, session, *airframe.name.encode()])
    today = in_session(airframe, rng) if session else airframe
    return with_propellers(today, spread, rng) if spread > 0.0 else today


def _vectors(size: FloatArray, angle: FloatArray) -> FloatArray:
    return np.column_stack([size * np.cos(angle), size * np.sin(angle)])
