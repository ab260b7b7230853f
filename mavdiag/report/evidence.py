"""Which monitor saw what, and when: each slot's statistic in shares of its threshold, strip by strip."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.drawing import Colour
from mavdiag.report.style import Picture, missing, pictured
from mavdiag.report.thinned import COLUMNS, highest
from mavdiag.rows.windows import spans
from mavdiag.telemetry import FloatArray
from mavdiag.traces import SlotTrace
from mavdiag.units import NS_PER_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TOP = 1.25  # of the threshold: what is higher is cut off in its strip
APART = 1.5  # of two strips, in thresholds


def ratio_of(trace: SlotTrace) -> tuple[FloatArray, FloatArray]:
    """Vehicle time [s] and the statistic over its threshold, (n,); nan where it did not judge."""
    found, threshold = trace.found, trace.slot.threshold
    return found.t_ns / NS_PER_S, np.where(found.valid, found.value / threshold, np.nan)


def evidence_picture(slots: Sequence[SlotTrace], columns: int = COLUMNS) -> Picture:
    """All monitors over the flight, those that judged any of it."""
    judged = [trace for trace in slots if trace.found.valid.any()]
    if not judged:
        return missing("evidence", "no monitor judged any part of this flight")
    names = [" ".join(filter(None, trace.slot.key)) for trace in judged]
    most = ", ".join(f"{n} {np.nanmax(ratio_of(one)[1]):.2f}" for n, one in zip(names, judged, strict=True))

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        for place, trace in enumerate(reversed(judged)):
            _strip(axes, trace, APART * place, columns)
        axes.set_yticks([APART * place for place in range(len(judged))], names[::-1])
        axes.set(xlabel="vehicle time [s]", ylim=(-0.1, APART * len(judged) - 0.1))
        axes.grid(visible=False, axis="y")
        axes.tick_params(axis="y", length=0)

    return pictured("evidence", f"Highest share of the threshold: {most}.", plot, 0.6 + 0.36 * len(judged))


def _strip(axes: "Axes", trace: SlotTrace, base: float, columns: int) -> None:
    t_s, ratio = highest(*ratio_of(trace), columns)
    height = base + np.clip(ratio, 0.0, TOP)
    for first, stop in spans(np.isfinite(ratio)):
        x, y = _outline(t_s[first:stop], np.minimum(height[first:stop], base + 1.0), base)
        axes.fill(x, y, color=Colour.RESIDUAL, linewidth=0.3)
    for first, stop in spans(np.nan_to_num(ratio) > 1.0):
        x, y = _outline(t_s[first:stop], height[first:stop], base)
        axes.fill(x, y, facecolor=Colour.FAULT, edgecolor=Colour.REFERENCE, linewidth=0.6)
    axes.axhline(base + 1.0, color=Colour.REFERENCE, linestyle="--", linewidth=0.7)


def _outline(t_s: FloatArray, height: FloatArray, base: float) -> tuple[FloatArray, FloatArray]:
    return np.concatenate((t_s[:1], t_s, t_s[-1:])), np.concatenate(([base], height, [base]))
