"""The thesis's own figures of a flight: rates beside the model's, the residual and its margin, FSD against FML.

T Fig 5.6 to 5.9, by axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.drawing import Colour
from mavdiag.report.style import COMMANDED, LIMIT, MEASURED, SIMULATED, Picture, drawn, legend_above, panels, shaded
from mavdiag.report.thinned import COLUMNS, columns_of, envelope
from mavdiag.rows.windows import spans
from mavdiag.telemetry import BoolArray, FloatArray
from mavdiag.traces import RateTrace
from mavdiag.units import NS_PER_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Runs", "fsd_picture", "longest_by_column", "moment_of", "rates_picture", "residual_picture", "runs_of"]

SHOWN_S = 10.0  # of flight beside the model: more of it and the three lines cannot be told apart (our choice)
NO_MODEL = "no axis could be compared with its model: it takes attitude set-points and the fsd monitor in the baseline"
RATES = Picture(
    "rates",
    "Commanded, measured and simulated rate",
    "Where the measured rate (solid) leaves the one that the healthy model simulates from the command alone (dashed), "
    "the vehicle does not answer as it did in health.",
    "5.6",
)
RESIDUAL = Picture(
    "residual",
    "Residual against its margin",
    "The residual, measured less simulated rate, stays within the margin (dashed) for most of a healthy flight; "
    "hatched are the times when it was outside for longer than the FML without a break.",
    "5.7, 5.8",
)
FSD = Picture(
    "fsd",
    "How long the residual stayed outside of its margin: FSD against FML",
    "Each bar is one stretch outside of the margin, as long as its fault signature duration (FSD): bars with a "
    "square end above the fault minimal latency (FML, dashed) are alarms of the thesis's rule.",
    "5.9",
)


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Stretches of judged time outside of the margin: (k,) start and end [s], FSD [s], highest |r| - margin [rad/s]."""

    start_s: FloatArray
    end_s: FloatArray
    fsd_s: FloatArray
    peak_rad_s: FloatArray

    def __len__(self) -> int:
        return len(self.start_s)

    def above(self, fml_s: float) -> BoolArray:
        """(k,) whether longer than the FML."""
        longer: BoolArray = self.fsd_s > fml_s
        return longer


def runs_of(trace: RateTrace) -> Runs:
    """All runs of one axis, in order of time."""
    excess = np.abs(trace.residual) - trace.margin_rad_s
    outside = trace.judged & (excess > 0)
    edges = np.flatnonzero(np.diff(trace.segment)) + 1  # a run ends with its segment
    pieces = [
        (low + first, low + stop)
        for low, high in zip((0, *edges.tolist()), (*edges.tolist(), len(outside)), strict=True)
        for first, stop in spans(outside[low:high])
    ]
    if not pieces:
        none = np.empty(0)
        return Runs(none, none, none, none)
    t_s = trace.t_ns / NS_PER_S
    start, stop = np.array(pieces).T
    cuts = np.array(pieces).ravel()
    padded = np.append(trace.fsd_s, 0.0), np.append(excess, 0.0)
    fsd_s, peak = (np.maximum.reduceat(one, cuts)[::2] for one in padded)
    return Runs(t_s[start], t_s[stop - 1], fsd_s, peak)


def moment_of(rates: Sequence[RateTrace]) -> tuple[float, float]:
    """The stretch of `SHOWN_S` about the longest run, or the middle of the flight if there is none [s]."""
    longest = max(rates, key=lambda one: float(one.fsd_s.max(initial=0.0)) / one.fml_s)
    t_s = longest.t_ns / NS_PER_S
    at_s = float(t_s[longest.fsd_s.argmax()]) if longest.fsd_s.any() else float(np.median(t_s))
    start_s = max(float(t_s[0]), min(at_s - 0.6 * SHOWN_S, float(t_s[-1]) - SHOWN_S))
    return start_s, start_s + SHOWN_S


def rates_picture(rates: Sequence[RateTrace], columns: int = COLUMNS) -> Picture:
    """Ten seconds of all modelled axes, about the longest FSD."""
    rates = _known(rates)
    if not rates:
        return replace(RATES, not_drawn=NO_MODEL)
    start_s, stop_s = moment_of(rates)

    def plot(figure: "Figure") -> None:
        for axes, trace in zip(panels(figure, len(rates)), rates, strict=True):
            t_s = trace.t_ns / NS_PER_S
            part = slice(*np.searchsorted(t_s, (start_s, stop_s)))
            for line, values, label in (
                (COMMANDED, trace.commanded, "commanded"),
                (MEASURED, trace.measured, "measured"),
                (SIMULATED, trace.simulated, "simulated by the healthy model"),
            ):
                line.draw(axes, *envelope(t_s[part], values[part], columns), label)
            axes.set(ylabel=f"{trace.axis} rate [rad/s]", xlim=(start_s, stop_s))
        legend_above(figure.axes[0])
        figure.axes[-1].set_xlabel("vehicle time [s]")

    span = f"{start_s:.1f} to {stop_s:.1f} s of the vehicle's clock"
    words = "; ".join(f"{one.axis}: simulated and measured differ by {_rms(one):.3f} rad/s rms" for one in rates)
    picture = replace(RATES, caption=f"{RATES.caption} Shown are {span}, about the longest FSD.")
    return replace(picture, svg=drawn(RATES.title, f"{span}. {words}.", plot, 0.5 + 1.6 * len(rates)))


