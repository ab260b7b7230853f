"""The signals of a flight as the log has them: attitude and height (T Fig 5.3 and 5.4), the steps of the gyro, the
spectrum of the accelerometer with the rotors' line and its harmonics (T Fig 3.14), and how the filter window changes
the fit of the model (T Fig 5.5)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify import Method, Order
from mavdiag.identify.lab.sweep import SweepRow, window_sweep
from mavdiag.look.figures import HARMONICS, SPECTRUM_S, Spectrum
from mavdiag.look.inspection import USUAL
from mavdiag.monitors.run_length import MIN_PIECE_S
from mavdiag.report import style
from mavdiag.report.style import COMMANDED, LINES, MEASURED, Picture, missing, panels, pictured
from mavdiag.report.thinned import COLUMNS, columns_of, envelope
from mavdiag.rows.block import Block
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.windows import spans
from mavdiag.telemetry import Axis, FloatArray, Series, Signal, Telemetry
from mavdiag.units import DEG, NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_HZ = 2.0  # of a spectrum: below it is the flight itself
NAMED_AT = ("data", "axes fraction")
WINDOWS_S = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
LEAST = 5  # samples: the shortest window of a parabola that smooths
MOST_ROWS = 20_000  # of the flight that are fitted: seven fits of an axis take about a second (our choice)


def height_picture(telemetry: Telemetry, columns: int = COLUMNS) -> Picture:
    """Height over time."""
    height = telemetry.get(Signal.HEIGHT)
    if height is None or not np.isfinite(height.values).any():
        return missing("height", "the log carries no height, and this tool reads no horizontal position")

    def plot(figure: "Figure") -> None:
        (axes,) = panels(figure, 1)
        MEASURED.draw(axes, *_line(height, 0, 1.0, columns))
        axes.set_ylabel("height [m]")

    lowest, highest = np.nanmin(height.values), np.nanmax(height.values)
    return pictured("height", f"From {lowest:.1f} to {highest:.1f} m.", plot, 1.9)


def attitude_picture(telemetry: Telemetry, columns: int = COLUMNS) -> Picture:
    """Roll and pitch over time, commanded and estimated, as far as the log carries them."""
    wanted = ((Signal.ATTITUDE_SETPOINT, COMMANDED, "commanded"), (Signal.ATTITUDE, MEASURED, "estimated"))
    there = [(telemetry.get(signal), line, name) for signal, line, name in wanted]
    shown = [(series, line, name) for series, line, name in there if series is not None and len(series) > 1]
    if not shown:
        return missing("attitude", "the log carries neither the commanded nor the estimated attitude")

    def plot(figure: "Figure") -> None:
        for column, (axes, angle) in enumerate(zip(panels(figure, 2), ("roll", "pitch"), strict=True)):
            for series, line, name in reversed(shown):
                line.draw(axes, *_line(series, column, 1 / DEG, columns), name)
            axes.set_ylabel(f"{angle} [°]")
        style.legend_above(figure.axes[0])

    most = ((name, np.nanmax(np.abs(series.values[:, :2]), axis=0, initial=0.0) / DEG) for series, _, name in shown)
    words = "; ".join(f"{name}: roll within {roll:.0f}°, pitch within {pitch:.0f}°" for name, (roll, pitch) in most)
    lacking = "" if len(shown) == 2 else f"This log carries the {shown[0][2]} angles only."
    return pictured("attitude", f"{words}.", plot, 3.2, note=lacking)


def link_picture(telemetry: Telemetry, columns: int = COLUMNS) -> Picture:
    """The longest step of the gyro in each column of the flight."""
    gyro = telemetry.get(Signal.BODY_RATE)
    if gyro is None or len(gyro) < 3:
        return missing("link", "the log carries no gyro")
    t_ns = np.unique(gyro.t_ns)
    if len(t_ns) < 3:
        return missing("link", "the gyro's samples have one time")
    steps, ends_s = np.diff(t_ns) / NS_PER_MS, t_ns[1:] / NS_PER_S
    _, first = columns_of(ends_s, columns)
    longest_ms, usual_ms = np.maximum.reduceat(steps, first), float(np.median(steps))
    most_ms = float(longest_ms.max())

    def plot(figure: "Figure") -> None:
        (axes,) = panels(figure, 1)
        MEASURED.draw(axes, ends_s[first], longest_ms)
        axes.set_ylabel("longest step [ms]")
        if most_ms > USUAL * usual_ms:
            style.plain_log(axes)
        else:
            axes.set_ylim(0.0, USUAL * usual_ms)

    return pictured("link", f"Longest step {most_ms:.1f} ms, usual {usual_ms:.2f} ms.", plot, 1.9)


def folded(hz: float, rate_hz: float) -> float:
    """Where a line is seen in a stream that is sampled at this rate.

    >>> folded(167.0, 1000.0), folded(167.0, 200.0)
    (167.0, 33.0)
    """
    return abs(hz - rate_hz * round(hz / rate_hz))


def spectrum_picture(
    spectrum: Spectrum | None, line: tuple[float, str] | None, corner_hz: float | None, rate_hz: float
) -> Picture:
    """The spectrum of the judged flight.

    line: one per revolution [Hz], and where it is known from. corner_hz: of the low-pass in the stream; None if there
    is none. rate_hz: of the samples.
    """
    if spectrum is None:
        why = f"no {SPECTRUM_S:g} s of flight without a break carries the accelerometer's x and y"
        return missing("spectrum", why)
    use = spectrum.frequency_hz >= LEAST_HZ
    hz, density = spectrum.frequency_hz[use], np.sqrt(spectrum.power[use])

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        LINES[0].draw(axes, hz, density[:, 0], "x, forward")
        LINES[1].draw(axes, hz, density[:, 1], "y, right")
        for k in range(1, HARMONICS + 1):
            if line is not None:
                at, name = folded(k * line[0], rate_hz), "rotors' line" if k == 1 else f"x{k}"
                axes.axvline(at, color="#000000", linestyle="--" if k == 1 else ":", linewidth=0.9, zorder=0)
                axes.annotate(name, (at, 1.0), (-3, -9), xycoords=NAMED_AT, textcoords="offset points", ha="right")
        axes.set(xlabel="frequency [Hz]", ylabel="acceleration\n[m/s²/√Hz]", xlim=(0, rate_hz / 2))
        style.plain_log(axes)
        style.legend_above(axes)

    note = "The rotors' speed is not known: neither log nor airframe tells it, and no line stands out."
    if line is not None:
        seen_hz = folded(line[0], rate_hz)
        fold = f", which {rate_hz:.0f} samples a second fold to {seen_hz:.0f} Hz"
        fold = "" if math.isclose(seen_hz, line[0]) else fold
        note = f"The line (dashed) is at {line[0]:.0f} Hz by {line[1]}{fold}."
    note += "" if corner_hz is None else f" This stream is low-passed at {corner_hz:g} Hz: above it little is left."
    words = f"Highest peak at {hz[density.max(axis=1).argmax()]:.0f} Hz. {spectrum.averaged} stretches of "
    return pictured("spectrum", f"{words}{SPECTRUM_S:g} s averaged.", plot, 2.7, note=note)


@dataclass(frozen=True, slots=True)
class Sweep:
    """One axis. rows: a candidate for each window, in order."""

    axis: Axis
    dt_s: float
    rows: tuple[SweepRow, ...]

    @property
    def known(self) -> tuple[tuple[float, float], ...]:
        """Window [s] and R_T^2 of those that could be fitted."""
        return tuple((row.window * self.dt_s, row.model.r2t) for row in self.rows if row.model is not None)


def sweep_of(blocks: Sequence[Block], axis: Axis, order: Order, method: Method, polynomial: int) -> Sweep:
    """Fit a model of one axis to the beginning of the flight at each window.

    blocks: one a segment. polynomial: order of the filter.
    """
    dt_s, left, beginning = blocks[0].dt_s, MOST_ROWS, list[Block]()
    for block in blocks:
        if left > 0:
            beginning.append(block.rows(0, min(left, len(block))))
            left -= len(beginning[-1])
    counts = sorted({max(round(span / dt_s) | 1, LEAST, polynomial + 1 | 1) for span in WINDOWS_S})
    rows: list[SweepRow] = []
    for count in counts:
        pieces = partial(_pieces, beginning, axis, RateSpec.of(dt_s, count, polynomial))
        try:
            rows += window_sweep(pieces, [count], dt=dt_s, order=order, method=method)
        except IdentificationError as error:
            rows.append(SweepRow(order, count, None, math.nan, str(error)))
    return Sweep(axis, dt_s, tuple(rows))


def windows_picture(sweeps: Sequence[Sweep], window_s: float) -> Picture:
    """R_T^2 against the window. window_s: the baseline's."""
    known = [sweep for sweep in sweeps if sweep.known]
    if not known:
        reasons = {row.refused for sweep in sweeps for row in sweep.rows if row.refused}
        why = min(reasons, default="it takes attitude set-points and a model in the baseline")
        return missing("windows", f"no model could be fitted to this flight: {why}")

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        for line, sweep in zip(LINES, known, strict=False):
            windows_s, fits = zip(*sweep.known, strict=True)
            line.draw(axes, windows_s, fits, sweep.axis.value, "o")
        label = f"baseline's window, {window_s:.3g} s"
        axes.axvline(window_s, color=COMMANDED.color, linestyle=COMMANDED.stroke, label=label)
        axes.set(xlabel="window [s]", ylabel="fit R_T² of the simulated rate", xscale="log", ylim=(None, 1.02))
        axes.set_xticks(WINDOWS_S, [f"{span:g}" for span in WINDOWS_S], minor=False)
        axes.minorticks_off()
        style.legend_above(axes)

    best = "; ".join(f"{sweep.axis}: best {max(y for _, y in sweep.known):.3f}" for sweep in known)
    return pictured("windows", f"{best}.", plot, 2.6)


def _line(series: Series, column: int, factor: float, columns: int) -> tuple[FloatArray, FloatArray]:
    """One column in order of time, for a picture."""
    order = np.argsort(series.t_ns, kind="stable")
    return envelope(series.t_s[order], factor * series.values[order, column], columns)


def _pieces(blocks: Sequence[Block], axis: Axis, spec: RateSpec, _: int) -> tuple[list[FloatArray], list[FloatArray]]:
    """u and y of each stretch that can train a model, filtered by this window."""
    state, out = spec.start(), []
    for block in blocks:
        state, rates = spec.step(state, block)
        for first, stop in spans(rates.commanded):
            if (stop - first) * rates.dt_s >= MIN_PIECE_S:
                out.append((rates.u[first:stop, axis.column], rates.y[first:stop, axis.column]))
    return [u for u, _ in out], [y for _, y in out]
