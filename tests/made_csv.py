"""CSV recordings of emulated flights that hold gyro and accelerometer alone, as UdeSA's and TII's do."""

from pathlib import Path

import numpy as np

from mavdiag.telemetry import Signal
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.plant import PlantConfig

#: Times in us, gyro in deg/s and accelerometer in g, both in a frame with y to the left and z up.
MAP = """
[time]
column = "t_us"
unit = "us"

[body_rate]
columns = ["gyro_x", "-gyro_y", "-gyro_z"]
unit = "deg/s"

[specific_force]
columns = ["acc_x", "-acc_y", "-acc_z"]
unit = "g"
"""
HEADER = "t_us,gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z,remark"
SIGNS = np.array([1.0, -1.0, -1.0])


def recording(path: Path, seed: int, seconds: float = 10.0, **config: object) -> Path:
    """Write a flight of the emulated QDrone 2 at 1 kHz. config: of the plant."""
    plant = PlantConfig(seed=seed, **config)  # type: ignore[arg-type]  # of several types
    telemetry, _ = flight_telemetry(plant, seconds, LinkSpec("qdrone2"))
    gyro, force = telemetry.need(Signal.BODY_RATE), telemetry.need(Signal.SPECIFIC_FORCE)
    columns = np.column_stack([gyro.t_ns / 1e3, np.degrees(gyro.values) * SIGNS, force.values / 9.80665 * SIGNS])
    lines = [",".join(f"{cell:.6f}" for cell in row) + ",a b" for row in columns]
    path.write_text("\n".join([HEADER, *lines]) + "\n")
    return path