def residual_picture(rates: Sequence[RateTrace], columns: int = COLUMNS) -> Picture:
    """The residual of all modelled axes over the flight."""
    rates = _known(rates)
    if not rates:
        return replace(RESIDUAL, not_drawn=NO_MODEL)

    def plot(figure: "Figure") -> None:
        for axes, trace in zip(panels(figure, len(rates)), rates, strict=True):
            _residual(axes, trace, columns)
        legend_above(figure.axes[0])
        figure.axes[-1].set_xlabel("vehicle time [s]")

    words = "; ".join(
        f"{one.axis}: margin {one.margin_rad_s:.3f} rad/s, outside of it for {100 * _outside(one):.0f} % of the "
        "judged time"
        for one in rates
    )
    return replace(RESIDUAL, svg=drawn(RESIDUAL.title, f"{words}.", plot, 0.5 + 1.6 * len(rates)))


def fsd_picture(rates: Sequence[RateTrace], columns: int = COLUMNS) -> Picture:
    """The runs of all modelled axes over the flight."""
    rates = _known(rates)
    if not rates:
        return replace(FSD, not_drawn=NO_MODEL)

    def plot(figure: "Figure") -> None:
        for axes, trace in zip(panels(figure, len(rates)), rates, strict=True):
            runs = longest_by_column(runs_of(trace), columns)
            longer = runs.above(trace.fml_s)
            axes.vlines(runs.end_s, 0.0, runs.fsd_s, color=Colour.MEASURED, linewidth=0.9)
            axes.plot(runs.end_s[longer], runs.fsd_s[longer], "s", color=Colour.FAULT, markersize=4, label="FSD > FML")
            LIMIT.across(axes, trace.fml_s, f"FML {trace.fml_s:.3f} s")
            axes.set(ylabel=f"{trace.axis} FSD [s]", ylim=(0.0, None))
            legend_above(axes)
        figure.axes[-1].set_xlabel("vehicle time [s]")

    words = "; ".join(
        f"{one.axis}: longest FSD {one.fsd_s.max(initial=0.0):.3f} s, FML {one.fml_s:.3f} s" for one in rates
    )
    return replace(FSD, svg=drawn(FSD.title, f"{words}.", plot, 0.5 + 1.5 * len(rates)))


def longest_by_column(runs: Runs, columns: int) -> Runs:
    """Of the runs that end in one column of the picture the longest."""
    if len(runs) <= columns:
        return runs
    column, _ = columns_of(runs.end_s, columns)
    order = np.lexsort((runs.fsd_s, column))
    kept = np.sort(order[np.append(np.diff(column[order]) > 0, True)])
    return Runs(runs.start_s[kept], runs.end_s[kept], runs.fsd_s[kept], runs.peak_rad_s[kept])


def _residual(axes: "Axes", trace: RateTrace, columns: int) -> None:
    r = np.where(trace.judged, trace.residual, np.nan)
    MEASURED.draw(axes, *envelope(trace.t_ns / NS_PER_S, r, columns), "residual where judged")
    for sign, label in ((1, f"margin ±{trace.margin_rad_s:.3f} rad/s"), (-1, "")):
        LIMIT.across(axes, sign * trace.margin_rad_s, label)
    long = longest_by_column(runs_of(trace), columns)
    for place in np.flatnonzero(long.above(trace.fml_s)).tolist():
        shaded(axes, float(long.start_s[place]), float(long.end_s[place]))
    axes.set_ylabel(f"{trace.axis} residual [rad/s]")


def _known(rates: Sequence[RateTrace]) -> list[RateTrace]:
    """Those that judged any of the flight."""
    return [one for one in rates if one.judged.any()]


def _rms(trace: RateTrace) -> float:
    return float(np.sqrt(np.mean(np.square(trace.residual[trace.judged]))))


def _outside(trace: RateTrace) -> float:
    return float(np.mean(np.abs(trace.residual[trace.judged]) > trace.margin_rad_s))
