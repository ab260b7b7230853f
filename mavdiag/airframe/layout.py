"""Where the rotors are and which way they turn: the mixing of roll, pitch and yaw.

A layout is a table of effects: what the thrust of one rotor does to the vehicle, in FRD (roll right, pitch nose up,
yaw nose right are positive). Rotors are numbered from 1 as the vehicle numbers its outputs.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray

COLUMN_TOLERANCE = 1e-3  # of a column's scale: digits that a hand-written file may leave out (our choice)


class Motor(int):
    """The number of a rotor, from 1; of rotors that share an arm that of the first, shown with the others: "1/6".

    >>> f"motor {Motor(1, 6)}", Motor(1, 6) == 1
    ('motor 1/6', True)
    """

    members: tuple[int, ...]

    def __new__(cls, *members: int) -> "Motor":  # noqa: D102 - see the class
        found = super().__new__(cls, members[0])
        found.members = members
        return found

    def __getnewargs__(self) -> tuple[int, ...]:  # type: ignore[override]
        return self.members

    def __str__(self) -> str:
        return "/".join(map(repr, self.members))

    def __format__(self, spec: str) -> str:
        return format(str(self), spec)


@dataclass(frozen=True, slots=True)
class RotorLayout:
    """The (roll, pitch, yaw) effects of each rotor; the squares of each column sum to the number of rotors.

    torque_gain: share of a motor's full output that a full-scale torque command adds; None where that is not known.
    Raises UsageError if it cannot command roll, pitch and yaw independently, or the columns are not so scaled.
    """

    name: str
    signs: tuple[tuple[float, float, float], ...]
    torque_gain: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.mixing.shape[1:] != (3,) or np.linalg.matrix_rank(self.mixing) < 3:
            raise UsageError(f"layout {self.name}: its rotors cannot command roll, pitch and yaw independently")
        if not np.allclose(np.square(self.mixing).sum(axis=0), self.rotors, rtol=COLUMN_TOLERANCE):
            raise UsageError(f"layout {self.name}: the squares of each column must sum to {self.rotors}")

    @property
    def rotors(self) -> int:
        """How many there are."""
        return len(self.signs)

    @property
    def arms(self) -> tuple[Motor, ...]:
        """The rotors of each arm: those with equal effects of roll and pitch, which hardly tell them apart."""
        found = dict[tuple[float, float], list[int]]()
        for rotor, (roll, pitch, _) in enumerate(self.signs, 1):
            found.setdefault((round(roll, 3), round(pitch, 3)), []).append(rotor)
        return tuple(Motor(*members) for members in found.values())

    @property
    def coaxial(self) -> bool:
        """Whether rotors share an arm: the arm is named then, and no rotor."""
        return len(self.arms) < self.rotors

    def alike(self, other: "RotorLayout") -> bool:
        """Whether both have the same rotors in the same order, whatever they are called."""
        return self.rotors == other.rotors and bool(np.allclose(self.mixing, other.mixing, atol=COLUMN_TOLERANCE))

    @property
    def mixing(self) -> FloatArray:
        """B, (rotors, 3): outputs w = B m that make a trim m of roll, pitch and yaw."""
        return np.array(self.signs, dtype=np.float64).reshape(len(self.signs), -1)

    @property
    def unmixing(self) -> FloatArray:
        """C = pinv(B), (3, rotors): trim m = C w; column j is the trim that a unit rise of rotor j makes."""
        return _unmixing(self.signs)


@cache
def _unmixing(signs: tuple[tuple[float, ...], ...]) -> FloatArray:
    found = np.asarray(np.linalg.pinv(np.array(signs, dtype=np.float64).reshape(len(signs), -1)), dtype=np.float64)
    found.flags.writeable = False
    return found


@dataclass(frozen=True, slots=True)
class Place:
    """One rotor in body FRD from the centre of gravity: forward, to the right, sense of rotation seen from above."""

    x_m: float
    y_m: float
    spin: Literal["cw", "ccw"]


def layout_at(name: str, places: Sequence[Place]) -> RotorLayout:
    """The layout of rotors at these places: torque = (x, y, 0) x (0, 0, -1) = (-y, x, 0), yaw against the rotor.

    >>> quad = [Place(1, 1, "ccw"), Place(-1, -1, "ccw"), Place(1, -1, "cw"), Place(-1, 1, "cw")]
    >>> layout_at("x", quad).signs
    ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0), (-1.0, -1.0, -1.0))
    """
    return layout_of_effects(name, [(-one.y_m, one.x_m, 1.0 if one.spin == "ccw" else -1.0) for one in places])


def layout_of_effects(name: str, effects: Sequence[tuple[float, float, float]]) -> RotorLayout:
    """The layout of (roll, pitch, yaw) effects in any scale. Raises UsageError as `RotorLayout` does."""
    B = np.array(effects, dtype=np.float64)
    rms = np.sqrt(np.square(B).mean(axis=0))
    return RotorLayout(name, tuple((r, p, y) for r, p, y in (B / np.where(rms > 0, rms, 1.0)).tolist()))


def ring(name: str, *angles_deg: float, cw: tuple[int, ...], yaw: tuple[float, ...] = ()) -> RotorLayout:
    """The layout of rotors on a circle, by angle from the nose to the right [deg]; cw: those that turn clockwise."""
    effects = [
        (-round(math.sin(math.radians(deg)), 9), round(math.cos(math.radians(deg)), 9), -size if i in cw else size)
        for i, (deg, size) in enumerate(zip(angles_deg, yaw or (1.0,) * len(angles_deg), strict=True), start=1)
    ]
    return layout_of_effects(name, effects)


_KNOWN = (
    # T Eq 2.2-2.4, turned from y left, z up into FRD. 1 rear right, 2 front right, 3 rear left, 4 front left.
    RotorLayout("qdrone2", ((-1, -1, -1), (-1, 1, 1), (1, -1, 1), (1, 1, -1))),
    # Crazyflie 2.1, seen from above: 1 front right, 2 rear right, 3 rear left, 4 front left. Its firmware adds
    # half the roll and pitch commands and the whole yaw command, each of int16, to a thrust of uint16
    # (power_distribution_quadrotor.c, legacy mixing).
    RotorLayout(
        "crazyflie",
        ((-1, 1, 1), (-1, -1, -1), (1, -1, 1), (1, 1, -1)),
        (0.5 * 32767 / 65535, 0.5 * 32767 / 65535, 32767 / 65535),
    ),
    # ArduPilot, AP_MotorsMatrix.cpp, setup_quad_matrix, setup_hexa_matrix, setup_octa_matrix: angle and spin of
    # MOT_1, MOT_2, ... PX4's quad X is the same.
    ring("x", 45, -135, -45, 135, cw=(3, 4)),
    ring("plus", 90, -90, 0, 180, cw=(3, 4)),
    ring("hexa-x", 90, -90, -30, 150, 30, -150, cw=(1, 3, 6)),
    ring("hexa-plus", 0, 180, -120, 60, -60, 120, cw=(1, 3, 6)),
    ring("octo-x", 22.5, -157.5, 67.5, 157.5, -22.5, -112.5, -67.5, 112.5, cw=(1, 2, 7, 8)),
    ring("octo-plus", 0, 180, 45, 135, -45, -135, -90, 90, cw=(1, 2, 7, 8)),
    # setup_octaquad_matrix, setup_y6_matrix (its default, and Y6B), setup_deca_matrix.
    ring("x8", 45, -45, -135, 135, -45, 45, 135, -135, cw=(2, 4, 6, 8)),
    ring("y6", 60, -60, -60, 180, 60, 180, cw=(2, 4, 5)),
    ring("y6b", 60, 60, 180, 180, -60, -60, cw=(1, 3, 5)),
    ring("deca-plus", *range(0, 360, 36), cw=(2, 4, 6, 8, 10)),
    ring("deca-x", *range(18, 360, 36), cw=(2, 4, 6, 8, 10)),
)

#: The layouts known by name.
LAYOUTS = {layout.name: layout for layout in _KNOWN}


def layout_named(name: str) -> RotorLayout:
    """The layout of that name. Raises UsageError, listing the names, if there is none."""
    if name not in LAYOUTS:
        raise UsageError(f"no layout {name!r}: use one of {', '.join(LAYOUTS)}")
    return LAYOUTS[name]
