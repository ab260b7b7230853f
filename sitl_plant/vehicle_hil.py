"""What a vehicle file says for an autopilot outside: the table `[hil]`."""

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from sitl_plant.fields import STRICT, Positive

__all__ = ["Hil", "Pilot"]


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Pilot:
    """How one kind of autopilot flies the vehicle.

    rotors: which rotor, counted from 1 as in the file, turns at the autopilot's motor output 1, 2, and so on.
    parameters: suggested for it, by their names; whole numbers are integer parameters.
    """

    rotors: tuple[Annotated[int, Field(ge=1)], ...]
    parameters: Mapping[str, int | float] = field(default_factory=dict, hash=False)


@dataclass(frozen=True, slots=True, config={"extra": STRICT})
class Hil:
    """Outputs of autopilots. pwm_us: the pulses of duty 0 and 1, linear between them."""

    pwm_us: tuple[Positive, Positive]
    ardupilot: Pilot
    px4: Pilot
