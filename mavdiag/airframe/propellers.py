"""The thesis's nine damaged propellers: what was done, weighed and printed (T 3.2.2, Tables 3.1-3.3).

The tables do not agree with themselves everywhere. Here the unbalance is computed from the masses and radii of the
sum that T Table 3.2 shows; what is printed stands beside it, and each row names its own slip.
"""

from dataclasses import dataclass
from enum import StrEnum

from mavdiag.airframe.balance import Piece, resultant_unbalance_g_mm
from mavdiag.errors import UsageError

__all__ = [
    "HEALTHY_MASS_G",
    "PROPELLERS",
    "SURFACES",
    "WEIGHING_ERROR_G",
    "Category",
    "DamagedPropeller",
    "DamagedSurface",
    "FaultType",
    "SurfaceClass",
    "UnbalanceClass",
    "category",
    "propeller",
]

HEALTHY_MASS_G = 7.198  # T Table 3.2, two of three; the third weighs 7.197 g
WEIGHING_ERROR_G = 0.0005  # T 3.2.2: half of the last digit of the balance


class FaultType(StrEnum):
    """What was done to the blade (T 3.2.2). The value is T's code."""

    EDGE_CUT = "F1"
    CRACK = "F2"
    SURFACE_UNBALANCE = "F3"


@dataclass(frozen=True, slots=True)
class DamagedPropeller:
    """One row of T Table 3.2.

    severity: 1..3. mass_g: of the damaged propeller. lost_g: "mass difference". pieces: masses and radii in the printed
    sum, all on one blade, so on one line. radii_mm: the "distance" column. printed_g_mm: the printed result.
    slip: what does not agree, empty if all does.
    """

    fault_type: FaultType
    severity: int
    mass_g: float
    lost_g: float
    pieces: tuple[Piece, ...]
    radii_mm: tuple[float, ...]
    printed_g_mm: float
    slip: str = ""

    @property
    def code(self) -> str:
        """T's code, "F1/SV1" to "F3/SV3"."""
        return f"{self.fault_type}/SV{self.severity}"

    @property
    def unbalance_g_mm(self) -> float:
        """The unbalance computed from `pieces` [g mm] (T Eq 3.4)."""
        return resultant_unbalance_g_mm(self.pieces)

    @property
    def uncertainty_g_mm(self) -> float:
        """Largest error of the unbalance that two weighings of +-0.5 mg allow [g mm], at the mean radius."""
        return 2.0 * WEIGHING_ERROR_G * sum(piece.radius_mm for piece in self.pieces) / len(self.pieces)


def _row(
    fault_type: FaultType,
    severity: int,
    mass_g: float,
    lost_mg: float,
    each_mg: float,
    radii_mm: tuple[float, ...],
    printed_g_mm: float,
    slip: str = "",
    distances_mm: tuple[float, ...] = (),
) -> DamagedPropeller:
    pieces = tuple(Piece(each_mg / 1000.0, radius) for radius in radii_mm)
    return DamagedPropeller(
        fault_type, severity, mass_g, lost_mg / 1000.0, pieces, distances_mm or radii_mm, printed_g_mm, slip
    )


_F1, _F2, _F3 = FaultType.EDGE_CUT, FaultType.CRACK, FaultType.SURFACE_UNBALANCE

#: T Table 3.2, in its order.
#                mass g  lost  each mg  radii mm            printed g mm
PROPELLERS: tuple[DamagedPropeller, ...] = (
    _row(_F1, 1, 7.163, 35.0, 35.0, (40.0,), 1.400),
    _row(_F1, 2, 7.113, 85.0, 85.0, (60.0,), 5.100),
    _row(_F1, 3, 7.102, 96.0, 48.0, (65.0, 50.0), 5.520, "distances 65/40 mm, sum with 65/50 mm", (65.0, 40.0)),
    _row(_F2, 1, 7.194, 4.0, 4.0, (55.0,), 0.220),
    _row(_F2, 2, 7.148, 50.0, 25.0, (40.0, 70.0), 2.750),
    _row(_F2, 3, 7.145, 53.0, 18.0, (70.0, 55.0, 40.0), 2.640, "the sum is 2.970 g mm; 2.640 needs 16 mg a crack"),
    _row(_F3, 1, 7.140, 58.0, 58.0, (65.0,), 3.770, "holes of 6 mm here, of 4 mm in SV2 and SV3 (Table 3.1)"),
    _row(_F3, 2, 7.131, 67.0, 34.0, (65.0, 50.0), 3.910, "holes of 4 mm in Table 3.1, of 6 mm in the text"),
    _row(_F3, 3, 7.099, 99.0, 33.0, (65.0, 50.0, 35.0), 4.950, "holes of 4 mm in Table 3.1, of 6 mm in the text"),
)


