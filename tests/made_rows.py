"""What fits need beside rows from plain arrays, and parts of such rows."""

from dataclasses import fields

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.monitors.base import LearnContext
from mavdiag.rows.front import Rows
from mavdiag.testing import WINDOW


def example_context(
    frame: str | None = None, dt_s: float = 0.01, *, mass_kg: float | None = None, hover_rad_s: float | None = None
) -> LearnContext:
    """What fits need beside such rows. frame: name of the rotor layout, if it is known."""
    layout = None if frame is None else layout_named(frame)
    airframe = Airframe(layout=layout, mass_kg=mass_kg, hover_rad_s=hover_rad_s)
    return LearnContext(airframe, None, dt_s, WINDOW)


def rows_between(rows: Rows, first: int, stop: int) -> Rows:
    """Rows [first, stop), with the rates that they complete."""
    rates, lag = rows.rates, len(rows.block) - len(rows.rates)
    kept = slice(max(first - lag, 0), max(stop - lag, 0))
    columns = (getattr(rates, column.name)[kept] for column in fields(rates)[2:])
    return Rows(rows.block.rows(first, stop), type(rates)(rates.segment, rates.dt_s, *columns))
