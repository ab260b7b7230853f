"""The pictures of one flight, from its `Sketch`: what happened when, each monitor that spoke, and the method's figures.

One quantity has one scale on a page: what `scaled` gives. captions.toml has titles, captions and the thesis's numbers.
"""

import math
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import cycle, pairwise

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.propellers import PROPELLERS, FaultType
from mavdiag.baseline import Baseline
from mavdiag.decision.diagnosis import Stage
from mavdiag.decision.words import OBSERVES
from mavdiag.identify import Method, Order
from mavdiag.identify.estimate import SweepRow, sweep
from mavdiag.judging import JudgedFlight
from mavdiag.link.messages import Autopilot, mode_name
from mavdiag.link.profiles import PROFILES
from mavdiag.look.figures import HARMONICS, SPECTRUM_S, Spectrum
from mavdiag.monitors.base import Feature
from mavdiag.monitors.run_length import training_pieces
from mavdiag.report.chart import FOLDER, Chart, Line, NotDrawn, Panel, Picture, columns_of, drawn, picture
from mavdiag.report.drawing import airframe_svg
from mavdiag.report.sketch import RateSketch, Sketch, SlotSketch
from mavdiag.rows.block import Block
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.savgol import MIN_WINDOW
from mavdiag.telemetry import Axis, FloatArray, Log, Signal, Telemetry
from mavdiag.units import DEG, NS_PER_S

NO_MODEL = "no axis could be compared with its model: it takes attitude set-points and the fsd monitor in the baseline"
CLASSIFIER = "qdrone2-emulated"  # the airframes that the classes hold for
MOST_POINTS = 200  # of the plane (our choice)
MOST_RUNS = 800  # in a line of FSD (our choice)
RISE = "fraction of hover"  # unit of the monitors that tell by how much each rotor is commanded more
LANES = 24  # of what was found, and when (our choice)
STAGES = {Stage.SUSPECTED: ("Suspected", "suspected"), Stage.FAULT: ("Fault declared", "fault")}
FLIGHT = (
    (Signal.HEIGHT, "height [m]", "above the take-off", 1.0),
    (Signal.THRUST_SETPOINT, "throttle [%]", "commanded", 100.0),
)
EXCESS = "highest residual above the margin [rad/s]"
NAMES = dict(zip(FaultType, ("F1 edge cut", "F2 crack", "F3 surface unbalance"), strict=True))
LOOKS = tuple(f"l{number}" for number in range(1, 9))  # lines of equal rank
LEAST_HZ = 2.0  # of a spectrum: below it is the flight itself
WINDOWS_S = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
LEAST_S = 0.5  # of a stretch that was not judged, for a page to name it (our choice)
JOINED_S = 1.0  # between two values of one judged stretch (our choice)
SHARES = ("fraction of ", "share of ")


def scaled(unit: str) -> tuple[float, str]:
    """The factor and the unit by which a page shows a statistic.

    >>> scaled("fraction of hover"), scaled("g mm")
    ((100.0, '% of hover'), (1.0, 'g mm'))
    """
    whole = next((unit.removeprefix(share) for share in SHARES if unit.startswith(share)), "")
    return (100.0, f"% of {whole}") if whole else (1.0, unit)


def name_of(monitor: str) -> str:
    """A monitor's name as words."""
    return monitor.replace("_", " ")


@picture("timeline")
def timeline(log: Log, judged: JudgedFlight, sketch: Sketch) -> Chart:
    """What was judged, suspected and declared, rotors that were named, alarms, flight modes: a lane for each."""
    held: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for words, look, begin_s, end_s in (*_held(judged, sketch), *_modes(log, sketch)):
        held.setdefault((words, look), []).append((begin_s, end_s))
    if not held:
        raise NotDrawn("nothing of this flight was judged, and the log tells no flight modes")
    lanes = [_lane(*what, spans) for what, spans in held.items()]
    left = f"{len(lanes) - LANES} further lanes are not shown." if len(lanes) > LANES else ""
    return Chart(lanes[:LANES], sketch.span, left, kind="follow")


