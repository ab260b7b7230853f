"""What an allocation for a weak rotor gives (fault-tolerant control, the thesis's outlook): tilt error and demand.

    python benchmarks/weak_rotor.py [--seeds 3] [--seconds 30]

Flights in turbulence, from hover: standing still, a square, the nose turning. From 2 s on one rotor has lost a share of
its thrust. Four controllers: as it is; with the allocation of `sparing` (trim); the same with a demand on the
weak rotor of at most LIMIT times hover; trim and limit for 10 percentage points less than were lost, as a detector may
be wrong. Each as: root mean square of set-point less attitude in roll and pitch [deg], mean and 99.9 % quantile of the
weak rotor's duty [%], root mean square of the height error [cm].
"""

import argparse
import math
from itertools import product

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.control import Controller
from sitl_plant.physics.dynamics import GRAVITY
from sitl_plant.physics.faults import Injection, RotorDamage
from sitl_plant.physics.parameters import make_controller
from sitl_plant.plant import Plant, PlantConfig
from sitl_plant.vehicle import Vehicle, allocation, vehicle_named

ROTOR, ONSET_S, SETTLED_S, ALTITUDE_M = 2, 2.0, 5.0, 2.0
WAYS = {"hover": {"trajectory": "hover"}, "square": {"speed_m_s": 1.5, "size_m": 3.0}, "spin": {"nose": "spin"}}
LIMIT = 2.0  # at 1.5 the quadrotor loses itself in the fast square
CONTROLLERS = {"as it is": None, "trim": (0.0, math.inf), "trim, limit": (0.0, LIMIT), "10 points short": (0.1, LIMIT)}


def sparing(vehicle: Vehicle, rotor: int, thrust_left: float, demand: float) -> Controller:
    """The vehicle's controller with an allocation that spares a weak rotor (fault-tolerant control, the outlook of T).

    F = W pinv(A E W) [T, tau] with the motor mapping A; E and W have thrust_left for the weak rotor, else 1. By E it is
    commanded more for the same lift (trim), by W the others take a part of its load where they can (more than four).
    demand: most that is asked of it, over its share in hover (thrust limit): of what is above, each of thrust and three
    torques gets a quarter; inf for no such limit.
    """
    controller, weights = make_controller(vehicle), np.ones(len(vehicle.rotors))
    weights[rotor - 1] = thrust_left
    mixer = weights[:, None] * np.linalg.pinv(allocation(vehicle) * weights * weights)
    hover, asked = vehicle.body.mass_kg * GRAVITY, np.maximum(np.abs(mixer[rotor - 1]), 1e-9)
    room = 0.25 * (demand - 1.0) * asked[0] * hover / asked  # of [T, tau]
    return controller._replace(
        mixer=np.ascontiguousarray(mixer),
        thrust_limit=np.minimum(controller.thrust_limit, hover + room[0]),
        torque_limit=np.minimum(controller.torque_limit, room[1:]),
    )


def fly(vehicle: str, way: str, lost: float, told: tuple[float, float] | None, seed: int, seconds: float) -> FloatArray:
    """The figures of one flight, as above. told: by how much less the controller knows; demand."""
    config = PlantConfig(
        drone=3,
        vehicle=vehicle_named(vehicle),
        seed=seed,
        altitude_m=ALTITUDE_M,
        wind_m_s=2.0,
        turbulence_m_s=6.0,
        injections=(Injection(RotorDamage(thrust_factor=1.0 - lost), ROTOR, ONSET_S),),
        **WAYS[way],  # type: ignore[arg-type]  # of several types
    )
    plant = Plant(config)
    plant.advance(round(1000 * ONSET_S))
    if told is not None:
        plant.take_controller(sparing(config.vehicle, ROTOR, min(1.0, 1.0 - lost + told[0]), told[1]))
    plant.advance(round(1000 * (SETTLED_S - ONSET_S)))
    flown = plant.advance(round(1000 * (seconds - SETTLED_S)))
    tilt = np.degrees((flown.setpoint - flown.attitude[:, :3])[:, :2])
    duty, height = 100.0 * flown.duty[:, ROTOR - 1], 100.0 * (flown.position[:, 2] + ALTITUDE_M)
    tilt_rms, height_rms = (np.sqrt(np.mean(error**2)) for error in (tilt, height))
    return np.array([tilt_rms, duty.mean(), np.quantile(duty, 0.999), height_rms])


def main() -> None:
    """Print all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=30.0)
    options = parser.parse_args()
    for vehicle, way, lost in product(("qdrone2", "hexa-x"), WAYS, (0.1, 0.2)):
        print(f"{vehicle}, {way}, {100 * lost:.0f} % of the thrust of motor {ROTOR} lost", flush=True)
        for name, told in CONTROLLERS.items():
            found = [fly(vehicle, way, lost, told, seed, options.seconds) for seed in range(options.seeds)]
            tilt, mean, most, height = np.mean(found, axis=0).tolist()
            print(
                f"  {name:<15} tilt error {tilt:5.2f}  duty {mean:5.2f}, most {most:5.2f}  height {height:5.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
