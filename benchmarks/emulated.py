"""Emulated flights as telemetry without the wire, for the benchmarks: same values, same quantisation as RAW_IMU."""

import hashlib

import numpy as np

from mavdiag.learning import Flight
from mavdiag.logs import Log
from mavdiag.quantities import FloatArray, Series, Signal, Telemetry
from sitl_plant.plant import Plant, PlantConfig, PlantSamples

__all__ = ["as_flight", "as_log", "as_telemetry", "fly"]

G = 9.80665


def fly(config: PlantConfig, duration_s: float) -> PlantSamples:
    """A whole flight."""
    return Plant(config).advance(round(duration_s * 1000))


def as_telemetry(samples: PlantSamples, *, noise_rad_s: float = 0.0, seed: int = 0) -> Telemetry:
    """What the `qdrone2` profile tells: gyro in whole mrad/s, accelerometer in whole mG, set-points as they are."""
    t_ns = samples.t_ns
    gyro = samples.gyro
    if noise_rad_s:
        gyro = gyro + noise_rad_s * np.random.default_rng(seed).standard_normal(gyro.shape)

    def series(signal: Signal, values: FloatArray) -> Series:
        return Series(signal, t_ns, t_ns, values if values.ndim == 2 else values[:, None])

    return Telemetry(
        (
            series(Signal.ATTITUDE_SETPOINT, samples.setpoint),
            series(Signal.THRUST_SETPOINT, samples.thrust_setpoint),
            series(Signal.BODY_RATE, np.round(gyro * 1e3) / 1e3),
            series(Signal.SPECIFIC_FORCE, np.round(samples.accel / G * 1e3) * G / 1e3),
            series(Signal.ACTUATOR, samples.duty),
        )
    )


def as_flight(config: PlantConfig, duration_s: float) -> Flight:
    """A flight to learn from."""
    name = f"emulated drone {config.drone} seed {config.seed}"
    digest = hashlib.sha256(repr((config, duration_s)).encode()).hexdigest()
    return Flight(name, digest, "qdrone2", as_telemetry(fly(config, duration_s)))


def as_log(config: PlantConfig, duration_s: float) -> Log:
    """A flight to judge."""
    flight = as_flight(config, duration_s)
    return Log(flight.name, flight.sha256, flight.profile, flight.telemetry, 0)
