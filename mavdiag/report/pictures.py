"""The pictures of one flight.

What each rotor is commanded beside the others:

    m: trim averaged over 5 s,    mu: the healthy one,    w = B (m - mu) / b

b: the mean of the diagonal of B B^+. So w_j is the rise of rotor j, beyond what it was in health, if it alone rose
[fraction of hover], as the rotor-trim monitor has it. Then each monitor's statistic in shares of its threshold, and the
thesis's figures (captions.toml has their numbers).
"""

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.propellers import FaultType, propeller
from mavdiag.airframe.trim import shown_trim
from mavdiag.identify import Method, Order
from mavdiag.identify.estimate import SweepRow, sweep
from mavdiag.look.figures import HARMONICS, SPECTRUM_S, Spectrum
from mavdiag.monitors.rotor_trim import RotorTrimSpec
from mavdiag.monitors.run_length import MIN_PIECE_S
from mavdiag.report import style
from mavdiag.report.drawing import Colour, RotorMark, airframe_svg
from mavdiag.report.style import LIMIT, LINES, Drawn, NotDrawn, envelope, legend_above, panels, picture, sheet
from mavdiag.rows.block import Block
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.windows import spans, window_all, window_mean, window_rows
from mavdiag.telemetry import Axis, FloatArray, Series, Signal, Telemetry
from mavdiag.traces import RateTrace, SlotTrace
from mavdiag.units import DEG, NS_PER_S

WINDOW_S = 5.0  # of the means, as the monitor has it
NO_LAYOUT = "the rotor layout is not known; name it with --layout or --airframe when the baseline is learnt"
NO_TRIM = "no 5 s of flight without a break carry the motors' outputs, or torque commands whose mixing is known"
TOP = 1.25  # of the threshold: what is higher is cut off in its strip
APART = 1.5  # of two strips, in thresholds
SHOWN_S = 10.0  # of flight beside the model: more of it and the three lines cannot be told apart (our choice)
NO_MODEL = "no axis could be compared with its model: it takes attitude set-points and the fsd monitor in the baseline"
CLASSIFIER = "qdrone2-emulated"  # the airframes that the classes hold for
MOST_POINTS = 200  # of the plane (our choice)
EXCESS = "highest residual above\nthe margin [rad/s]"
NAMES = dict(zip(FaultType, ("F1 edge cut", "F2 crack", "F3 surface unbalance"), strict=True))
MARKERS = dict(zip(FaultType, "o^D", strict=True))
LEAST_HZ = 2.0  # of a spectrum: below it is the flight itself
NAMED_AT = ("data", "axes fraction")
WINDOWS_S = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
LEAST = 5  # samples: the shortest window of a parabola that smooths
MOST_ROWS = 20_000  # of the flight that are fitted: seven fits of an axis take about a second (our choice)


@dataclass(frozen=True, slots=True, eq=False)
class RotorShift:
    """The shift of every rotor over the flight."""

    t_s: FloatArray  # (n,) vehicle time
    shift: FloatArray  # (n, rotors) w [fraction of hover], nan where unknown
    beyond_health: bool  # whether the healthy trim was taken off
    limit: float | None = None  # the rotor-trim monitor's threshold [fraction of hover]

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
def trim_picture(found: RotorShift | None, columns: int = style.COLUMNS) -> Drawn:
    """The shift of every rotor over the flight."""
    if found is None or not np.isfinite(found.shift).any():
        raise NotDrawn(NO_LAYOUT if found is None else NO_TRIM)
    figure, (axes,) = panels(2.6)
    for number, shift in enumerate(found.shift.T):
        LINES[number % len(LINES)].draw(axes, *envelope(found.t_s, 100 * shift, columns), f"rotor {number + 1}")
    axes.set_ylabel(f"command be{'yond health' if found.beyond_health else 'side the mean'}\n[% of hover]")
    note = "" if found.beyond_health else "The baseline knows no healthy trim, so the airframe's own is in it too."
    if found.limit is not None:
        LIMIT.across(axes, 100 * found.limit, "threshold of rotor_trim")
        LIMIT.across(axes, -100 * found.limit)
        note = "What stays within the dashed lines is what wind, propellers and sessions do to a healthy vehicle."
    legend_above(axes, 5)
    mean = enumerate(found.mean(None).tolist(), start=1)
    return figure, ", ".join(f"rotor {i} {_signed(100 * value)}" for i, value in mean) + " of hover.", note


