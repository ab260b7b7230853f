"""One specimen of a vehicle type: what manufacture, age and payload made of the numbers in the file.

Drones 1 (aged), 2 and 3 (new) are the three of T 4.4 and always come out the same; `draw_airframe` gives as many
others as a Monte Carlo study needs.
"""

from dataclasses import dataclass

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from sitl_plant.vehicle import Vehicle

__all__ = ["NO_PAYLOAD", "Airframe", "Payload", "draw_airframe", "drone"]

# The seeds that make drones 1, 2 and 3: of n, n + 10, n + 20, ... the first with every draw within 1.5 standard
# deviations and the battery gain within 1.2 %, so that the three are ordinary specimens.
DRONE_SEEDS = (41, 252, 53)
AGED_DRONE = 1


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

    inertia_kg_m2: (3,) about the centre of gravity. centre_of_gravity_m: (3,) from the geometric centre.
    thrust_coefficient_n_s2, motor_lag_s: (n,). unbalance_g_mm: (n, 2) in the rotor's own frame.
    battery_gain: 1 is nominal. gyro_bias: (3,) rad/s. charge_used_ah: drawn from the battery before the flight.
    """

    name: str
    vehicle: Vehicle
    inertia_kg_m2: FloatArray
    centre_of_gravity_m: FloatArray
    thrust_coefficient_n_s2: FloatArray
    motor_lag_s: FloatArray
    unbalance_g_mm: FloatArray
    thrust_noise_rms: float
    battery_gain: float
    gyro_bias: FloatArray
    charge_used_ah: float = 0.0


def draw_airframe(vehicle: Vehicle, aged: bool, rng: np.random.Generator, name: str = "drawn") -> Airframe:
    """Draw a specimen, new or aged, by the spreads in the vehicle file (estimates)."""
    n = len(vehicle.rotors)
    spread, propulsion = vehicle.spread, vehicle.propulsion
    wider = spread.aged_spread_factor if aged else 1.0
    thrust = 1.0 + wider * spread.thrust_coefficient_rms * rng.standard_normal(n)
    offset = wider * spread.centre_of_gravity_rms_m * rng.standard_normal(2)
    lag = 1.0 + wider * spread.motor_lag_rms * rng.standard_normal(n)
    inertia = 1.0 + wider * spread.inertia_rms * rng.standard_normal(3)
    battery = 1.0 + spread.battery_gain_max * rng.uniform(-1.0, 1.0)
    unbalance = propulsion.unbalance_max_g_mm * (spread.aged_unbalance_factor if aged else 1.0) * rng.random(n)
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    return Airframe(
        name=name,
        vehicle=vehicle,
        inertia_kg_m2=np.array(vehicle.body.inertia_kg_m2) * inertia,
        centre_of_gravity_m=np.array([offset[0], offset[1], 0.0]),
        thrust_coefficient_n_s2=propulsion.thrust_coefficient_n_s2
        * thrust
        * (1.0 + (spread.aged_thrust_coefficient if aged else 0.0)),
        motor_lag_s=propulsion.motor_lag_s * lag * (1.0 + (spread.aged_motor_lag if aged else 0.0)),
        unbalance_g_mm=np.column_stack([unbalance * np.cos(angle), unbalance * np.sin(angle)]),
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
