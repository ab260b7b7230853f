"""An airframe as a value: what is known of a vehicle beside its link and its flights.

It comes from a TOML file (`airframe.load`) or from what its flights show. What is not known is None, and the monitors
that need it say so.
"""

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import UsageError
from mavdiag.rows.gate import GateSpec

UNNAMED = "unnamed"
Scope: TypeAlias = Literal["airframe", "type"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Airframe:
    """One vehicle, or a type from several of them (T 4.4.1). Raises UsageError if it cannot be.

    name: what reports call it.
    scope: "airframe" for one vehicle, "type" for several of one make.
    outputs: the vehicle's output, from 1, that drives rotor 1, 2, ...; None if rotor j is on output j.
    layout_basis: where the layout comes from; why it is not known, if it is not; empty if nobody has said.
    layout_warning: what speaks against the layout; empty if nothing does.
    hover_rad_s: rotor speed that carries it [rad/s].
    imu_corner_hz: corner of the low-pass filter in its IMU stream; None if the link profile's holds.
    gate: what counts as flying; None if the default of the link or log format holds.
    classifier: name of the trained fault types that hold for it.
    """

    name: str = UNNAMED
    scope: Scope = "airframe"
    layout: RotorLayout | None = None
    outputs: tuple[int, ...] | None = None
    layout_basis: str = ""
    layout_warning: str = ""
    mass_kg: float | None = None
    hover_rad_s: float | None = None
    imu_corner_hz: float | None = None
    gate: GateSpec | None = None
    classifier: str | None = None

    def __post_init__(self) -> None:
        for name in ("mass_kg", "hover_rad_s", "imu_corner_hz"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise UsageError(f"airframe: {name} must be a positive number, not {value}")
        if self.outputs is None:
            return
        if self.layout is not None and len(self.outputs) != self.layout.rotors:
            raise UsageError(f"airframe: {len(self.outputs)} outputs for {self.layout.rotors} rotors")
        if min(self.outputs, default=0) < 1 or len(set(self.outputs)) < len(self.outputs):
            raise UsageError("airframe: outputs count from 1, and each rotor has its own")

    @property
    def layout_statement(self) -> str:
        """The layout, what drives its rotors and where that is known from, or that it is unknown; one line."""
        if self.layout is None:
            return f"rotor layout unknown: {self.layout_basis or 'nothing was found out about it'}"
        on = "" if self.outputs is None else f", its rotors on outputs {', '.join(map(str, self.outputs))}"
        basis = f" ({self.layout_basis})" if self.layout_basis else ""
        warning = f"; WARNING: {self.layout_warning}" if self.layout_warning else ""
        return f"rotor layout {self.layout.name}{on}{basis}{warning}"