def airframe_picture(
    layout: RotorLayout | None, found: RotorShift | None, since_s: float | None, rotor: int | None
) -> style.Picture:
    """The drawing of the airframe with the mean shifts. rotor: the one that the decision names, if any."""
    if layout is None or found is None:
        return style.Picture("airframe", not_drawn=NO_LAYOUT)
    mean = enumerate(found.mean(since_s).tolist(), start=1)
    labels = {n: _signed(100 * value) if np.isfinite(value) else "" for n, value in mean}
    marks = {n: RotorMark(label=label) for n, label in labels.items()}
    if rotor in labels:
        marks[rotor] = RotorMark(Colour.FAULT, labels[rotor], "fault")
    named = "No rotor is named." if rotor is None else f"Rotor {rotor} is the one that the diagnosis names (filled)."
    return style.Picture("airframe", named, airframe_svg(layout, marks, title=f"Airframe. {named}"))


def _signed(percent: float) -> str:
    return f"{round(percent, 1) + 0.0:+.1f} %"  # and no "-0.0"


def ratio_of(trace: SlotTrace) -> tuple[FloatArray, FloatArray]:
    """Vehicle time [s] and the statistic over its threshold, (n,); nan where it did not judge."""
    found, threshold = trace.found, trace.slot.threshold
    return found.t_ns / NS_PER_S, np.where(found.valid, found.value / threshold, np.nan)


@picture("evidence")
def evidence_picture(slots: Sequence[SlotTrace], columns: int = style.COLUMNS) -> Drawn:
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
    """Start and end [s], FSD [s], highest |r| - margin [rad/s] of each run outside of the margin, (4, k)."""
    excess, t_s = np.abs(trace.residual) - trace.margin_rad_s, trace.t_ns / NS_PER_S
    outside = trace.judged & (excess > 0)
    edges = [0, *(np.flatnonzero(np.diff(trace.segment)) + 1).tolist(), len(outside)]
    pieces = [(low + first, low + stop) for low, high in pairwise(edges) for first, stop in spans(outside[low:high])]
    found = [(t_s[a], t_s[b - 1], trace.fsd_s[a:b].max(), excess[a:b].max()) for a, b in pieces]
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
def rates_picture(rates: Sequence[RateTrace], columns: int = style.COLUMNS) -> Drawn:
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
def residual_picture(rates: Sequence[RateTrace], columns: int = style.COLUMNS) -> Drawn:
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
def fsd_picture(rates: Sequence[RateTrace], columns: int = style.COLUMNS) -> Drawn:
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


@picture("height")
def height_picture(telemetry: Telemetry, columns: int = style.COLUMNS) -> Drawn:
    """Height over time."""
    height = telemetry.get(Signal.HEIGHT)
    if height is None or not np.isfinite(height.values).any():
        raise NotDrawn("the log carries no height, and this tool reads no horizontal position")
    figure, (axes,) = panels(1.9)
    style.MEASURED.draw(axes, *_line(height, 0, 1.0, columns))
    axes.set_ylabel("height [m]")
    return figure, f"From {np.nanmin(height.values):.1f} to {np.nanmax(height.values):.1f} m.", ""


@picture("attitude")
def attitude_picture(telemetry: Telemetry, columns: int = style.COLUMNS) -> Drawn:
    """Roll and pitch over time, commanded and estimated, as far as the log carries them."""
    wanted = ((Signal.ATTITUDE_SETPOINT, style.COMMANDED, "commanded"), (Signal.ATTITUDE, style.MEASURED, "estimated"))
    there = [(telemetry.get(signal), line, name) for signal, line, name in wanted]
    shown = [(series, line, name) for series, line, name in there if series is not None and len(series) > 1]
    if not shown:
        raise NotDrawn("the log carries neither the commanded nor the estimated attitude")
    figure, several = panels(3.2, 2)
    for column, (axes, angle) in enumerate(zip(several, ("roll", "pitch"), strict=True)):
        for series, line, name in reversed(shown):
            line.draw(axes, *_line(series, column, 1 / DEG, columns), name)
        axes.set_ylabel(f"{angle} [°]")
    legend_above(several[0])
    most = ((name, np.nanmax(np.abs(series.values[:, :2]), axis=0, initial=0.0) / DEG) for series, _, name in shown)
    words = "; ".join(f"{name}: roll within {roll:.0f}°, pitch within {pitch:.0f}°" for name, (roll, pitch) in most)
    return figure, f"{words}.", "" if len(shown) == 2 else f"This log carries the {shown[0][2]} angles only."


def folded(hz: float, rate_hz: float) -> float:
    """Fold a frequency into a stream that is sampled at this rate.

    >>> folded(167.0, 1000.0), folded(167.0, 200.0)
    (167.0, 33.0)
    """
    return abs(hz - rate_hz * round(hz / rate_hz))


