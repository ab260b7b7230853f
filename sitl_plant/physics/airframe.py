"""One specimen of a vehicle type: what manufacture, age, the day, new propellers and wear made of the file's numbers.

Drones 1 (aged), 2 and 3 (new) are the three of T 4.4. The spreads are estimates; no measurement of them is known to us.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from sitl_plant.vehicle import Vehicle

# The seeds that make drones 1, 2 and 3: of n, n + 10, n + 20, ... the first with every draw within 1.5 standard
# deviations and the battery gain within 1.2 %, so that the three are ordinary specimens.
DRONE_SEEDS = (41, 252, 53)
AGED_DRONE = 1
CHARGE_USED_AH = 0.4  # uniform, 0 to this: flights before this one on the battery, or a charge not finished (estimate)
BATTERY_GAIN_RMS = 0.01  # another battery of the type, warm or cold: share of speed per volt (estimate)
BATTERY_SHIFT_RMS_M = 0.0007  # of the centre of gravity, x and y: 358 of 1504 g put back 3 mm elsewhere (estimate)
SEATING_SHARE_MAX = 0.2  # of the permissible unbalance: a propeller taken off and put on again (estimate)
MOST_SPREAD = 0.2
NEVER = 2**62  # a step that no flight reaches


def step_at(t_s: float, dt_s: float) -> int:
    """The step of a flight time; infinity is no step of any flight."""
    return NEVER if math.isinf(t_s) else round(t_s / dt_s)


@dataclass(frozen=True, slots=True)
class Payload:
    """A point mass fixed to the airframe at `position_m` (body FRD)."""

    mass_kg: float = 0.0
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.05)

    def __post_init__(self) -> None:
        if not 0.0 <= self.mass_kg <= 1.0:
            raise UsageError(f"payload must be 0 to 1 kg, not {self.mass_kg:g}; T Table 5.1 allows 0.3 kg")


NO_PAYLOAD = Payload()


@dataclass(frozen=True, slots=True, eq=False)
class Airframe:
    """The true constants of one specimen, n rotors. Body FRD; the controller knows only the nominal ones.

    thrust_coefficient_n_s2, motor_lag_s: (n,). unbalance_g_mm: (n, 2) in the rotor's own frame.
    """

    name: str
    vehicle: Vehicle
    inertia_kg_m2: FloatArray  # (3,) about the centre of gravity
    centre_of_gravity_m: FloatArray  # (3,) from the geometric centre
    thrust_coefficient_n_s2: FloatArray
    motor_lag_s: FloatArray
    unbalance_g_mm: FloatArray
    thrust_noise_rms: float
    battery_gain: float  # 1 is nominal
    gyro_bias: FloatArray  # (3,) rad/s
    charge_used_ah: float = 0.0  # drawn from the battery before the flight


def draw_airframe(vehicle: Vehicle, aged: bool, rng: np.random.Generator, name: str = "drawn") -> Airframe:
    """Draw a specimen, new or aged, by the spreads in the vehicle file (estimates)."""
    n, spread, propulsion = len(vehicle.rotors), vehicle.spread, vehicle.propulsion
    wider = spread.aged_spread_factor if aged else 1.0
    thrust = 1.0 + wider * spread.thrust_coefficient_rms * rng.standard_normal(n)
    offset = wider * spread.centre_of_gravity_rms_m * rng.standard_normal(2)
    lag = 1.0 + wider * spread.motor_lag_rms * rng.standard_normal(n)
    inertia = 1.0 + wider * spread.inertia_rms * rng.standard_normal(3)
    battery = 1.0 + spread.battery_gain_max * rng.uniform(-1.0, 1.0)
    unbalance = propulsion.unbalance_max_g_mm * (spread.aged_unbalance_factor if aged else 1.0) * rng.random(n)
    weaker, slower = (spread.aged_thrust_coefficient, spread.aged_motor_lag) if aged else (0.0, 0.0)
    return Airframe(
        name=name,
        vehicle=vehicle,
        inertia_kg_m2=np.array(vehicle.body.inertia_kg_m2) * inertia,
        centre_of_gravity_m=np.array([offset[0], offset[1], 0.0]),
        thrust_coefficient_n_s2=propulsion.thrust_coefficient_n_s2 * thrust * (1.0 + weaker),
        motor_lag_s=propulsion.motor_lag_s * lag * (1.0 + slower),
        unbalance_g_mm=_vectors(unbalance, rng),
        thrust_noise_rms=propulsion.thrust_noise_rms * (spread.aged_noise_factor if aged else 1.0),
        battery_gain=battery,
        gyro_bias=vehicle.imu.gyro_bias_rms * rng.standard_normal(3),
    )


def drone(vehicle: Vehicle, number: int) -> Airframe:
    """Drone 1 (aged), 2 or 3 (new) of the thesis's fleet (T 4.4). Raises UsageError for another number."""
    if number not in range(1, len(DRONE_SEEDS) + 1):
        raise UsageError(f"drone must be 1, 2 or 3, not {number}")
    rng = np.random.default_rng(DRONE_SEEDS[number - 1])
    return draw_airframe(vehicle, aged=number == AGED_DRONE, rng=rng, name=f"drone {number}")


