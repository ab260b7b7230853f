"""Where the vehicle is and how its battery does, as messages for ground stations.

The emulated vehicle flies by motion capture; what it knows of its place is told as an autopilot with a GPS tells it.
"""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from mavdiag.link.messages import MessageId
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.units import NS_PER_MS, NS_PER_US
from sitl_plant.autopilot.geo import HOME_ALT_M, HOME_LAT_DEG, HOME_LON_DEG, to_global
from sitl_plant.autopilot.imu_filters import FilteredSamples

CAPACITY_AH = 3.7  # of the QDrone 2's battery: 4S, 3700 mAh (Quanser, QDrone 2 data sheet)
CELLS = 4
FIX_3D, SATELLITES = 3, 12  # GPS_RAW_INT: what ground stations ask for before they call a vehicle ready
EPH_CM = 100
_HOME = (round(HOME_LAT_DEG * 1e7), round(HOME_LON_DEG * 1e7), round(HOME_ALT_M * 1e3))

Columns: TypeAlias = Mapping[str, Any]


def integers(values: FloatArray, bits: int) -> IntArray:
    """Rounded and held in a signed field of so many bits."""
    top = (1 << bits - 1) - 1
    return np.clip(np.rint(values), -top - 1, top).astype(np.int64)


def remaining(filtered: FilteredSamples, rows: IntArray) -> IntArray:
    """What is left of the battery's charge [%]."""
    return integers(100.0 * np.clip(1.0 - filtered.samples.charge_ah[rows] / CAPACITY_AH, 0.0, 1.0), 8)


def _degrees(filtered: FilteredSamples, rows: IntArray) -> tuple[IntArray, IntArray]:
    """(n, 2) latitude and longitude [1e-7 deg], (n,) altitude above the sea [mm]."""
    where = to_global(filtered.samples.position[rows])
    return integers(where[:, :2] * 1e7, 32), integers(where[:, 2] * 1e3, 32)


def _heading(filtered: FilteredSamples, rows: IntArray) -> FloatArray:
    return np.asarray(np.degrees(filtered.samples.attitude[rows, 2]) % 360.0)


def _global_position(filtered: FilteredSamples, rows: IntArray) -> Columns:
    place, above_sea_mm = _degrees(filtered, rows)
    return {
        "time_boot_ms": filtered.stamp_ns[rows] // NS_PER_MS % (1 << 32),
        "lat": place,
        "alt": above_sea_mm,
        "relative_alt": above_sea_mm - _HOME[2],
        "vx": integers(100.0 * filtered.samples.velocity[rows], 16),
        "hdg": integers(100.0 * _heading(filtered, rows), 17) % 36_000,
    }


def _gps(filtered: FilteredSamples, rows: IntArray) -> Columns:
    place, above_sea_mm = _degrees(filtered, rows)
    velocity = filtered.samples.velocity[rows]
    course = np.degrees(np.arctan2(velocity[:, 1], velocity[:, 0])) % 360.0
    return {
        "time_usec": filtered.stamp_ns[rows] // NS_PER_US,
        "fix_type": FIX_3D,
        "lat": place,
        "alt": above_sea_mm,
        "eph": EPH_CM,
        "epv": EPH_CM,
        "vel": integers(100.0 * np.hypot(velocity[:, 0], velocity[:, 1]), 17),
        "cog": integers(100.0 * course, 17) % 36_000,
        "satellites_visible": SATELLITES,
    }


def _hud(filtered: FilteredSamples, rows: IntArray) -> Columns:
    samples = filtered.samples
    speed = np.hypot(samples.velocity[rows, 0], samples.velocity[rows, 1])
    return {
        "airspeed": speed,
        "groundspeed": speed,
        "heading": integers(_heading(filtered, rows), 16) % 360,
        "throttle": integers(100.0 * np.nan_to_num(samples.thrust_setpoint[rows]), 17),
        "alt": to_global(samples.position[rows])[:, 2],
        "climb": -samples.velocity[rows, 2],
    }


def _home(filtered: FilteredSamples, rows: IntArray) -> Columns:
    latitude, longitude, altitude = _HOME
    return {
        "time_usec": filtered.stamp_ns[rows] // NS_PER_US,
        "latitude": latitude,
        "longitude": longitude,
        "altitude": altitude,
        "q": np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (len(rows), 1)),
    }


def _origin(filtered: FilteredSamples, rows: IntArray) -> Columns:
    return {name: column for name, column in _home(filtered, rows).items() if name != "q"}


def _battery(filtered: FilteredSamples, rows: IntArray) -> Columns:
    cell = integers(1e3 * filtered.samples.battery_v[rows] / CELLS, 17)
    voltages = np.full((len(rows), 10), 0xFFFF)
    voltages[:, :CELLS] = cell[:, None]
    return {
        "battery_function": 1,  # MAV_BATTERY_FUNCTION_ALL
        "type": 1,  # MAV_BATTERY_TYPE_LIPO
        "temperature": 0x7FFF,  # not measured, as the current
        "voltages": voltages,
        "current_battery": -1,
        "current_consumed": integers(1e3 * filtered.samples.charge_ah[rows], 32),
        "energy_consumed": -1,
        "battery_remaining": remaining(filtered, rows),
    }


POSITIONS: Mapping[int, Callable[[FilteredSamples, IntArray], Columns]] = {
    MessageId.GLOBAL_POSITION_INT: _global_position,
    MessageId.GPS_RAW_INT: _gps,
    MessageId.VFR_HUD: _hud,
    MessageId.HOME_POSITION: _home,
    MessageId.GPS_GLOBAL_ORIGIN: _origin,
    MessageId.BATTERY_STATUS: _battery,
}
"""How each of these messages is filled; the columns are those of `stream.records`."""