def _held(judged: JudgedFlight, sketch: Sketch) -> Iterator[tuple[str, str, float, float]]:
    verdict = judged.verdict

    def ends(t_ns: int | None) -> float:
        return sketch.span[1] if t_ns is None else sketch.s(t_ns)

    yield from (("Judged", "quiet", *span) for span in _judged_spans(sketch))
    yield from (("Flown and not judged", "open", *span) for span in unjudged(judged, sketch))
    for change, after_ns in zip(verdict.changes, [*(one.t_ns for one in verdict.changes[1:]), None], strict=False):
        if change.stage in STAGES:
            yield *STAGES[change.stage], sketch.s(change.t_ns), ends(after_ns)
    for span in verdict.rotors:
        yield f"Rotor {span.rotor} named", "fault", sketch.s(span.since_ns), ends(span.end_ns)
    for event in verdict.events:
        name = " ".join(filter(None, (name_of(event.monitor), event.axis)))
        yield f"Alarm, {name}", "alarm", sketch.s(event.start_ns), ends(event.end_ns)


def _modes(log: Log, sketch: Sketch) -> Iterator[tuple[str, str, float, float]]:
    series, profile = log.telemetry.get(Signal.MODE), PROFILES.get(log.profile)
    if series is None or (profile is not None and profile.autopilot == Autopilot.GENERIC):
        return
    at = np.flatnonzero(np.diff(np.nan_to_num(series.values[:, 0], nan=-1.0), prepend=np.nan) != 0)
    ends = np.append(series.t_ns[at[1:]], sketch.begin_ns + round(sketch.span[1] * NS_PER_S))
    columns = (series.values[at, 0], series.t_ns[at], ends)
    for mode, begin_ns, end_ns in zip(*(column.tolist() for column in columns), strict=True):
        begin_s, end_s = max(sketch.s(begin_ns), 0.0), sketch.s(end_ns)
        if end_s > begin_s:
            name = "unknown" if math.isnan(mode) else mode_name(int(mode))
            yield f"Mode {name.replace('_', ' ')}", "faint", begin_s, end_s


def _judged_spans(sketch: Sketch) -> list[tuple[float, float]]:
    """Where a monitor that decides about propellers had a value, at least one in `JOINED_S` [s]."""
    values = [one.value for one in sketch.slots.values() if one.slot.of_propellers]
    if not values:
        return []
    at_s = values[0].step * np.flatnonzero(np.any([value.count > 0 for value in values], axis=0))
    edges = np.flatnonzero(np.diff(at_s) > JOINED_S)
    bounds = [0, *(edges + 1).tolist(), len(at_s)]
    return [(at_s[a], at_s[b - 1] + values[0].step) for a, b in pairwise(bounds) if b > a]


def unjudged(judged: JudgedFlight, sketch: Sketch) -> list[tuple[float, float]]:
    """Stretches of the flight that nothing about propellers judged, but for short ones [s]."""
    found = [(sketch.s(first), sketch.s(last)) for first, last in judged.unjudged]
    return [span for span in found if span[1] - span[0] >= LEAST_S]


def _lane(words: str, look: str, held: Sequence[tuple[float, float]]) -> Panel:
    bands = list[tuple[float, float, str]]()
    for begin, end in sorted(held):
        if bands and begin <= bands[-1][1]:  # they touch
            begin, end = bands[-1][0], max(end, bands.pop()[1])
        bands.append((begin, end, look))
    label = f"{words}: {bands[0][0]:.1f} to {bands[-1][1]:.1f} s" + f", {len(bands)} times" * (len(bands) > 1)
    return Panel(label, bands=bands, y=(0, 1), height=10, ticks=False)


@picture("flight")
def flight_picture(telemetry: Telemetry, sketch: Sketch) -> Chart:
    """Height and throttle: the climb, the flight and the landing."""
    panels = [
        Panel(label, [sketch.series(series, 0).line(name, factor=factor)], height=80)
        for signal, label, name, factor in FLIGHT
        if (series := telemetry.get(signal)) is not None and np.isfinite(series.values).any()
    ]
    if not panels:
        raise NotDrawn("the log carries neither height nor throttle")
    return Chart(panels, sketch.span)


def spoken(judged: JudgedFlight) -> list[str]:
    """The monitors that had an alarm or came to where a fault is suspected, the highest first; else the nearest one."""
    monitors = sorted(judged.verdict.monitors, key=lambda one: one.ratio, reverse=True)
    slots = () if judged.chain is None else judged.chain.slots
    least = {slot.monitor.name: slot.suspected for slot in slots}
    named = [one.name for one in monitors if one.alarms or one.ratio >= least.get(one.name, 1.0)]
    return named or [one.name for one in monitors if one.decides and one.maximum is not None][:1]


