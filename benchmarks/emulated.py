"""Emulated flights as telemetry without the wire, for the benchmarks: same values and rounding as on the wire."""

from mavdiag.telemetry import Log
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.plant import PlantConfig

__all__ = ["as_flight"]


def as_flight(config: PlantConfig, duration_s: float) -> Log:
    """A flight to learn from or to judge."""
    telemetry, _ = flight_telemetry(config, duration_s)
    return Log(f"emulated drone {config.drone} seed {config.seed}", telemetry.digest, "qdrone2", telemetry)
