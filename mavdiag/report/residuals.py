"""What the monitors saw: each one's statistic in shares of its threshold; and the thesis's own figures, by axis: rates
beside the model's, the residual and its margin, FSD against FML (T Fig 5.6 to 5.9), and where the flight lies among the
thesis's classes of faults (T Fig 5.10 and 5.12)."""

import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mavdiag.airframe.propellers import FaultType, propeller
from mavdiag.drawing import Colour
from mavdiag.report import style
from mavdiag.report.style import COLUMNS, LIMIT, LINES, Drawn, NotDrawn, envelope, legend_above, panels, picture, sheet
from mavdiag.rows.windows import spans
from mavdiag.telemetry import FloatArray
from mavdiag.traces import RateTrace, SlotTrace
from mavdiag.units import NS_PER_S

TOP = 1.25  # of the threshold: what is higher is cut off in its strip
APART = 1.5  # of two strips, in thresholds
SHOWN_S = 10.0  # of flight beside the model: more of it and the three lines cannot be told apart (our choice)
NO_MODEL = "no axis could be compared with its model: it takes attitude set-points and the fsd monitor in the baseline"
CLASSIFIER = "qdrone2-emulated"  # the airframes that the classes hold for
MOST_POINTS = 200  # of the plane (our choice)
EXCESS = "highest residual above\nthe margin [rad/s]"
NAMES = {
    FaultType.EDGE_CUT: "F1 edge cut",
    FaultType.CRACK: "F2 crack",
    FaultType.SURFACE_UNBALANCE: "F3 surface unbalance",
}
MARKERS = {FaultType.EDGE_CUT: "o", FaultType.CRACK: "^", FaultType.SURFACE_UNBALANCE: "D"}


def ratio_of(trace: SlotTrace) -> tuple[FloatArray, FloatArray]:
    """Vehicle time [s] and the statistic over its threshold, (n,); nan where it did not judge."""
    found, threshold = trace.found, trace.slot.threshold
    return found.t_ns / NS_PER_S, np.where(found.valid, found.value / threshold, np.nan)


@picture("evidence")
def evidence_picture(slots: Sequence[SlotTrace], columns: int = COLUMNS) -> Drawn:
    """All monitors over the flight, strip by strip, those that judged any of it."""
    judged = [trace for trace in slots if trace.found.valid.any()]
    if not judged:
        raise NotDrawn("no monitor judged any part of this flight")
    names = [" ".join(filter(None, trace.slot.key)) for trace in judged]
    most = ", ".join(f"{n} {np.nanmax(ratio_of(one)[1]):.2f}" for n, one in zip(names, judged, strict=True))
    figure, (axes,) = panels(0.6 + 0.36 * len(judged))
    for place, trace in enumerate(reversed(judged)):
        base = APART * place
        t_s, ratio = envelope(*ratio_of(trace), columns, filled=True)
        beyond: Any = {"facecolor": Colour.FAULT, "edgecolor": Colour.REFERENCE, "linewidth": 0.6}
        for where, top, look in (
            (np.isfinite(ratio), 1.0, {"color": Colour.RESIDUAL, "linewidth": 0.3}),
            (np.nan_to_num(ratio) > 1.0, TOP, beyond),
        ):
            for first, stop in spans(where):
                height = base + np.clip(ratio[first:stop], 0.0, top)
                x = np.concatenate((t_s[first : first + 1], t_s[first:stop], t_s[stop - 1 : stop]))
                axes.fill(x, np.concatenate(([base], height, [base])), **look)
        axes.axhline(base + 1.0, color=Colour.REFERENCE, linestyle="--", linewidth=0.7)
    axes.set_yticks([APART * place for place in range(len(judged))], names[::-1])
    axes.set(ylim=(-0.1, APART * len(judged) - 0.1))
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    return figure, f"Highest share of the threshold: {most}.", ""


@cache
def fault_classes() -> Mapping[FaultType, tuple[FloatArray, FloatArray]]:
    """Of each type: FSD [s] and residual above the margin [rad/s], (3, 3): by severity mean, 5 % and 95 % points."""
    found = tomllib.loads((style.FOLDER / "classes.toml").read_text(encoding="utf-8"))
    return {kind: (np.array(found[kind]["fsd_s"]), np.array(found[kind]["peak_rad_s"])) for kind in FaultType}


def runs_of(trace: RateTrace) -> FloatArray:
    """Stretches of one axis outside of the margin, in order of time, (4, k); a run ends with its segment.

    Rows: start and end [s], FSD [s], highest |r| - margin [rad/s].
    """
    excess, t_s = np.abs(trace.residual) - trace.margin_rad_s, trace.t_ns / NS_PER_S
    outside = trace.judged & (excess > 0)
    edges = [0, *(np.flatnonzero(np.diff(trace.segment)) + 1).tolist(), len(outside)]
    pieces = [(low + first, low + stop) for low, high in pairwise(edges) for first, stop in spans(outside[low:high])]
    found = [
        (t_s[first], t_s[stop - 1], trace.fsd_s[first:stop].max(), excess[first:stop].max()) for first, stop in pieces
    ]
    return np.array(found, dtype=np.float64).reshape(-1, 4).T