def propeller(fault_type: FaultType, severity: int) -> DamagedPropeller:
    """The row of a fault. Raises UsageError unless the severity is 1, 2 or 3."""
    for row in PROPELLERS:
        if row.fault_type is fault_type and row.severity == severity:
            return row
    raise UsageError(f"no severity {severity!r}: give 1, 2 or 3")


class SurfaceClass(StrEnum):
    """Size of the damaged surface (T Table 3.3)."""

    SMALL = "small surface"
    MODERATE = "moderate surface"
    LARGE = "large surface"


class UnbalanceClass(StrEnum):
    """Size of the unbalance (T Table 3.3)."""

    LOW = "low unbalance"
    MEDIUM = "medium unbalance"
    HIGH = "high unbalance"


@dataclass(frozen=True, slots=True)
class Category:
    """A cell of T Table 3.3, "Moderate Surface Medium Unbalance" and so on."""

    surface: SurfaceClass
    unbalance: UnbalanceClass


# T gives classes but no limits. These lie midway between the neighbouring rows of T Table 3.3 (our choice), and the
# unbalances of Table 3.2 fall into the same classes.
SURFACE_LIMITS_MM2 = (35.0, 85.0)  # small 10-30, moderate 40-70, large 100-150
UNBALANCE_LIMITS_G_MM = (1.0, 3.5)  # low 0.5, medium 1.5-3.0, high 4.0-6.0


def category(area_mm2: float, unbalance_g_mm: float) -> Category:
    """The category of a damage (T 3.2.2, Table 3.3), by limits that are ours.

    Raises UsageError unless both are zero or more.
    """
    if not (area_mm2 >= 0.0 and unbalance_g_mm >= 0.0):
        raise UsageError(f"area and unbalance must be zero or more, not {area_mm2:g} mm^2 and {unbalance_g_mm:g} g mm")
    surface = sum(area_mm2 > limit for limit in SURFACE_LIMITS_MM2)
    unbalance = sum(unbalance_g_mm > limit for limit in UNBALANCE_LIMITS_G_MM)
    return Category(tuple(SurfaceClass)[surface], tuple(UnbalanceClass)[unbalance])


@dataclass(frozen=True, slots=True)
class DamagedSurface:
    """One row of T Table 3.3. Its unbalances are rounder than, and differ from, those of Table 3.2."""

    fault_type: FaultType
    severity: int
    area_mm2: float
    printed_g_mm: float
    category: Category


def _surface(
    fault_type: FaultType, severity: int, area: float, printed: float, size: SurfaceClass, unbalance: UnbalanceClass
) -> DamagedSurface:
    return DamagedSurface(fault_type, severity, area, printed, Category(size, unbalance))


_S, _U = SurfaceClass, UnbalanceClass

#: T Table 3.3, in its order, with the categories as printed.
SURFACES: tuple[DamagedSurface, ...] = (
    _surface(_F1, 1, 40.0, 1.5, _S.MODERATE, _U.MEDIUM),
    _surface(_F1, 2, 100.0, 5.0, _S.LARGE, _U.HIGH),
    _surface(_F1, 3, 150.0, 6.0, _S.LARGE, _U.HIGH),
    _surface(_F2, 1, 10.0, 0.5, _S.SMALL, _U.LOW),
    _surface(_F2, 2, 20.0, 2.5, _S.SMALL, _U.MEDIUM),
    _surface(_F2, 3, 30.0, 3.0, _S.SMALL, _U.MEDIUM),
    _surface(_F3, 1, 30.0, 4.0, _S.SMALL, _U.HIGH),
    _surface(_F3, 2, 50.0, 5.0, _S.MODERATE, _U.HIGH),
    _surface(_F3, 3, 70.0, 5.5, _S.MODERATE, _U.HIGH),
)