def monitor_picture(name: str, sketch: Sketch, baseline: Baseline) -> Picture | None:
    """What one monitor saw, beside what is usual in health; None if it judged nothing."""
    slots = [one for one in sketch.slots.values() if one.slot.monitor.name == name and one.value.count.any()]
    if not slots:
        return None
    usual = {(one.spec.kind, getattr(one.spec, "axis", None)): one.threshold.mean for one in baseline.monitors}
    panels, told = [], []
    for one in slots:
        monitor, (factor, unit) = one.slot.monitor, scaled(one.slot.monitor.unit)
        label = " ".join(filter(None, (monitor.axis, name_of(name)))) + (f" [{unit}]" if unit else "")
        healthy = min(factor * usual.get(one.slot.key, 0.0), factor * one.slot.threshold)
        lines = [one.value.line("this flight", factor=factor)]
        if monitor.unit == RISE and one.rotors:
            looks = enumerate(zip(one.rotors, cycle(LOOKS), strict=False), start=1)
            lines = [rotor.line(f"rotor {number}", look, factor) for number, (rotor, look) in looks]
        limit = factor * one.slot.threshold
        least, levels = None if len(lines) > 1 else 0.0, [(limit, f"threshold {limit:.3g}")]
        panels.append(Panel(label, lines, levels, healthy=healthy, y=(least, None), height=150))
        most = factor * float(np.nanmax(one.value.high))
        told.append(f"{label}: highest {most:.3g}, threshold {limit:.3g}, in health usually up to {healthy:.3g}")
    note = f"{'; '.join(told)}."
    chart = Chart(panels, sketch.span, note[:1].upper() + note[1:])
    return drawn("monitor", chart, f"{name_of(name)}: {OBSERVES.get(name, '')}")


@picture("evidence")
def evidence_picture(sketch: Sketch) -> Chart:
    """All monitors over the flight, strip by strip, those that judged any of it."""
    judged = [one for one in sketch.slots.values() if one.value.count.any()]
    if not judged:
        raise NotDrawn("no monitor judged any part of this flight")
    panels = []
    for one in judged:
        name, limit = name_of(" ".join(filter(None, one.slot.key))), one.slot.threshold
        high = float(np.nanmax(one.value.high)) / limit
        lines = [one.value.area("pale"), *([one.value.area("fault", limit)] if high > 1 else [])]
        label = f"{name}: up to {100 * high:.0f} % of its threshold"
        panels.append(Panel(label, lines, [(limit, "")], y=(0.0, 1.25 * limit), height=22, ticks=False))
    return Chart(panels, sketch.span, kind="follow")


def airframe_drawing(layout: RotorLayout, sketch: Sketch, named: Collection[int]) -> str:
    """The airframe with the highest rise of each rotor. named: rotors to be filled."""
    marks, rises = dict[int, tuple[str, str]](), told_rises(sketch)
    for number in range(1, layout.rotors + 1):
        label = "" if rises is None else f"{100 * float(np.nanmax(rises.rotors[number - 1].high)):+.1f} %"
        marks[number] = label, "fault" if number in named else ""
    told = f"named: {', '.join(map(str, named))}" if named else "no rotor is named"
    return airframe_svg(layout, marks, title=f"Airframe from above, the nose up: {told}")


def told_rises(sketch: Sketch) -> SlotSketch | None:
    """What tells by how much each rotor is commanded more, if that is worth telling: it passed its threshold."""
    known = (one for one in sketch.slots.values() if one.slot.monitor.feature == Feature.RISE and one.value.count.any())
    return next((one for one in known if np.nanmax(one.value.high) > one.slot.threshold), None)


@cache
def fault_classes() -> Mapping[FaultType, tuple[FloatArray, FloatArray]]:
    """Of each type: FSD [s] and residual above the margin [rad/s], (3, 3): by severity mean, 5 % and 95 % points."""
    found = tomllib.loads((FOLDER / "classes.toml").read_text(encoding="utf-8"))
    return {kind: (np.array(found[kind]["fsd_s"]), np.array(found[kind]["peak_rad_s"])) for kind in FaultType}