@picture("spectrum")
def spectrum_picture(
    spectrum: Spectrum | None, line: tuple[float, str] | None, corner_hz: float | None, rate_hz: float
) -> Drawn:
    """The spectrum of the judged flight. line: one per revolution [Hz], and where it is known from."""
    if spectrum is None:
        raise NotDrawn(f"no {SPECTRUM_S:g} s of flight without a break carries the accelerometer's x and y")
    use = spectrum.frequency_hz >= LEAST_HZ
    hz, density = spectrum.frequency_hz[use], np.sqrt(spectrum.power[use])
    figure = sheet(2.7)
    axes = figure.subplots()
    LINES[0].draw(axes, hz, density[:, 0], "x, forward")
    LINES[1].draw(axes, hz, density[:, 1], "y, right")
    note = "The rotors' speed is not known: neither log nor airframe tells it, and no line stands out."
    if line is not None:
        for k in range(1, HARMONICS + 1):
            at, name = folded(k * line[0], rate_hz), "rotors' line" if k == 1 else f"x{k}"
            axes.axvline(at, color="#000000", linestyle="--" if k == 1 else ":", linewidth=0.9, zorder=0)
            axes.annotate(name, (at, 1.0), (-3, -9), xycoords=NAMED_AT, textcoords="offset points", ha="right")
        seen_hz = folded(line[0], rate_hz)
        fold = f", which {rate_hz:.0f} samples a second fold to {seen_hz:.0f} Hz"
        fold = "" if math.isclose(seen_hz, line[0]) else fold
        note = f"The line (dashed) is at {line[0]:.0f} Hz by {line[1]}{fold}."
    axes.set(xlabel="frequency [Hz]", ylabel="acceleration\n[m/s²/√Hz]", xlim=(0, rate_hz / 2))
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    legend_above(axes)
    note += "" if corner_hz is None else f" This stream is low-passed at {corner_hz:g} Hz: above it little is left."
    peak = f"Highest peak at {hz[density.max(axis=1).argmax()]:.0f} Hz."
    return figure, f"{peak} {spectrum.averaged} stretches of {SPECTRUM_S:g} s averaged.", note


def sweep_of(
    blocks: Sequence[Block], axis: Axis, order: Order, method: Method, polynomial: int
) -> tuple[SweepRow, ...]:
    """Fit a model of one axis to the beginning of the flight at each window. polynomial: order of the filter."""
    dt_s, left, beginning = blocks[0].dt_s, MOST_ROWS, list[Block]()
    for block in blocks:
        beginning.append(block.rows(0, min(left, len(block))))
        left -= len(beginning[-1])

    def prepare(count: int) -> tuple[list[FloatArray], list[FloatArray]]:
        """u and y of each stretch that can train a model."""
        spec, us, ys = RateSpec.of(dt_s, count, polynomial), list[FloatArray](), list[FloatArray]()
        state = spec.start()
        for block in beginning:
            rates = spec.step(state, block)
            for first, stop in spans(rates.commanded):
                if (stop - first) * rates.dt_s >= MIN_PIECE_S:
                    us.append(rates.u[first:stop, axis.column])
                    ys.append(rates.y[first:stop, axis.column])
        return us, ys

    counts = sorted({max(round(span / dt_s) | 1, LEAST, polynomial + 1 | 1) for span in WINDOWS_S})
    return sweep(((order, count, prepare(count), None) for count in counts), dt=dt_s, method=method)


@picture("windows")
def windows_picture(sweeps: Mapping[Axis, Sequence[SweepRow]], dt_s: float, window_s: float) -> Drawn:
    """R_T^2 against the window, by axis. window_s: the baseline's."""
    known = {
        axis: [(row.window * dt_s, row.model.r2t) for row in rows if row.model]
        for axis, rows in sweeps.items()
        if any(row.model for row in rows)
    }
    if not known:
        reasons = {row.refused for rows in sweeps.values() for row in rows if row.refused}
        why = min(reasons, default="it takes attitude set-points and a model in the baseline")
        raise NotDrawn(f"no model could be fitted to this flight: {why}")
    figure = sheet(2.6)
    axes = figure.subplots()
    for line, (axis, fits) in zip(LINES, known.items(), strict=False):
        windows_s, r2t = np.transpose(fits)
        line.draw(axes, windows_s, r2t, axis.value, "o")
    label = f"baseline's window, {window_s:.3g} s"
    axes.axvline(window_s, color=style.COMMANDED.color, linestyle=style.COMMANDED.stroke, label=label)
    axes.set(xlabel="window [s]", ylabel="fit R_T² of the simulated rate", xscale="log", ylim=(None, 1.02))
    axes.set_xticks(WINDOWS_S, [f"{span:g}" for span in WINDOWS_S], minor=False)
    axes.minorticks_off()
    legend_above(axes)
    best = "; ".join(f"{axis}: best {max(fit for _, fit in fits):.3f}" for axis, fits in known.items())
    return figure, f"{best}.", ""


def _line(series: Series, column: int, factor: float, columns: int) -> tuple[FloatArray, FloatArray]:
    """One column in order of time, for a picture."""
    order = np.argsort(series.t_ns, kind="stable")
    return envelope(series.t_s[order], factor * series.values[order, column], columns)
