"""What each rotor is commanded beside the others, over the flight and on a drawing of the airframe.

    m: trim averaged over 5 s,    mu: the healthy one,    w = B (m - mu) / b

b: the mean of the diagonal of B B^+. So w_j is the rise of rotor j, beyond what it was in health, if it alone rose
[fraction of hover], as the rotor-trim monitor has it. The others fall by a third of it then.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import shown_trim
from mavdiag.drawing import Colour, RotorMark, airframe_svg
from mavdiag.monitors.rotor_trim import RotorTrimSpec
from mavdiag.report.style import (
    COLUMNS,
    LIMIT,
    LINES,
    Drawn,
    NotDrawn,
    Picture,
    envelope,
    legend_above,
    panels,
    picture,
)
from mavdiag.rows.block import Block
from mavdiag.rows.windows import window_all, window_mean, window_rows
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

WINDOW_S = 5.0  # of the means, as the monitor has it
NO_LAYOUT = "the rotor layout is not known; name it with --layout or --airframe when the baseline is learnt"
NO_TRIM = "no 5 s of flight without a break carry the motors' outputs, or torque commands whose mixing is known"


@dataclass(frozen=True, slots=True, eq=False)
class RotorShift:
    """t_s: (n,) vehicle time [s]. shift: (n, rotors) w [fraction of hover], nan where unknown.

    beyond_health: whether the healthy trim was taken off.
    limit: the rotor-trim monitor's threshold [fraction of hover]; None without one.
    """

    t_s: FloatArray
    shift: FloatArray
    beyond_health: bool
    limit: float | None = None

    def mean(self, since_s: float | None) -> FloatArray:
        """(rotors,) mean over the flight, or since a time if there is enough of it, nan if nothing is known."""
        known = np.isfinite(self.shift[:, 0])
        late = known if since_s is None else known & (self.t_s >= since_s + WINDOW_S)
        use = late if late.any() else known
        return self.shift[use].mean(axis=0) if use.any() else np.full(self.shift.shape[1], np.nan)


def shift_of(
    blocks: Sequence[Block], layout: RotorLayout, healthy: RotorTrimSpec | None, threshold: float | None = None
) -> RotorShift:
    """The shift of every rotor. blocks: one a segment. healthy: None if the baseline has no trim."""
    own = float(np.diag(layout.mixing @ layout.unmixing).mean())  # what a rise of 1 of a rotor is beside the mean
    mu = np.zeros(3) if healthy is None else np.array(healthy.mean)
    times, shifts = [np.empty(0)], [np.empty((0, layout.rotors))]
    for block in blocks:
        trim, known = shown_trim(block, layout)
        window = window_rows(WINDOW_S, block.dt_s)
        shift = np.full((len(block), layout.rotors), np.nan)
        whole = window_all(known, window)
        shift[window - 1 :][whole] = (window_mean(trim, window)[whole] - mu) @ layout.mixing.T / own
        times.append(block.t_ns / NS_PER_S)
        shifts.append(shift)
    return RotorShift(np.concatenate(times), np.concatenate(shifts), healthy is not None, threshold)


@picture("trim")
def trim_picture(found: RotorShift | None, columns: int = COLUMNS) -> Drawn:
    """The shift of every rotor over the flight."""
    if found is None or not np.isfinite(found.shift).any():
        raise NotDrawn(NO_LAYOUT if found is None else NO_TRIM)
    figure, (axes,) = panels(2.6)
    for number, shift in enumerate(found.shift.T):
        LINES[number % len(LINES)].draw(axes, *envelope(found.t_s, 100 * shift, columns), f"rotor {number + 1}")
    axes.set_ylabel(f"command be{'yond health' if found.beyond_health else 'side the mean'}\n[% of hover]")
    note = "The baseline knows no healthy trim, so the airframe's own asymmetry is in it too."
    note = "" if found.beyond_health else note
    if found.limit is not None:
        LIMIT.across(axes, 100 * found.limit, "threshold of rotor_trim")
        LIMIT.across(axes, -100 * found.limit)
        note = "What stays within the dashed lines is what wind, propellers and sessions do to a healthy vehicle."
    legend_above(axes, 5)
    mean = enumerate(found.mean(None).tolist(), start=1)
    return figure, ", ".join(f"rotor {i} {_signed(100 * value)}" for i, value in mean) + " of hover.", note


def airframe_picture(
    layout: RotorLayout | None, found: RotorShift | None, since_s: float | None, rotor: int | None
) -> Picture:
    """The drawing of the airframe with the mean shifts. rotor: the one that the decision names, if any."""
    if layout is None or found is None:
        return Picture("airframe", not_drawn=NO_LAYOUT)
    mean = enumerate(found.mean(since_s).tolist(), start=1)
    labels = {n: _signed(100 * value) if np.isfinite(value) else "" for n, value in mean}
    marks = {n: RotorMark(label=label) for n, label in labels.items()}
    if rotor in labels:
        marks[rotor] = RotorMark(Colour.FAULT, labels[rotor], "fault")
    named = "No rotor is named." if rotor is None else f"Rotor {rotor} is the one that the diagnosis names (filled)."
    return Picture("airframe", named, airframe_svg(layout, marks, title=f"Airframe. {named}"))


def _signed(percent: float) -> str:
    return f"{round(percent, 1) + 0.0:+.1f} %"  # and no "-0.0"
