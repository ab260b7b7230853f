"""Emulated flights as telemetry without the wire, for the benchmarks: same values and rounding as on the wire."""

from mavdiag.learning import Flight
from mavdiag.logs import Log
from sitl_plant.autopilot.telemetry import flight_telemetry, telemetry_digest
from sitl_plant.plant import PlantConfig

__all__ = ["as_flight", "as_log"]


def as_flight(config: PlantConfig, duration_s: float) -> Flight:
    """A flight to learn from."""
    telemetry, _ = flight_telemetry(config, duration_s)
    return Flight(
        f"emulated drone {config.drone} seed {config.seed}", telemetry_digest(telemetry), "qdrone2", telemetry
    )


def as_log(config: PlantConfig, duration_s: float) -> Log:
    """A flight to judge."""
    flight = as_flight(config, duration_s)
    return Log(flight.name, flight.sha256, flight.profile, flight.telemetry, 0)
