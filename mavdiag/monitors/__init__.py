"""The monitors: one file each, and their registry. A new one is its file and a name in `MONITORS`."""

from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any

from mavdiag.errors import UsageError
from mavdiag.monitors.base import Monitor
from mavdiag.monitors.control_loss import ControlLoss
from mavdiag.monitors.innovation import Innovation
from mavdiag.monitors.rotor_signature import RotorSignature
from mavdiag.monitors.rotor_speed import RotorSpeed
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.monitors.run_length import RunLength
from mavdiag.monitors.sensor_drift import SensorDrift
from mavdiag.monitors.sensor_noise import SensorNoise
from mavdiag.monitors.thrust_loss import ThrustLoss
from mavdiag.monitors.trim_step import TrimStep
from mavdiag.monitors.unbalance import Unbalance
from mavdiag.monitors.vibration_level import VibrationLevel

MONITORS: tuple[type[Monitor[Any]], ...] = (
    RunLength,
    Innovation,
    RotorSignature,
    Unbalance,
    VibrationLevel,
    RotorTrim,
    RotorSpeed,
    TrimStep,
    SensorNoise,
    SensorDrift,
    ControlLoss,
    ThrustLoss,
)

BY_NAME: Mapping[str, type[Monitor[Any]]] = MappingProxyType({monitor.name: monitor for monitor in MONITORS})

NEED_LAYOUT = tuple(monitor.name for monitor in MONITORS if monitor.needs_layout)


def by_name(name: str) -> type[Monitor[Any]]:
    """The monitor of that name. Raises UsageError, listing the names, if there is none."""
    if name not in BY_NAME:
        raise UsageError(f"no monitor {name}; there are {', '.join(BY_NAME)}")
    return BY_NAME[name]


@lru_cache(maxsize=256)
def monitor_of(spec: Any) -> Monitor[Any]:
    """The monitor that works by a fit, ready to start; the same one for the same fit, since it remembers nothing."""
    return BY_NAME[spec.kind](spec)
