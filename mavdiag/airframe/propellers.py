"""The thesis's nine damaged propellers: what was done, weighed and printed (T 3.2.2, Tables 3.1 and 3.2).

The table does not agree with itself everywhere. Here the unbalance is computed from the masses and radii of the sum
that T Table 3.2 shows; what is printed stands beside it, and each row names its own slip. T Table 3.3 prints other
unbalances, by 0.1 to 1.1 g mm; Table 3.2 was weighed and is used.
"""

from dataclasses import dataclass
from enum import StrEnum

from mavdiag.airframe.balance import Piece, resultant_unbalance_g_mm
from mavdiag.errors import UsageError

__all__ = ["PROPELLERS", "DamagedPropeller", "FaultType", "propeller"]


class FaultType(StrEnum):
    """What was done to the blade (T 3.2.2). The value is T's code."""

    EDGE_CUT = "F1"
    CRACK = "F2"
    SURFACE_UNBALANCE = "F3"


@dataclass(frozen=True, slots=True)
class DamagedPropeller:
    """One row of T Table 3.2.

    fault_type: what was done.
    severity: 1 to 3.
    mass_g: of the damaged propeller.
    lost_g: "mass difference".
    pieces: masses and radii of the printed sum, all on one blade, so on one line.
    printed_g_mm: the printed result.
    slip: what does not agree; empty if all does.
    """

    fault_type: FaultType
    severity: int
    mass_g: float
    lost_g: float
    pieces: tuple[Piece, ...]
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


def _row(
    fault_type: FaultType,
    severity: int,
    mass_g: float,
    lost_mg: float,
    each_mg: float,
    radii_mm: tuple[float, ...],
    printed_g_mm: float,
    slip: str = "",
) -> DamagedPropeller:
    pieces = tuple(Piece(each_mg / 1000, radius) for radius in radii_mm)
    return DamagedPropeller(fault_type, severity, mass_g, lost_mg / 1000, pieces, printed_g_mm, slip)


_F1, _F2, _F3 = FaultType.EDGE_CUT, FaultType.CRACK, FaultType.SURFACE_UNBALANCE

#: T Table 3.2, in its order.
#                mass g  lost  each mg  radii mm            printed g mm
PROPELLERS: tuple[DamagedPropeller, ...] = (
    _row(_F1, 1, 7.163, 35.0, 35.0, (40.0,), 1.400),
    _row(_F1, 2, 7.113, 85.0, 85.0, (60.0,), 5.100),
    _row(_F1, 3, 7.102, 96.0, 48.0, (65.0, 50.0), 5.520, "distances 65/40 mm, sum with 65/50 mm"),
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