def longest_by_column(runs: FloatArray, columns: int) -> FloatArray:
    """Of the runs that end in one column of the picture the longest, (4, at most columns)."""
    if runs.shape[1] <= columns:
        return runs
    column, _ = columns_of(runs[1], float(runs[1, 0]), float(np.ptp(runs[1])) / columns or 1.0, columns)
    order = np.lexsort((runs[2], column))
    return runs[:, np.sort(order[np.append(np.diff(column[order]) > 0, True)])]


@picture("rates")
def rates_picture(sketch: Sketch) -> Chart:
    """Ten seconds of all modelled axes, about the longest FSD."""
    rates, (start_s, stop_s) = _judged(sketch), sketch.moment
    panels, kinds = [], ("commanded", "measured", "simulated")
    for number, rate in enumerate(rates):
        traces = [parts[number] for parts in sketch.shown]
        lines = []
        for kind in kinds:
            line = type(rate.residual)((start_s, stop_s), sketch.columns)
            for trace in traces:
                line.add((trace.t_ns - sketch.begin_ns) / NS_PER_S, getattr(trace, kind))
            lines.append(line.line("by the healthy model" if kind == "simulated" else kind, kind))
        panels.append(Panel(f"{rate.axis} rate [rad/s]", lines, height=150))
    rms = ", ".join(f"{one.axis} by {math.sqrt(one.squares / one.judged):.3f} rad/s" for one in rates)
    shown = f"Shown are {start_s:.1f} to {stop_s:.1f} s of the flight, about the longest FSD."
    return Chart(panels, (start_s, stop_s), f"{shown} Simulated and measured differ over the flight: {rms} rms.")


@picture("residual")
def residual_picture(sketch: Sketch) -> Chart:
    """The residual of all modelled axes over the flight, and where FSD exceeds FML."""
    panels, told = [], []
    for rate in _judged(sketch):
        margin, runs = rate.margin_rad_s, longest_by_column(rate.runs, MOST_RUNS)
        bands = [(begin, end, "alarm") for begin, end, fsd_s, _ in runs.T.tolist() if fsd_s > rate.fml_s]
        levels = [(margin, f"margin ±{margin:.3g}"), (-margin, "")]
        line = rate.residual.line("where judged")
        panels.append(Panel(f"{rate.axis} residual [rad/s]", [line], levels, bands=bands, height=150))
        share = 100 * rate.outside / rate.judged
        told.append(f"{rate.axis} {share:.0f} %")
    return Chart(panels, sketch.span, f"It was outside for so much of the judged time: {', '.join(told)}.")


@picture("fsd")
def fsd_picture(sketch: Sketch) -> Chart:
    """The runs of all modelled axes over the flight."""
    panels = []
    for rate in _judged(sketch):
        _, end_s, fsd_s, _ = longest_by_column(rate.runs, MOST_RUNS)
        longer = fsd_s > rate.fml_s
        lines = [Line(end_s, fsd_s, "a run's FSD", "measured", "bars")]
        lines += [Line(end_s[longer], fsd_s[longer], "FSD > FML", "fault", "dots")] if longer.any() else []
        levels = [(rate.fml_s, f"FML {rate.fml_s:.3f}")]
        panels.append(Panel(f"{rate.axis} FSD [s]", lines, levels, y=(0.0, None)))
    return Chart(panels, sketch.span)


@picture("plane")
def plane_picture(sketch: Sketch, classifier: str | None) -> Chart:
    """The runs of the first modelled axis that judged; classes only for an airframe that they hold for."""
    rate, known = _judged(sketch)[0], classifier == CLASSIFIER
    if not rate.runs.size and not known:
        raise NotDrawn("the residual never left its margin, and no classes are known for this airframe")
    few = longest_by_column(rate.runs, MOST_POINTS)
    lines = [Line(few[2], few[3], "runs of this flight", "faint", "dots")]
    for look, kind in zip(LOOKS, FaultType if known else (), strict=False):
        (x, x_low, x_high), (y, y_low, y_high) = (of.T for of in fault_classes()[kind])
        lines.append(Line(x, y, NAMES[kind], f"{look} big", "dots"))
        lines += [errors(x_low, x_high, y, y, look), errors(x, x, y_low, y_high, look)]
    if rate.runs.size:
        fsd_s, peak = rate.longest[2:, None]
        lines.append(Line(fsd_s, peak, "longest of this flight", "star", "dots"))
    right = 1.05 * float(np.nanmax(np.concatenate([[rate.fml_s], *(line.x for line in lines)])))
    note = "No classes are shown, for they are known for the emulated QDrone 2 alone."
    if known:
        note = "The class that it lies nearest to is the thesis's answer; the classes are of the emulated QDrone 2."
    panel = Panel(EXCESS, lines, marks=[(rate.fml_s, f"FML {rate.fml_s:.3f} s")], y=(0.0, None), height=220)
    return Chart([panel], (0.0, right), note, f"FSD, {rate.axis} [s]", kind="still")


