"""Balance quality of a rotor by ISO 1940-1 (T 3.1.1, 3.2, Eq 3.1-3.6). Raises UsageError on values that cannot be.

    U     = m r                      unbalance of a mass m that is missing or added at radius r     T Eq 3.1
    e_per = G / Omega = 9549 G / n   [um, the same in g mm per kg of rotor]; n in rpm               T Eq 3.3
    U_per = e_per m_rotor            what grade G permits                                           T Eq 3.2
    F     = U Omega^2                force that turns with the rotor                                T 3.1.1

T Eq 3.3 prints 9594 for 9549 = 60 x 1000 / (2 pi), and calls the speed in rpm Omega.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

from mavdiag.errors import UsageError
from mavdiag.units import G_MM_PER_KG_M, RPM

BORDER = 1e-9  # share of a limit that rounding may add without breaking it
FASTEST_RPM = 1e6  # no rotor turns faster: such a number is in another unit (our choice)


class Grade(StrEnum):
    """Balance quality grades of ISO 1940-1:2003, coarse to fine. T 3.2.2 takes G6.3 for the QDrone 2's rotors."""

    G4000 = "G4000"
    G1600 = "G1600"
    G630 = "G630"
    G250 = "G250"
    G100 = "G100"
    G40 = "G40"
    G16 = "G16"
    G6_3 = "G6.3"
    G2_5 = "G2.5"
    G1 = "G1"
    G0_4 = "G0.4"

    @property
    def mm_s(self) -> float:
        """The product of specific unbalance and angular speed that this grade permits [mm/s]."""
        return float(self.value[1:])


def grade_named(text: str) -> Grade:
    """Find the grade of a text such as "G6.3", "g 6.3" or "6.3"."""
    try:
        return Grade("G" + text.strip().upper().removeprefix("G").strip())
    except ValueError:
        raise UsageError(f"no balance grade {text!r}: use one of {', '.join(Grade)}") from None


def unbalance_g_mm(mass_g: float, radius_mm: float) -> float:
    """U = m r [g mm] of one mass (T Eq 3.1)."""
    return _checked("mass", mass_g, "g", zero=True) * _checked("radius", radius_mm, "mm", zero=True)


def permissible_unbalance_g_mm(grade: Grade, speed_rpm: float, rotor_mass_g: float) -> float:
    """U_per = e_per m [g mm] (T Eq 3.2, 3.3). The rotor is all that turns: propeller, adapter and bell."""
    if _checked("speed", speed_rpm, "rpm") > FASTEST_RPM:
        raise UsageError(f"speed must be at most {FASTEST_RPM:.0e} rpm, not {speed_rpm:g}")
    return grade.mm_s / (speed_rpm * RPM) * _checked("rotor mass", rotor_mass_g, "g")


@dataclass(frozen=True, slots=True)
class BalanceReport:
    """U, U_per, e, e_per, e Omega, G; the finest grade that is met (None beyond G4000), U / U_per, U Omega^2."""

    unbalance_g_mm: float
    permissible_g_mm: float
    specific_um: float
    permissible_um: float
    level_mm_s: float
    grade: Grade
    met: Grade | None
    ratio: float
    force_n: float

    @property
    def within(self) -> bool:
        """Whether the grade permits the unbalance."""
        return self.level_mm_s <= self.grade.mm_s * (1.0 + BORDER)

    @property
    def sentence(self) -> str:
        """One line for a person."""
        return (
            f"{self.unbalance_g_mm:.3g} g mm {'within' if self.within else 'exceeds'} {self.grade}: {self.ratio:.2f} x "
            f"the permissible {self.permissible_g_mm:.3g} g mm, "
            f"{f'beyond {Grade.G4000}' if self.met is None else f'meets {self.met}'}"
        )


def assess_unbalance(
    unbalance_g_mm: float, *, rotor_mass_g: float, speed_rpm: float, grade: Grade = Grade.G6_3
) -> BalanceReport:
    """Hold an unbalance [g mm] against a grade.

    >>> assess_unbalance(0.22, rotor_mass_g=30.0, speed_rpm=10_000).sentence        # T Table 3.2, F2/SV1
    '0.22 g mm exceeds G6.3: 1.22 x the permissible 0.18 g mm, meets G16'
    """
    permissible_g_mm = permissible_unbalance_g_mm(grade, speed_rpm, rotor_mass_g)
    speed_rad_s = speed_rpm * RPM
    force_n = _checked("unbalance", unbalance_g_mm, "g mm", zero=True) / G_MM_PER_KG_M * speed_rad_s**2
    specific_um, permissible_um = 1e3 * unbalance_g_mm / rotor_mass_g, 1e3 * grade.mm_s / speed_rad_s
    level = 1e-3 * specific_um * speed_rad_s
    if not math.isfinite(level):
        raise UsageError(f"{unbalance_g_mm:g} g mm on a rotor of {rotor_mass_g:g} g is no rotor: check the units")
    met = min((one for one in Grade if level <= one.mm_s * (1.0 + BORDER)), key=lambda one: one.mm_s, default=None)
    told = (unbalance_g_mm, permissible_g_mm, specific_um, permissible_um, level)
    return BalanceReport(*told, grade, met, level / grade.mm_s, force_n)


def _checked(name: str, value: float, unit: str, *, zero: bool = False) -> float:
    if not (math.isfinite(value) and (value > 0.0 or (zero and value == 0.0))):
        raise UsageError(f"{name} must be {f'0 {unit} or more' if zero else f'above 0 {unit}'}, not {value:g}")
    return value
