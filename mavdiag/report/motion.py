"""Where the vehicle was and how it lay, as the log has it: T Fig 5.3 and 5.4."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.report.style import COMMANDED, MEASURED, Picture, drawn, legend_above, panels
from mavdiag.report.thinned import COLUMNS, envelope
from mavdiag.telemetry import FloatArray, Series, Signal, Telemetry
from mavdiag.units import DEG

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["attitude_picture", "height_picture"]

HEIGHT = Picture(
    "height",
    "Height above the take-off",
    "The height tells the climb, the flight and the landing apart; the path over ground of the thesis's figure is "
    "not drawn, because this tool reads no horizontal position from any log.",
    "5.3",
)
ATTITUDE = Picture(
    "attitude",
    "Commanded and estimated attitude",
    "The estimated angles (solid) follow the commanded ones (dotted) within a fraction of a second; a vehicle that "
    "cannot follow has a problem that no propeller need explain.",
    "5.4",
)


def height_picture(telemetry: Telemetry, columns: int = COLUMNS) -> Picture:
    """Height over time."""
    height = telemetry.get(Signal.HEIGHT)
    if height is None or not np.isfinite(height.values).any():
        return replace(HEIGHT, not_drawn="the log carries no height, and this tool reads no horizontal position")

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        MEASURED.draw(axes, *_line(height, 0, 1.0, columns))
        axes.set(xlabel="vehicle time [s]", ylabel="height [m]")

    lowest, highest = np.nanmin(height.values), np.nanmax(height.values)
    return replace(HEIGHT, svg=drawn(HEIGHT.title, f"From {lowest:.1f} to {highest:.1f} m.", plot, 1.9))


def attitude_picture(telemetry: Telemetry, columns: int = COLUMNS) -> Picture:
    """Roll and pitch over time, commanded and estimated, as far as the log carries them."""
    wanted = ((Signal.ATTITUDE_SETPOINT, COMMANDED, "commanded"), (Signal.ATTITUDE, MEASURED, "estimated"))
    there = [(telemetry.get(signal), line, name) for signal, line, name in wanted]
    shown = [(one, line, name) for one, line, name in there if one is not None and len(one) > 1]
    if not shown:
        return replace(ATTITUDE, not_drawn="the log carries neither the commanded nor the estimated attitude")

    def plot(figure: "Figure") -> None:
        axes: Axes
        for column, (axes, angle) in enumerate(zip(panels(figure, 2), ("roll", "pitch"), strict=True)):
            for series, line, name in reversed(shown):
                line.draw(axes, *_line(series, column, 1 / DEG, columns), name)
            axes.set_ylabel(f"{angle} [°]")
        legend_above(figure.axes[0])
        figure.axes[-1].set_xlabel("vehicle time [s]")

    words = "; ".join(
        f"{name}: roll within {_most(series, 0):.0f}°, pitch within {_most(series, 1):.0f}°"
        for series, _, name in shown
    )
    lacking = "" if len(shown) == 2 else f" This log carries the {shown[0][2]} angles only."
    return replace(ATTITUDE, caption=ATTITUDE.caption + lacking, svg=drawn(ATTITUDE.title, f"{words}.", plot, 3.2))


def _line(series: Series, column: int, factor: float, columns: int) -> tuple[FloatArray, FloatArray]:
    """One column in order of time, for a picture."""
    order = np.argsort(series.t_ns, kind="stable")
    return envelope(series.t_s[order], factor * series.values[order, column], columns)


def _most(series: Series, column: int) -> float:
    values = series.values[:, column]
    return float(np.abs(values[np.isfinite(values)] / DEG).max(initial=0.0))