def errors(x_low: FloatArray, x_high: FloatArray, y_low: FloatArray, y_high: FloatArray, look: str) -> Line:
    """Bars of error from one end to the other."""
    gap = np.full(len(x_low), np.nan)
    x, y = (np.stack(ends, axis=1).ravel() for ends in ((x_low, x_high, gap), (y_low, y_high, gap)))
    return Line(x, y, look=f"{look} thin")


@picture("severity")
def severity_picture(sketch: Sketch, since_s: float | None, classifier: str | None) -> Chart:
    """Unbalance and residual of the flight among the classes. since_s: when a fault was declared; None if none was."""
    rate, unbalance = _judged(sketch)[0], unbalance_of(sketch, since_s)
    if classifier != CLASSIFIER:
        raise NotDrawn("its severities are known for the emulated QDrone 2 alone")
    if unbalance is None:
        raise NotDrawn("the unbalance of this flight was not measured in g mm: see the table of monitors")
    peak, lines = float(rate.longest[3]), []
    for look, kind in zip(LOOKS, FaultType, strict=False):
        x = np.array([row.unbalance_g_mm for row in PROPELLERS if row.fault_type is kind])
        y = fault_classes()[kind][1][:, 0]
        lines += [Line(x, y, NAMES[kind], look), Line(x, y, "", f"{look} big", "dots")]
    lines.append(Line(np.array([unbalance]), np.array([peak]), "this flight", "star", "dots"))
    right = 1.05 * max(float(line.x.max()) for line in lines)
    panel = Panel(EXCESS, lines, y=(0.0, None), height=220)
    return Chart([panel], (0.0, right), x_label="unbalance [g mm]", kind="still")


def unbalance_of(sketch: Sketch, since_s: float | None) -> float | None:
    """Rms of the unbalance beyond the healthy one, since a time or of the flight [g mm]; None if it is not known."""
    for one in sketch.slots.values():
        if one.slot.monitor.name == "unbalance" and one.slot.monitor.unit == "g mm":
            mean = one.squares.mean(since_s)
            return math.sqrt(mean) if math.isfinite(mean) else None
    return None


def _judged(sketch: Sketch) -> list[RateSketch]:
    found = [rate for rate in sketch.rates.values() if rate.judged]
    if not found:
        raise NotDrawn(NO_MODEL)
    return found


@picture("attitude")
def attitude_picture(telemetry: Telemetry, sketch: Sketch) -> Chart:
    """Roll and pitch over time, commanded and estimated, as far as the log carries them."""
    wanted = ((Signal.ATTITUDE, "measured", "estimated"), (Signal.ATTITUDE_SETPOINT, "commanded", "commanded"))
    there = [(telemetry.get(signal), look, name) for signal, look, name in wanted]
    shown = [(series, look, name) for series, look, name in there if series is not None and len(series) > 1]
    if not shown:
        raise NotDrawn("the log carries neither the commanded nor the estimated attitude")
    panels = [
        Panel(f"{angle} [°]", [sketch.series(series, column).line(name, look, 1 / DEG) for series, look, name in shown])
        for column, angle in enumerate(("roll", "pitch"))
    ]
    note = "" if len(shown) == 2 else f"This log has {shown[0][2]} angles only."
    return Chart(panels, sketch.span, note)


def folded(hz: float, rate_hz: float) -> float:
    """Fold a frequency into a stream that is sampled at this rate.

    >>> folded(167.0, 1000.0), folded(167.0, 200.0)
    (167.0, 33.0)
    """
    return abs(hz - rate_hz * round(hz / rate_hz))


