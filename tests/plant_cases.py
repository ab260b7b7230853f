"""Vehicles and flights that several plant tests share."""

from dataclasses import replace

import numpy as np

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.airframe import Airframe
from sitl_plant.plant import Plant, PlantConfig, PlantSamples
from sitl_plant.vehicle import Vehicle, qdrone2


def nominal_airframe(vehicle: Vehicle) -> Airframe:
    """A specimen without spread, unbalance or bias: what the drawing office had in mind."""
    n = len(vehicle.rotors)
    return Airframe(
        name="nominal",
        vehicle=vehicle,
        inertia_kg_m2=np.array(vehicle.body.inertia_kg_m2),
        centre_of_gravity_m=np.zeros(3),
        thrust_coefficient_n_s2=np.full(n, vehicle.propulsion.thrust_coefficient_n_s2),
        motor_lag_s=np.full(n, vehicle.propulsion.motor_lag_s),
        unbalance_g_mm=np.zeros((n, 2)),
        thrust_noise_rms=vehicle.propulsion.thrust_noise_rms,
        battery_gain=1.0,
        gyro_bias=np.zeros(3),
    )


def quiet_vehicle() -> Vehicle:
    """A QDrone 2 without any noise: what it does follows from its numbers alone."""
    vehicle = qdrone2()
    return replace(
        vehicle,
        propulsion=replace(vehicle.propulsion, thrust_noise_rms=0.0),
        imu=replace(vehicle.imu, gyro_noise_density=0.0, accel_noise_density=0.0, gyro_bias_rms=0.0),
        mocap=replace(vehicle.mocap, marker_noise_rms_m=0.0, occlusion_probability=0.0),
    )


def quiet_airframe() -> Airframe:
    return nominal_airframe(quiet_vehicle())


def fly(config: PlantConfig, seconds: float) -> PlantSamples:
    return Plant(config).advance(round(seconds * 1000))


def quaternion_rotation(q: FloatArray) -> FloatArray:
    """Rotation matrix body to world of one quaternion, w first, by scipy."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(np.roll(q, -1)).as_matrix(), dtype=np.float64)
