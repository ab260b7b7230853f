"""What is changed while a plant flies, as data for the truth file."""

import math
from dataclasses import dataclass
from enum import StrEnum

from mavdiag.errors import UsageError
from sitl_plant.physics.injections import Injection

__all__ = ["Change", "Renewal", "SteadyWind"]


@dataclass(frozen=True, slots=True)
class SteadyWind:
    """A mean wind [m/s]. towards_rad: where it blows to; 0 is north, pi/2 east. Raises UsageError for no number."""

    speed_m_s: float
    towards_rad: float = math.pi / 4

    def __post_init__(self) -> None:
        if not (math.isfinite(self.speed_m_s) and math.isfinite(self.towards_rad)):
            raise UsageError(f"a wind needs finite numbers, not {self.speed_m_s:g} m/s to {self.towards_rad:g} rad")


class Renewal(StrEnum):
    """What is made as new."""

    CLEAR = "clear"  # all causes are gone
    BATTERY = "battery"  # a full battery


@dataclass(frozen=True, slots=True)
class Change:
    """One change, in effect from flight time `t_ns` on; an injection from its own onset on."""

    t_ns: int
    what: Injection | SteadyWind | Renewal