def with_propellers(airframe: Airframe, spread: float, rng: np.random.Generator) -> Airframe:
    """The airframe with a new healthy set of propellers: thrust times 1 ± `spread`, uniform; unbalance as permitted.

    Raises UsageError for a spread that is no small share.
    """
    if not 0.0 <= spread <= MOST_SPREAD:
        raise UsageError(f"propellers must spread by 0 to {MOST_SPREAD:.0%}, not {spread:.0%}")
    n = len(airframe.vehicle.rotors)
    thrust = 1.0 + rng.uniform(-spread, spread, n)
    size = airframe.vehicle.propulsion.unbalance_max_g_mm * rng.random(n)
    return replace(
        airframe, thrust_coefficient_n_s2=airframe.thrust_coefficient_n_s2 * thrust, unbalance_g_mm=_vectors(size, rng)
    )


def in_session(airframe: Airframe, rng: np.random.Generator) -> Airframe:
    """The airframe on another day: battery and its place, gyro bias, and how the propellers sit are drawn anew."""
    n, shift = len(airframe.vehicle.rotors), BATTERY_SHIFT_RMS_M * rng.standard_normal(2)
    seating = SEATING_SHARE_MAX * airframe.vehicle.propulsion.unbalance_max_g_mm * rng.random(n)
    return replace(
        airframe,
        battery_gain=airframe.battery_gain * (1.0 + BATTERY_GAIN_RMS * float(rng.standard_normal())),
        charge_used_ah=CHARGE_USED_AH * float(rng.random()),
        centre_of_gravity_m=airframe.centre_of_gravity_m + np.array([shift[0], shift[1], 0.0]),
        gyro_bias=airframe.vehicle.imu.gyro_bias_rms * rng.standard_normal(3),
        unbalance_g_mm=airframe.unbalance_g_mm + _vectors(seating, rng),
    )


def in_session_number(airframe: Airframe, session: int, spread: float = 0.0) -> Airframe:
    """The airframe in session 0, 1, 2, ...: 0 as it was drawn, the others by their number alone.

    spread: above zero, each session has new propellers. Raises UsageError for a negative number.
    """
    if session < 0:
        raise UsageError(f"session must be zero or more, not {session}")
    rng = np.random.default_rng([0x5E55, session, *airframe.name.encode()])
    today = in_session(airframe, rng) if session else airframe
    return with_propellers(today, spread, rng) if spread else today


def _vectors(size: FloatArray, rng: np.random.Generator) -> FloatArray:
    angle = rng.uniform(0.0, 2.0 * np.pi, len(size))
    return np.column_stack([size * np.cos(angle), size * np.sin(angle)])
