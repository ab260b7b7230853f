"""Balance quality of a rotor by ISO 1940-1 (T 3.1.1, 3.2, Eq 3.1-3.6). The thesis's propellers are in `propellers`.

    U     = m r                        unbalance of a mass m that is missing or added at radius r     T Eq 3.1
    U_res = |sum m_i r_i e(angle_i)|   of several; T adds on one line, all angles 0                   T Eq 3.4
    e_per = G / Omega = 9549 G / n     [um], the same number in g mm per kg of rotor; n in rpm        T Eq 3.3
    U_per = e_per m_rotor              what grade G permits                                           T Eq 3.2
    F     = U Omega^2                  force that turns with the rotor                                T 3.1.1

T Eq 3.3 prints 9594 and calls the speed Omega: 9549 = 60 x 1000 / (2 pi) belongs there, with the speed in rpm. Only
so does it agree with T Eq 3.2 and with its result of 6 um.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from mavdiag.errors import UsageError
from mavdiag.units import G_MM_PER_KG_M, RPM

__all__ = [
    "BalanceReport",
    "Grade",
    "Piece",
    "assess_unbalance",
    "grade_met",
    "grade_named",
    "permissible_specific_um",
    "permissible_unbalance_g_mm",
    "resultant_unbalance_g_mm",
    "unbalance_force_n",
    "unbalance_g_mm",
]

BORDER = 1e-9  # share of a limit that rounding may add without breaking it
FASTEST_RPM = 1e6  # no rotor turns faster: such a number is in another unit (our choice)


class Grade(StrEnum):
    """Balance quality grades of ISO 1940-1:2003, coarse to fine. The number is e Omega, in mm/s.

    T 3.2.2 takes G6.3 for the QDrone 2's rotors.
    """

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
    """The grade of a text such as "G6.3", "g 6.3" or "6.3". Raises UsageError, with the grades there are.

    >>> grade_named("6.3")
    <Grade.G6_3: 'G6.3'>
    """
    wanted = "G" + text.strip().upper().removeprefix("G").strip()
    for grade in Grade:
        if grade.value == wanted:
            return grade
    raise UsageError(f"no balance grade {text!r}: use one of {', '.join(Grade)}")


@dataclass(frozen=True, slots=True)
class Piece:
    """A mass that is missing from a rotor, or added to it.

    mass_g: without sign.
    radius_mm: its distance from the axis.
    angle_deg: its direction in the rotor plane.
    Raises UsageError unless mass and radius are finite and not negative and the angle is finite.
    """

    mass_g: float
    radius_mm: float
    angle_deg: float = 0.0

    def __post_init__(self) -> None:
        _not_negative("mass", self.mass_g, "g")
        _not_negative("radius", self.radius_mm, "mm")
        if not math.isfinite(self.angle_deg):
            raise UsageError(f"angle must be a number of degrees, not {self.angle_deg}")

    @property
    def unbalance_g_mm(self) -> float:
        """m r of this piece alone [g mm] (T Eq 3.1)."""
        return self.mass_g * self.radius_mm


def unbalance_g_mm(mass_g: float, radius_mm: float) -> float:
    """Unbalance [g mm] of one mass at one radius (T Eq 3.1). Raises UsageError on negative or infinite values."""
    return Piece(mass_g, radius_mm).unbalance_g_mm


def resultant_unbalance_g_mm(pieces: Iterable[Piece]) -> float:
    """Length of the sum of the unbalance vectors [g mm]; with all angles alike it is T Eq 3.4.

    >>> resultant_unbalance_g_mm([Piece(0.034, 65.0), Piece(0.034, 50.0)])          # T Table 3.2, F3/SV2
    3.91
    >>> round(resultant_unbalance_g_mm([Piece(0.034, 65.0), Piece(0.034, 65.0, 180.0)]), 9)
    0.0
    """
    parts = [(piece.unbalance_g_mm, math.radians(piece.angle_deg)) for piece in pieces]
    along = math.fsum(size * math.cos(angle) for size, angle in parts)
    across = math.fsum(size * math.sin(angle) for size, angle in parts)
    return math.hypot(along, across)


def permissible_specific_um(grade: Grade, speed_rpm: float) -> float:
    """e_per = 9549 G / n [um, or g mm/kg] (T Eq 3.3 with its slip removed).

    Raises UsageError unless the speed is positive.
    """
    return 1e3 * grade.mm_s / _angular_speed(speed_rpm)


def permissible_unbalance_g_mm(grade: Grade, speed_rpm: float, rotor_mass_g: float) -> float:
    """U_per = e_per m [g mm] (T Eq 3.2). The rotor is all that turns: propeller, adapter and bell.

    >>> round(permissible_unbalance_g_mm(Grade.G6_3, 10_000, 30.0), 3)              # T Eq 3.6
    0.18

    Raises UsageError unless speed and mass are positive.
    """
    _positive("rotor mass", rotor_mass_g, "g")
    return permissible_specific_um(grade, speed_rpm) * rotor_mass_g * 1e-3  # g mm/kg x kg


def unbalance_force_n(unbalance_g_mm: float, speed_rpm: float) -> float:
    """U Omega^2 [N], the force that turns with the rotor (T 3.1.1). Raises UsageError on nonsense.

    >>> round(unbalance_force_n(5.1, 10_000), 2)                                    # T Table 3.2, F1/SV2
    5.59
    """
    _not_negative("unbalance", unbalance_g_mm, "g mm")
    omega = _angular_speed(speed_rpm)
    return unbalance_g_mm / G_MM_PER_KG_M * omega * omega


def grade_met(unbalance_g_mm: float, *, rotor_mass_g: float, speed_rpm: float) -> Grade | None:
    """The finest grade that an unbalance satisfies; None if it is beyond even G4000. Raises UsageError on nonsense."""
    level = _level_mm_s(unbalance_g_mm, rotor_mass_g, speed_rpm)
    met = [grade for grade in Grade if _within(level, grade)]
    return min(met, key=lambda grade: grade.mm_s, default=None)


@dataclass(frozen=True, slots=True)
class BalanceReport:
    """An unbalance held against a grade.

    unbalance_g_mm: U.
    permissible_g_mm: U_per.
    specific_um: e, U over the rotor's mass.
    permissible_um: e_per.
    level_mm_s: e Omega, to be compared with the number of a grade.
    grade: the one asked for.
    met: the finest one satisfied; None beyond G4000.
    ratio: U / U_per.
    force_n: U Omega^2.
    """

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
        """Whether the unbalance is permitted by the grade."""
        return _within(self.level_mm_s, self.grade)

    @property
    def sentence(self) -> str:
        """One line for a person."""
        verdict = "within" if self.within else "exceeds"
        met = f"meets {self.met}" if self.met is not None else f"beyond {Grade.G4000}"
        return (
            f"{self.unbalance_g_mm:.3g} g mm {verdict} {self.grade}: {self.ratio:.2f} x the permissible "
            f"{self.permissible_g_mm:.3g} g mm, {met}"
        )


def assess_unbalance(
    unbalance_g_mm: float, *, rotor_mass_g: float, speed_rpm: float, grade: Grade = Grade.G6_3
) -> BalanceReport:
    """Hold an unbalance against a grade, whether it was weighed (`unbalance_g_mm`) or estimated from vibration.

    >>> report = assess_unbalance(0.22, rotor_mass_g=30.0, speed_rpm=10_000)        # T Table 3.2, F2/SV1
    >>> report.sentence
    '0.22 g mm exceeds G6.3: 1.22 x the permissible 0.18 g mm, meets G16'

    Raises UsageError unless the unbalance is zero or more and mass and speed are positive.
    """
    level = _level_mm_s(unbalance_g_mm, rotor_mass_g, speed_rpm)
    return BalanceReport(
        unbalance_g_mm=unbalance_g_mm,
        permissible_g_mm=permissible_unbalance_g_mm(grade, speed_rpm, rotor_mass_g),
        specific_um=1e3 * unbalance_g_mm / rotor_mass_g,
        permissible_um=permissible_specific_um(grade, speed_rpm),
        level_mm_s=level,
        grade=grade,
        met=grade_met(unbalance_g_mm, rotor_mass_g=rotor_mass_g, speed_rpm=speed_rpm),
        ratio=level / grade.mm_s,
        force_n=unbalance_force_n(unbalance_g_mm, speed_rpm),
    )


def _level_mm_s(unbalance_g_mm: float, rotor_mass_g: float, speed_rpm: float) -> float:
    """e Omega [mm/s]; g mm over g is mm."""
    _not_negative("unbalance", unbalance_g_mm, "g mm")
    _positive("rotor mass", rotor_mass_g, "g")
    level = unbalance_g_mm / rotor_mass_g * _angular_speed(speed_rpm)
    if not math.isfinite(level):
        raise UsageError(f"{unbalance_g_mm:g} g mm on a rotor of {rotor_mass_g:g} g is no rotor: check the units")
    return level


def _within(level_mm_s: float, grade: Grade) -> bool:
    return level_mm_s <= grade.mm_s * (1.0 + BORDER)


def _angular_speed(speed_rpm: float) -> float:
    _positive("speed", speed_rpm, "rpm")
    if speed_rpm > FASTEST_RPM:
        raise UsageError(f"speed must be at most {FASTEST_RPM:.0e} rpm, not {speed_rpm:g}")
    return speed_rpm * RPM


def _positive(name: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise UsageError(f"{name} must be above 0 {unit}, not {value:g}")


def _not_negative(name: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value >= 0.0):
        raise UsageError(f"{name} must be 0 {unit} or more, not {value:g}")