def longest_by_column(runs: FloatArray, columns: int) -> FloatArray:
    """Of the runs that end in one column of the picture the longest, (4, at most columns)."""
    if runs.shape[1] <= columns:
        return runs
    column, _ = style.columns_of(runs[1], columns)
    order = np.lexsort((runs[2], column))
    return runs[:, np.sort(order[np.append(np.diff(column[order]) > 0, True)])]


def moment_of(rates: Sequence[RateTrace]) -> tuple[float, float]:
    """The stretch of `SHOWN_S` about the longest run, or the middle of the flight if there is none [s]."""
    longest = max(rates, key=lambda trace: float(trace.fsd_s.max(initial=0.0)) / trace.fml_s)
    t_s = longest.t_ns / NS_PER_S
    at_s = float(t_s[longest.fsd_s.argmax()]) if longest.fsd_s.any() else float(np.median(t_s))
    start_s = max(float(t_s[0]), min(at_s - 0.6 * SHOWN_S, float(t_s[-1]) - SHOWN_S))
    return start_s, start_s + SHOWN_S


@picture("rates")
def rates_picture(rates: Sequence[RateTrace], columns: int = COLUMNS) -> Drawn:
    """Ten seconds of all modelled axes, about the longest FSD."""
    rates, figure, several = _by_axis(rates)
    start_s, stop_s = moment_of(rates)
    for axes, trace in zip(several, rates, strict=True):
        t_s = trace.t_ns / NS_PER_S
        part = slice(*np.searchsorted(t_s, (start_s, stop_s)))
        for line, values, label in (
            (style.COMMANDED, trace.commanded, "commanded"),
            (style.MEASURED, trace.measured, "measured"),
            (style.SIMULATED, trace.simulated, "simulated by the healthy model"),
        ):
            line.draw(axes, *envelope(t_s[part], values[part], columns), label)
        axes.set(ylabel=f"{trace.axis} rate [rad/s]", xlim=(start_s, stop_s))
    legend_above(several[0])
    span = f"{start_s:.1f} to {stop_s:.1f} s of the vehicle's clock"
    rms = ((one.axis, float(np.sqrt(np.mean(np.square(one.residual[one.judged]))))) for one in rates)
    words = "; ".join(f"{axis}: simulated and measured differ by {value:.3f} rad/s rms" for axis, value in rms)
    return figure, f"{span}. {words}.", f"Shown are {span}, about the longest FSD."


@picture("residual")
def residual_picture(rates: Sequence[RateTrace], columns: int = COLUMNS) -> Drawn:
    """The residual of all modelled axes over the flight; hatched, so that it shows in grey, where FSD exceeds FML."""
    rates, figure, several = _by_axis(rates)
    hatched: Any = {"facecolor": "none", "edgecolor": Colour.FAULT, "hatch": "////", "linewidth": 0.0, "alpha": 0.7}
    words = []
    for axes, trace in zip(several, rates, strict=True):
        r, margin = np.where(trace.judged, trace.residual, np.nan), trace.margin_rad_s
        style.MEASURED.draw(axes, *envelope(trace.t_ns / NS_PER_S, r, columns), "residual where judged")
        LIMIT.across(axes, margin, f"margin ±{margin:.3f} rad/s")
        LIMIT.across(axes, -margin)
        for start_s, end_s, fsd_s, _ in longest_by_column(runs_of(trace), columns).T.tolist():
            if fsd_s > trace.fml_s:
                axes.axvspan(start_s, end_s, **hatched)
        axes.set_ylabel(f"{trace.axis} residual [rad/s]")
        share = 100 * float(np.mean(np.abs(trace.residual[trace.judged]) > margin))
        words.append(f"{trace.axis}: margin {margin:.3f} rad/s, outside of it for {share:.0f} % of the judged time")
    legend_above(several[0])
    return figure, f"{'; '.join(words)}.", ""


@picture("fsd")
def fsd_picture(rates: Sequence[RateTrace], columns: int = COLUMNS) -> Drawn:
    """The runs of all modelled axes over the flight."""
    rates, figure, several = _by_axis(rates)
    for axes, trace in zip(several, rates, strict=True):
        _, end_s, fsd_s, _ = longest_by_column(runs_of(trace), columns)
        longer = fsd_s > trace.fml_s
        axes.vlines(end_s, 0.0, fsd_s, color=Colour.MEASURED, linewidth=0.9)
        axes.plot(end_s[longer], fsd_s[longer], "s", color=Colour.FAULT, markersize=4, label="FSD > FML")
        LIMIT.across(axes, trace.fml_s, f"FML {trace.fml_s:.3f} s")
        axes.set(ylabel=f"{trace.axis} FSD [s]", ylim=(0.0, None))
        legend_above(axes)
    longest = ((one.axis, one.fsd_s.max(initial=0.0), one.fml_s) for one in rates)
    words = "; ".join(f"{axis}: longest FSD {fsd_s:.3f} s, FML {fml_s:.3f} s" for axis, fsd_s, fml_s in longest)
    return figure, f"{words}.", ""


