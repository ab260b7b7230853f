"""The nine propeller faults of T Tables 3.1-3.3, by code ("F2/SV2").

Physics, from T or estimated from it: thrust loss, drag increase, unbalance and its radius. Unbalance is what T Table
3.2 *prints*; three slips in T's tables are kept as printed and listed here:

    F1/SV3   the distance column says 65/40 mm, the sum uses 65 and 50 mm
    F2/SV3   the printed sum gives 2.970 g mm, the printed result is 2.640 g mm
    F3       holes are 6 mm wide in the text and in SV1 of Table 3.1, 4 mm in SV2 and SV3

Phenomenology, **fitted, not derived**: T's own flights show residuals far above what the physics alone gives, since the
line at one per revolution hardly passes the 0.1 s smoothing window. A damaged propeller is therefore also given a slow
random fluctuation of its thrust (Ornstein-Uhlenbeck, rms and corner below) and, for cracks, a lag of its thrust. These
three columns were fitted so that T Fig 5.9, 5.10 and Table 5.2 come out: F1 short with a low margin, F2 long with a
high one, F3 long with a margin that grows with severity. (For F3 a first fit had an rms of 3.0, 3.8, 5.0 %; the margin
then grew, on means of four flights, in 18 of 20 trials; with 2.4, 3.8, 5.6 % it grew in 23 of 24.) `phenomenology`
scales rms and lag; with 0 only the physics is left. Report results for 0, 0.5 and 1.
"""

import re
from dataclasses import dataclass
from enum import StrEnum

from mavdiag.errors import UsageError
from sitl_plant.physics.injections import RotorDamage

__all__ = ["FAULTS", "Fault", "FaultType", "parse_fault"]


class FaultType(StrEnum):
    """What was done to the blade (T 3.2.2)."""

    EDGE_CUT = "F1"
    CRACK = "F2"
    SURFACE_UNBALANCE = "F3"


@dataclass(frozen=True, slots=True)
class Fault:
    """One row of the fault table. fluctuation_* and lag_s are fitted, see the module's text."""

    type: FaultType
    severity: int
    thrust_loss: float
    drag_factor: float
    unbalance_g_mm: float
    radius_mm: float
    fluctuation_rms: float
    fluctuation_corner_hz: float
    lag_s: float

    @property
    def code(self) -> str:
        """The code of T, "F1/SV1" to "F3/SV3"."""
        return f"{self.type}/SV{self.severity}"

    def damage(self, phenomenology: float = 1.0) -> RotorDamage:
        """What the fault does to a rotor. phenomenology: 0 (physics only) to 1. Raises UsageError outside."""
        if not 0.0 <= phenomenology <= 1.0:
            raise UsageError(f"phenomenology must be 0 to 1, not {phenomenology:g}")
        return RotorDamage(
            thrust_factor=1.0 - self.thrust_loss,
            drag_factor=self.drag_factor,
            unbalance_g_mm=self.unbalance_g_mm,
            fluctuation_rms=phenomenology * self.fluctuation_rms,
            fluctuation_corner_hz=self.fluctuation_corner_hz,
            thrust_lag_s=phenomenology * self.lag_s,
        )


def _row(
    code: FaultType,
    severity: int,
    loss_percent: float,
    drag: float,
    unbalance: float,
    radius: float,
    rms_percent: float,
    corner: float,
    lag_ms: float,
) -> Fault:
    return Fault(code, severity, loss_percent / 100, drag, unbalance, radius, rms_percent / 100, corner, lag_ms / 1000)


_F1, _F2, _F3 = FaultType.EDGE_CUT, FaultType.CRACK, FaultType.SURFACE_UNBALANCE

#                 loss %  drag   U g mm  r mm | fitted: rms %, corner Hz, lag ms
_TABLE = (
    _row(_F1, 1, 0.8, 1.010, 1.40, 40.0, 2.0, 6.0, 0.0),
    _row(_F1, 2, 4.3, 1.040, 5.10, 60.0, 2.1, 6.0, 0.0),
    _row(_F1, 3, 5.8, 1.060, 5.52, 57.0, 2.2, 6.0, 0.0),
    _row(_F2, 1, 0.4, 1.010, 0.22, 55.0, 6.0, 1.0, 4.0),
    _row(_F2, 2, 0.8, 1.020, 2.75, 55.0, 6.2, 1.0, 8.0),
    _row(_F2, 3, 1.2, 1.030, 2.64, 55.0, 6.4, 1.0, 12.0),
    _row(_F3, 1, 0.7, 1.010, 3.77, 65.0, 2.4, 1.0, 0.0),
    _row(_F3, 2, 1.1, 1.015, 3.91, 57.0, 3.8, 1.0, 0.0),
    _row(_F3, 3, 1.5, 1.020, 4.95, 50.0, 5.6, 1.0, 0.0),
)

FAULTS: tuple[Fault, ...] = _TABLE
"""The nine faults in T's order."""


def parse_fault(code: str) -> Fault:
    """The fault of a code such as "F2/SV2"; "f2-sv2" and T's "F2\\SV2" are understood. Raises UsageError otherwise."""
    match = re.fullmatch(r"F([123])\s*[/\\_-]?\s*SV([123])", code.strip(), re.IGNORECASE)
    if match is None:
        raise UsageError(f"no fault {code!r}: give F1, F2 or F3 with SV1, SV2 or SV3, as in F2/SV2")
    kind, severity = int(match[1]), int(match[2])
    return FAULTS[3 * (kind - 1) + severity - 1]
