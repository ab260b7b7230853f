"""What each rotor is commanded beside the others, over the flight and on a drawing of the airframe.

    m: trim averaged over 5 s,    mu: the healthy one,    w = B (m - mu) / b

b: the mean of the diagonal of B B^+. So w_j is the rise of rotor j, beyond what it was in health, if it alone rose
[fraction of hover]: the scale of the rotor-trim monitor and of its threshold (`mavdiag.airframe.trim`). The others fall
by a third of it then.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import shown_trim
from mavdiag.drawing import Colour, RotorMark, airframe_svg
from mavdiag.monitors.rotor_trim import RotorTrimSpec
from mavdiag.report.style import LIMIT, LINES, Picture, drawn, legend_above
from mavdiag.report.thinned import COLUMNS, envelope
from mavdiag.rows.block import Block
from mavdiag.rows.windows import sliding_mean, start_mean, window_rows
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["RotorShift", "airframe_picture", "bars_picture", "shift_of", "trim_picture"]

WINDOW_S = 5.0  # of the means, as the monitor has it
NO_LAYOUT = "the rotor layout is not known; name it with --layout or --airframe when the baseline is learnt"
NO_TRIM = "no 5 s of flight without a break carry the motors' outputs, or torque commands whose mixing is known"
TRIM = Picture(
    "trim",
    "What each rotor is commanded beside the others",
    "A rotor that gives less thrust than the others is commanded more: its line rises, and what stays within the "
    "dashed lines is what wind, propellers and sessions do to a healthy vehicle; means of 5 s.",
)
BARS = Picture(
    "trim-bars",
    "What each rotor is commanded, by rotor",
    "A bar that reaches the upper dashed line is a rotor that works harder than it did in health; bars within the "
    "lines say nothing.",
)
AIRFRAME = Picture(
    "airframe",
    "The airframe from above",
    "The nose points up, the arrows show the sense of rotation, and the figure in each rotor is by how much it is "
    "commanded more (+) or less (-) than the mean of all.",
)


@dataclass(frozen=True, slots=True, eq=False)
class RotorShift:
    """layout: whose rotors. t_s: (n,) vehicle time [s]. shift: (n, rotors) w [fraction of hover], nan where unknown.

    beyond_health: whether the healthy trim was taken off.
    limit: the rotor-trim monitor's threshold [fraction of hover]; None without one.
    """

    layout: RotorLayout
    t_s: FloatArray
    shift: FloatArray
    beyond_health: bool
    limit: float | None = None

    def mean(self, since_s: float | None) -> FloatArray:
        """(rotors,) mean over the flight, or since a time if there is enough of it, nan if nothing is known."""
        known = np.isfinite(self.shift[:, 0])
        late = known if since_s is None else known & (self.t_s >= since_s + WINDOW_S)
        use = late if late.any() else known
        return self.shift[use].mean(axis=0) if use.any() else np.full(self.layout.rotors, np.nan)


def shift_of(
    blocks: Sequence[Block], layout: RotorLayout, healthy: RotorTrimSpec | None, threshold: float | None = None
) -> RotorShift:
    """The shift of every rotor.

    healthy: None if the baseline has no trim; then nothing is taken off. threshold: of the monitor [fraction of hover].
    """
    own = float(np.diag(layout.mixing @ layout.unmixing).mean())  # what a rise of 1 of a rotor is beside the mean
    times, shifts, segment, state = [np.empty(0)], [np.empty((0, layout.rotors))], -1, start_mean(3)
    mu = np.zeros(3) if healthy is None else np.array(healthy.mean)
    for block in blocks:
        if block.segment != segment:
            segment, state = block.segment, start_mean(3)
        trim, known = shown_trim(block, layout)
        state, mean, full = sliding_mean(state, trim, known, window_rows(WINDOW_S, block.dt_s))
        shift = (mean - mu) @ layout.mixing.T / own
        shift[~full] = np.nan
        times.append(block.t_ns / NS_PER_S)
        shifts.append(shift)
    return RotorShift(layout, np.concatenate(times), np.concatenate(shifts), healthy is not None, threshold)


def trim_picture(found: RotorShift | None, columns: int = COLUMNS) -> Picture:
    """The shift of every rotor over the flight."""
    if found is None or not np.isfinite(found.shift).any():
        return replace(TRIM, not_drawn=NO_LAYOUT if found is None else NO_TRIM)

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        for number in range(found.layout.rotors):
            line = LINES[number % len(LINES)]
            line.draw(axes, *envelope(found.t_s, 100 * found.shift[:, number], columns), f"rotor {number + 1}")
        axes.set(xlabel="vehicle time [s]", ylabel=f"{_what(found)}\n[% of hover]")
        _limits(axes, found)
        legend_above(axes, 5)

    return replace(TRIM, caption=_caption(TRIM.caption, found), svg=drawn(TRIM.title, _words(found, None), plot, 2.6))


def bars_picture(found: RotorShift | None, since_s: float | None) -> Picture:
    """The mean shift of every rotor as bars. since_s: when a fault was declared; None if none was."""
    if found is None or not np.isfinite(found.shift).any():
        return replace(BARS, not_drawn=NO_LAYOUT if found is None else NO_TRIM)
    mean = 100 * found.mean(since_s)

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        place = np.arange(1, len(mean) + 1)
        bars = axes.bar(place, mean, color=Colour.RESIDUAL, edgecolor=Colour.REFERENCE, width=0.6)
        bars[int(np.argmax(mean))].set(hatch="///")
        axes.bar_label(bars, [_signed(one) for one in mean.tolist()], padding=2)
        axes.axhline(0.0, color=Colour.REFERENCE, linewidth=0.8)
        _limits(axes, found)
        axes.set_xticks(place, [f"rotor {one}" for one in place])
        axes.set(ylabel=f"{_what(found)}\n[% of hover]")
        axes.margins(y=0.25)
        axes.grid(visible=False, axis="x")

    return replace(
        BARS,
        caption=f"{_caption(BARS.caption, found)} {_when(since_s)}",
        svg=drawn(BARS.title, _words(found, since_s), plot, 2.2),
    )


def airframe_picture(
    layout: RotorLayout | None, found: RotorShift | None, since_s: float | None, rotor: int | None
) -> Picture:
    """The drawing of the airframe with the mean shifts. rotor: the one that the decision names, if any."""
    if layout is None:
        return replace(AIRFRAME, not_drawn=NO_LAYOUT)
    mean = np.full(layout.rotors, np.nan) if found is None else found.mean(since_s)
    marks = {
        number: RotorMark(
            fill=Colour.FAULT if number == rotor else None,
            label=_signed(100 * value) if np.isfinite(value) else "",
            kind="fault" if number == rotor else "",
        )
        for number, value in enumerate(mean.tolist(), start=1)
    }
    named = "No rotor is named." if rotor is None else f"Rotor {rotor} is the one that the diagnosis names (filled)."
    caption = f"{AIRFRAME.caption} {named}"
    return replace(AIRFRAME, caption=caption, svg=airframe_svg(layout, marks, title=f"Airframe. {named}"))


def _limits(axes: "Axes", found: RotorShift) -> None:
    if found.limit is not None:
        LIMIT.across(axes, 100 * found.limit, "threshold of rotor_trim")
        LIMIT.across(axes, -100 * found.limit)


def _signed(percent: float) -> str:
    """With its sign, but no "-0.0"."""
    return f"{round(percent, 1) + 0.0:+.1f} %"


def _what(found: RotorShift) -> str:
    return "command beyond health" if found.beyond_health else "command beside the mean"


def _when(since_s: float | None) -> str:
    return (
        "Mean of the flight."
        if since_s is None
        else f"Mean of the flight after {since_s:.1f} s, when a fault was declared."
    )


def _caption(caption: str, found: RotorShift) -> str:
    if found.limit is not None:
        return caption
    caption = caption.partition(": its")[0].partition("; bars")[0].replace("the upper dashed line", "far up")
    if found.beyond_health:
        return f"{caption}."
    return f"{caption}. The baseline knows no healthy trim, so the airframe's own asymmetry is in it too."


def _words(found: RotorShift, since_s: float | None) -> str:
    mean = found.mean(since_s)
    return ", ".join(f"rotor {i} {_signed(100 * one)}" for i, one in enumerate(mean.tolist(), start=1)) + " of hover."
