"""What fits need beside rows from plain arrays."""

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.monitors.base import LearnContext
from mavdiag.testing import WINDOW


def example_context(
    frame: str | None = None, dt_s: float = 0.01, *, mass_kg: float | None = None, hover_rad_s: float | None = None
) -> LearnContext:
    """What fits need beside such rows. frame: name of the rotor layout, if it is known."""
    layout = None if frame is None else layout_named(frame)
    airframe = Airframe(layout=layout, mass_kg=mass_kg, hover_rad_s=hover_rad_s)
    return LearnContext(airframe, None, dt_s, WINDOW)
