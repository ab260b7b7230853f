"""An airframe as a value: what is known of a vehicle beside its link and its flights.

It comes from a TOML file (`load_airframe`), from the few that are shipped (`airframe_named`), or from what its flights
show. Nothing is taken over in silence: what is not known is None, and the monitors that need it say so.
"""

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import UsageError
from mavdiag.rows.gate import GateSpec

__all__ = ["Airframe", "Scope"]

Scope: TypeAlias = Literal["airframe", "type"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Airframe:
    """One vehicle, or a type from several of them (T 4.4.1).

    name: what reports call it.
    scope: "airframe" for one vehicle, "type" for several of one make.
    layout: rotor layout; None if it is not known.
    mass_kg: take-off mass; None if it is not known.
    hover_rad_s: rotor speed that carries it [rad/s]; None if it is not known.
    imu_corner_hz: corner of the low-pass filter in its IMU stream; None if the link profile's holds.
    gate: what counts as flying; None if the default of the link or log format holds.
    classifier: name of the trained fault types that hold for it; None if there are none.
    """

    name: str = "unnamed"
    scope: Scope = "airframe"
    layout: RotorLayout | None = None
    mass_kg: float | None = None
    hover_rad_s: float | None = None
    imu_corner_hz: float | None = None
    gate: GateSpec | None = None
    classifier: str | None = None

    def __post_init__(self) -> None:
        for name in ("mass_kg", "hover_rad_s", "imu_corner_hz"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise UsageError(f"airframe: {name} must be a positive number, not {value}")