@picture("plane")
def plane_picture(rates: Sequence[RateTrace], classifier: str | None) -> Drawn:
    """The runs of the first modelled axis that judged; classes only for an airframe that they hold for."""
    trace, known = _judged(rates)[0], classifier == CLASSIFIER
    runs = runs_of(trace)
    if not runs.size and not known:
        raise NotDrawn("the residual never left its margin, and no classes are known for this airframe")
    figure = sheet(3.3)
    axes = figure.subplots()
    for line, kind in zip(LINES, FaultType if known else (), strict=False):
        x, y = (of[:, 0] for of in fault_classes()[kind])
        xerr, yerr = (np.abs(of[:, 1:] - of[:, :1]).T for of in fault_classes()[kind])
        look: Any = {"fmt": MARKERS[kind], "color": line.color, "elinewidth": 0.7, "label": NAMES[kind]}
        axes.errorbar(x, y, xerr=xerr, yerr=yerr, **look)
    few, grey, point = longest_by_column(runs, MOST_POINTS)[2:], Colour.NOT_JUDGED, "none"
    axes.plot(*few, ".", color=grey, markersize=4, label="runs of this flight")
    if runs.size:
        fsd_s, peak = runs[2:, runs[2].argmax()].tolist()
        axes.plot(fsd_s, peak, "*", color=Colour.REFERENCE, markersize=13, label="longest of this flight")
        point = f"{fsd_s:.3f} s and {peak:.3f} rad/s"
    axes.axvline(trace.fml_s, color=LIMIT.color, linestyle=LIMIT.stroke, label=f"FML {trace.fml_s:.3f} s")
    axes.set(xlabel=f"FSD, {trace.axis} [s]", ylabel=EXCESS, xlim=(0.0, None), ylim=(0.0, None))
    legend_above(axes, 3)
    note = "No classes are shown, for they are known for the emulated QDrone 2 alone."
    if known:
        note = "The class that it lies nearest to is the thesis's answer; the classes are of the emulated QDrone 2."
    return figure, f"Longest run of this flight: {point}; FML {trace.fml_s:.3f} s.", note


@picture("severity")
def severity_picture(
    rates: Sequence[RateTrace], slots: Sequence[SlotTrace], since_s: float | None, classifier: str | None
) -> Drawn:
    """Unbalance and residual of the flight among the classes. since_s: when a fault was declared; None if none was."""
    judged, unbalance = _judged(rates), unbalance_of(slots, since_s)
    if classifier != CLASSIFIER:
        raise NotDrawn("its severities are known for the emulated QDrone 2 alone")
    if unbalance is None:
        raise NotDrawn("the unbalance of this flight was not measured in g mm: see the table of monitors")
    runs = runs_of(judged[0])
    peak = float(runs[3, runs[2].argmax()]) if runs.size else 0.0
    figure = sheet(3.0)
    axes = figure.subplots()
    for line, kind in zip(LINES, FaultType, strict=False):
        x, y = [propeller(kind, severity).unbalance_g_mm for severity in (1, 2, 3)], fault_classes()[kind][1][:, 0]
        line.draw(axes, x, y, NAMES[kind], MARKERS[kind])
        for severity, at in enumerate(zip(x, y.tolist(), strict=True), start=1):
            axes.annotate(str(severity), at, (4, 4), textcoords="offset points")
    axes.plot(unbalance, peak, "*", color=Colour.REFERENCE, markersize=13, label="this flight")
    axes.set(xlabel="unbalance [g mm]", ylabel=EXCESS, xlim=(0.0, None), ylim=(0.0, None))
    legend_above(axes, 4)
    words = f"{unbalance:.2f} g mm beyond the healthy unbalance, residual {peak:.3f} rad/s above the margin."
    return figure, f"This flight: {words}", ""


def unbalance_of(slots: Sequence[SlotTrace], since_s: float | None) -> float | None:
    """Rms of the unbalance beyond the healthy one, since a time or of the flight [g mm]; None if it is not known."""
    for trace in slots:
        if trace.slot.monitor.name == "unbalance" and trace.slot.monitor.unit == "g mm":
            use = trace.found.valid & (trace.found.t_ns >= (0 if since_s is None else round(since_s * NS_PER_S)))
            if use.any():
                return float(np.sqrt(np.mean(np.square(trace.found.level[use]))))
    return None


def _by_axis(rates: Sequence[RateTrace]) -> tuple[list[RateTrace], Figure, list[Axes]]:
    judged = _judged(rates)
    return judged, *panels(0.5 + 1.6 * len(judged), len(judged))


def _judged(rates: Sequence[RateTrace]) -> list[RateTrace]:
    found = [trace for trace in rates if trace.judged.any()]
    if not found:
        raise NotDrawn(NO_MODEL)
    return found
