"""What the monitors saw: each one's statistic in shares of its threshold; and the thesis's own figures, by axis: rates
beside the model's, the residual and its margin, FSD against FML (T Fig 5.6 to 5.9), and where the flight lies among the
thesis's classes of faults (T Fig 5.10 and 5.12)."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

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
        t_s, ratio = style.highest(*ratio_of(trace), columns)
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


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Stretches of judged time outside of the margin: (k,) start and end [s], FSD [s], highest |r| - margin [rad/s]."""

    start_s: FloatArray
    end_s: FloatArray
    fsd_s: FloatArray
    peak_rad_s: FloatArray

    def __len__(self) -> int:
        return len(self.start_s)

    @property
    def longest(self) -> tuple[float, float]:
        """FSD [s] and peak [rad/s] of the longest run; 0 without one."""
        if not len(self):
            return 0.0, 0.0
        at = int(self.fsd_s.argmax())
        return float(self.fsd_s[at]), float(self.peak_rad_s[at])

    def longest_by_column(self, columns: int) -> "Runs":
        """Of the runs that end in one column of the picture the longest."""
        if len(self) <= columns:
            return self
        column, _ = style.columns_of(self.end_s, columns)
        order = np.lexsort((self.fsd_s, column))
        kept = np.sort(order[np.append(np.diff(column[order]) > 0, True)])
        return Runs(self.start_s[kept], self.end_s[kept], self.fsd_s[kept], self.peak_rad_s[kept])


def runs_of(trace: RateTrace) -> Runs:
    """All runs of one axis, in order of time; a run ends with its segment."""
    excess = np.abs(trace.residual) - trace.margin_rad_s
    outside = trace.judged & (excess > 0)
    edges = [0, *(np.flatnonzero(np.diff(trace.segment)) + 1).tolist(), len(outside)]
    pieces = [(low + first, low + stop) for low, high in pairwise(edges) for first, stop in spans(outside[low:high])]
    start, stop = np.array(pieces, dtype=np.int64).reshape(-1, 2).T
    t_s = trace.t_ns / NS_PER_S
    fsd_s, peak = (np.array([values[first:after].max() for first, after in pieces]) for values in (trace.fsd_s, excess))
    return Runs(t_s[start], t_s[stop - 1], fsd_s, peak)


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
    rates = _judged(rates)
    start_s, stop_s = moment_of(rates)
    figure, several = panels(0.5 + 1.6 * len(rates), len(rates))
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
    rates = _judged(rates)
    figure, several = panels(0.5 + 1.6 * len(rates), len(rates))
    hatched: Any = {"facecolor": "none", "edgecolor": Colour.FAULT, "hatch": "////", "linewidth": 0.0, "alpha": 0.7}
    words = []
    for axes, trace in zip(several, rates, strict=True):
        r, margin = np.where(trace.judged, trace.residual, np.nan), trace.margin_rad_s
        style.MEASURED.draw(axes, *envelope(trace.t_ns / NS_PER_S, r, columns), "residual where judged")
        LIMIT.across(axes, margin, f"margin ±{margin:.3f} rad/s")
        LIMIT.across(axes, -margin)
        runs = runs_of(trace).longest_by_column(columns)
        for at in np.flatnonzero(runs.fsd_s > trace.fml_s).tolist():
            axes.axvspan(float(runs.start_s[at]), float(runs.end_s[at]), **hatched)
        axes.set_ylabel(f"{trace.axis} residual [rad/s]")
        share = 100 * float(np.mean(np.abs(trace.residual[trace.judged]) > margin))
        words.append(f"{trace.axis}: margin {margin:.3f} rad/s, outside of it for {share:.0f} % of the judged time")
    legend_above(several[0])
    return figure, f"{'; '.join(words)}.", ""


@picture("fsd")
def fsd_picture(rates: Sequence[RateTrace], columns: int = COLUMNS) -> Drawn:
    """The runs of all modelled axes over the flight."""
    rates = _judged(rates)
    figure, several = panels(0.5 + 1.5 * len(rates), len(rates))
    for axes, trace in zip(several, rates, strict=True):
        runs = runs_of(trace).longest_by_column(columns)
        longer = runs.fsd_s > trace.fml_s
        axes.vlines(runs.end_s, 0.0, runs.fsd_s, color=Colour.MEASURED, linewidth=0.9)
        axes.plot(runs.end_s[longer], runs.fsd_s[longer], "s", color=Colour.FAULT, markersize=4, label="FSD > FML")
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
    if not len(runs) and not known:
        raise NotDrawn("the residual never left its margin, and no classes are known for this airframe")
    figure = sheet(3.3)
    axes = figure.subplots()
    for line, kind in zip(LINES, FaultType if known else (), strict=False):
        x, y = (of[:, 0] for of in fault_classes()[kind])
        xerr, yerr = (np.abs(of[:, 1:] - of[:, :1]).T for of in fault_classes()[kind])
        look: Any = {"fmt": MARKERS[kind], "color": line.color, "elinewidth": 0.7, "label": NAMES[kind]}
        axes.errorbar(x, y, xerr=xerr, yerr=yerr, **look)
    few, grey = runs.longest_by_column(MOST_POINTS), Colour.NOT_JUDGED
    axes.plot(few.fsd_s, few.peak_rad_s, ".", color=grey, markersize=4, label="runs of this flight")
    if len(runs):
        axes.plot(*runs.longest, "*", color=Colour.REFERENCE, markersize=13, label="longest of this flight")
    axes.axvline(trace.fml_s, color=LIMIT.color, linestyle=LIMIT.stroke, label=f"FML {trace.fml_s:.3f} s")
    axes.set(xlabel=f"FSD, {trace.axis} [s]", ylabel=EXCESS, xlim=(0.0, None), ylim=(0.0, None))
    legend_above(axes, 3)
    note = "No classes are shown, for they are known for the emulated QDrone 2 alone."
    if known:
        note = "The class that it lies nearest to is the thesis's answer; the classes are of the emulated QDrone 2."
    point = f"{runs.longest[0]:.3f} s and {runs.longest[1]:.3f} rad/s" if len(runs) else "none"
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
    peak = runs_of(judged[0]).longest[1]
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


def _judged(rates: Sequence[RateTrace]) -> list[RateTrace]:
    """Those that judged any of the flight."""
    found = [trace for trace in rates if trace.judged.any()]
    if not found:
        raise NotDrawn(NO_MODEL)
    return found