@picture("spectrum")
def spectrum_picture(
    spectrum: Spectrum | None, line: tuple[float, str] | None, corner_hz: float | None, rate_hz: float
) -> Chart:
    """The spectrum of the judged flight. line: one per revolution [Hz], and where it is known from."""
    if spectrum is None:
        raise NotDrawn(f"no {SPECTRUM_S:g} s of flight without a break carries the accelerometer's x and y")
    use = spectrum.frequency_hz >= LEAST_HZ
    hz, density = spectrum.frequency_hz[use], np.sqrt(spectrum.power[use])
    lines = [Line(hz, density[:, 0], "x, forward", "l1"), Line(hz, density[:, 1], "y, right", "l2")]
    note, marks = "The rotors' speed is not known: neither log nor airframe tells it, and no line stands out.", []
    if line is not None:
        seen_hz = folded(line[0], rate_hz)
        names = ("rotors", *(f"x{k}" for k in range(2, HARMONICS + 1)))
        marks = [(folded(k * line[0], rate_hz), name) for k, name in enumerate(names, start=1)]
        fold = f", which {rate_hz:.0f} samples a second fold to {seen_hz:.0f} Hz"
        fold = "" if math.isclose(seen_hz, line[0]) else fold
        note = f"The line (upright) is at {line[0]:.0f} Hz by {line[1]}{fold}."
    note += "" if corner_hz is None else f" This stream is low-passed at {corner_hz:g} Hz: above it little is left."
    note += f" The highest peak is at {hz[density.max(axis=1).argmax()]:.0f} Hz."
    panel = Panel("acceleration [m/s²/√Hz]", lines, marks=marks, height=200, log=True)
    return Chart([panel], (0.0, rate_hz / 2), note, "frequency [Hz]", kind="still")


def sweep_of(
    blocks: Sequence[Block], axis: Axis, order: Order, method: Method, polynomial: int
) -> tuple[SweepRow, ...]:
    """Fit a model of one axis to these rows of a flight at each window. polynomial: order of the filter."""
    dt_s = blocks[0].dt_s

    def prepare(count: int) -> tuple[list[FloatArray], list[FloatArray]]:
        spec = RateSpec.of(dt_s, count, polynomial)
        state = spec.start()
        rows = [spec.step(state, replace(block, whole=block.x.copy(), first=0)) for block in blocks]
        pieces = training_pieces(rows, axis)
        return [u for u, _ in pieces], [y for _, y in pieces]

    counts = sorted({max(round(span / dt_s) | 1, MIN_WINDOW, polynomial + 1 | 1) for span in WINDOWS_S})
    return sweep(((order, count, prepare(count), None) for count in counts), dt=dt_s, method=method)


@picture("windows")
def windows_picture(sweeps: Mapping[Axis, Sequence[SweepRow]], dt_s: float, window_s: float) -> Chart:
    """R_T^2 against the window, by axis. window_s: the baseline's."""
    found = {axis: [(row.window * dt_s, row.model.r2t) for row in of if row.model] for axis, of in sweeps.items()}
    known = {axis: fits for axis, fits in found.items() if fits}
    if not known:
        reasons = {row.refused for rows in sweeps.values() for row in rows if row.refused}
        why = min(reasons, default="it takes attitude set-points and a model in the baseline")
        raise NotDrawn(f"no model could be fitted to this flight: {why}")
    lines = list[Line]()
    for look, (axis, fits) in zip(LOOKS, known.items(), strict=False):
        at, r2t = np.log10([window for window, _ in fits]), np.array([fit for _, fit in fits])
        lines += [Line(at, r2t, axis.value, look), Line(at, r2t, "", f"{look} big", "dots")]
    ends = [math.log10(at) for fits in known.values() for at, _ in fits] + [math.log10(window_s)]
    ticks = [(math.log10(span), f"{span:g}") for span in WINDOWS_S if min(ends) - 0.05 <= math.log10(span)]
    marks = [(math.log10(window_s), f"baseline, {window_s:.3g} s")]
    panel = Panel("fit R_T² of the simulated rate", lines, marks=marks, y=(None, 1.02), height=180)
    across = (min(ends) - 0.05, max([*ends, ticks[-1][0]]) + 0.05)
    return Chart([panel], across, x_label="window [s]", ticks=ticks, kind="still")
