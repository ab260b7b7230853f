"""An airframe as a value: what is known of a vehicle beside its link and its flights; None where it is not known."""

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
    """One vehicle, or a type from several of them (T 4.4.1). Raises UsageError if it cannot be."""

    name: str = UNNAMED
    scope: Scope = "airframe"  # of one vehicle, or of several of one make
    layout: RotorLayout | None = None
    outputs: tuple[int, ...] | None = None  # from 1, of rotor 1, 2, ...; None if rotor j is on output j
    layout_basis: str = ""  # where the layout comes from, or why it is not known
    layout_warning: str = ""  # what speaks against the layout
    mass_kg: float | None = None
    hover_rad_s: float | None = None  # rotor speed that carries it
    imu_corner_hz: float | None = None  # of the low-pass in its IMU stream; None if the link profile's holds
    gate: GateSpec | None = None  # what counts as flying; None if the default of the link or log format holds
    classifier: str | None = None  # name of the trained fault types that hold for it

    def __post_init__(self) -> None:
        for name in ("mass_kg", "hover_rad_s", "imu_corner_hz"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise UsageError(f"airframe: {name} must be a positive number, not {value}")
        if not isinstance(self.layout, RotorLayout | None):
            raise UsageError(f"airframe: layout must be a RotorLayout, not {self.layout!r}; only a file names it")
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
