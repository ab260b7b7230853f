"""The thesis's nine damaged propellers: what was done, weighed and printed (T 3.2.2, Tables 3.1 and 3.2).

The table contradicts itself in places: here the unbalance is the sum of the masses and radii that it shows, and what is
printed stands beside it. T Table 3.3 prints other unbalances, by 0.1 to 1.1 g mm; Table 3.2 was weighed and is used.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

from mavdiag.airframe.balance import unbalance_g_mm


class FaultType(StrEnum):
    """What was done to the blade (T 3.2.2). The value is T's code."""

    EDGE_CUT = "F1"
    CRACK = "F2"
    SURFACE_UNBALANCE = "F3"


@dataclass(frozen=True, slots=True)
class DamagedPropeller:
    """A row of T Table 3.2: its mass, the "mass difference", the mass at each radius of the printed sum, its result."""

    fault_type: FaultType
    severity: int
    mass_g: float
    lost_g: float
    each_g: float
    radii_mm: tuple[float, ...]
    printed_g_mm: float

    @property
    def code(self) -> str:
        """T's code, "F1/SV1" to "F3/SV3"."""
        return f"{self.fault_type}/SV{self.severity}"

    @property
    def unbalance_g_mm(self) -> float:
        """The unbalance, sum_i m_i r_i [g mm] (T Eq 3.4): all on one blade, so on one line."""
        return math.fsum(unbalance_g_mm(self.each_g, radius_mm) for radius_mm in self.radii_mm)


_F1, _F2, _F3 = FaultType

#: T Table 3.2, in its order.
PROPELLERS: tuple[DamagedPropeller, ...] = (
    DamagedPropeller(_F1, 1, 7.163, 0.035, 0.035, (40.0,), 1.400),
    DamagedPropeller(_F1, 2, 7.113, 0.085, 0.085, (60.0,), 5.100),
    DamagedPropeller(_F1, 3, 7.102, 0.096, 0.048, (65.0, 50.0), 5.520),  # distances 65/40 mm, sum with 65/50 mm
    DamagedPropeller(_F2, 1, 7.194, 0.004, 0.004, (55.0,), 0.220),
    DamagedPropeller(_F2, 2, 7.148, 0.050, 0.025, (40.0, 70.0), 2.750),
    DamagedPropeller(_F2, 3, 7.145, 0.053, 0.018, (70.0, 55.0, 40.0), 2.640),  # the sum is 2.970: 2.640 needs 16 mg
    DamagedPropeller(_F3, 1, 7.140, 0.058, 0.058, (65.0,), 3.770),  # holes of 6 mm here, of 4 mm in Table 3.1
    DamagedPropeller(_F3, 2, 7.131, 0.067, 0.034, (65.0, 50.0), 3.910),  # holes of 4 mm in Table 3.1, of 6 in the text
    DamagedPropeller(_F3, 3, 7.099, 0.099, 0.033, (65.0, 50.0, 35.0), 4.950),  # likewise
)
