"""What T's nine damaged propellers do in flight, by code ("F2/SV2"): a table beside that of T 3.2.2.

Physics, from T or estimated from it: thrust loss and drag increase. The unbalance is what T Table 3.2 *prints*; what
does not agree in T's tables is listed in `mavdiag.airframe.propellers`.

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

from mavdiag.airframe.propellers import PROPELLERS, DamagedPropeller
from mavdiag.errors import UsageError
from sitl_plant.physics.injections import RotorDamage

__all__ = ["FAULTS", "Fault", "parse_fault"]


@dataclass(frozen=True, slots=True)
class Fault:
    """One damaged propeller and what it does.

    propeller: what was done to it, weighed and printed.
    thrust_loss: share of the thrust.
    drag_factor: of the drag torque.
    fluctuation_rms: share of the thrust; fitted.
    fluctuation_corner_hz: fitted.
    lag_s: of the thrust; fitted.
    """

    propeller: DamagedPropeller
    thrust_loss: float
    drag_factor: float
    fluctuation_rms: float
    fluctuation_corner_hz: float
    lag_s: float

    @property
    def code(self) -> str:
        """The code of T, "F1/SV1" to "F3/SV3"."""
        return self.propeller.code

    @property
    def unbalance_g_mm(self) -> float:
        """As T prints it."""
        return self.propeller.printed_g_mm

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


# thrust loss %, drag factor | fitted: rms %, corner Hz, lag ms
_TABLE = (
    (0.8, 1.010, 2.0, 6.0, 0.0),
    (4.3, 1.040, 2.1, 6.0, 0.0),
    (5.8, 1.060, 2.2, 6.0, 0.0),
    (0.4, 1.010, 6.0, 1.0, 4.0),
    (0.8, 1.020, 6.2, 1.0, 8.0),
    (1.2, 1.030, 6.4, 1.0, 12.0),
    (0.7, 1.010, 2.4, 1.0, 0.0),
    (1.1, 1.015, 3.8, 1.0, 0.0),
    (1.5, 1.020, 5.6, 1.0, 0.0),
)

FAULTS: tuple[Fault, ...] = tuple(
    Fault(propeller, loss / 100, drag, rms / 100, corner_hz, lag_ms / 1000)
    for propeller, (loss, drag, rms, corner_hz, lag_ms) in zip(PROPELLERS, _TABLE, strict=True)
)
"""The nine faults in T's order."""


def parse_fault(code: str) -> Fault:
    """The fault of a code such as "F2/SV2"; "f2-sv2" and T's "F2\\SV2" are understood. Raises UsageError otherwise."""
    match = re.fullmatch(r"F([123])\s*[/\\_-]?\s*SV([123])", code.strip(), re.IGNORECASE)
    if match is None:
        raise UsageError(f"no fault {code!r}: give F1, F2 or F3 with SV1, SV2 or SV3, as in F2/SV2")
    kind, severity = int(match[1]), int(match[2])
    return FAULTS[3 * (kind - 1) + severity - 1]
