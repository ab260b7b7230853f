"""The signals of a flight: attitude and height (T Fig 5.3, 5.4), the spectrum of the accelerometer with the rotors'
line and its harmonics (T Fig 3.14), and how the filter window changes the fit of the model (T Fig 5.5)."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mavdiag.identify import Method, Order
from mavdiag.identify.lab.sweep import SweepRow, window_sweep
from mavdiag.look.figures import HARMONICS, SPECTRUM_S, Spectrum
from mavdiag.monitors.run_length import MIN_PIECE_S
from mavdiag.report import style
from mavdiag.report.style import COLUMNS, LINES, MEASURED, Drawn, NotDrawn, envelope, panels, picture, sheet
from mavdiag.rows.block import Block
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.windows import spans
from mavdiag.telemetry import Axis, FloatArray, Series, Signal, Telemetry
from mavdiag.units import DEG

LEAST_HZ = 2.0  # of a spectrum: below it is the flight itself
NAMED_AT = ("data", "axes fraction")
WINDOWS_S = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
LEAST = 5  # samples: the shortest window of a parabola that smooths
MOST_ROWS = 20_000  # of the flight that are fitted: seven fits of an axis take about a second (our choice)


@picture("height")
def height_picture(telemetry: Telemetry, columns: int = COLUMNS) -> Drawn:
    """Height over time."""
    height = telemetry.get(Signal.HEIGHT)
    if height is None or not np.isfinite(height.values).any():
        raise NotDrawn("the log carries no height, and this tool reads no horizontal position")
    figure, (axes,) = panels(1.9)
    MEASURED.draw(axes, *_line(height, 0, 1.0, columns))
    axes.set_ylabel("height [m]")
    return figure, f"From {np.nanmin(height.values):.1f} to {np.nanmax(height.values):.1f} m.", ""


@picture("attitude")
def attitude_picture(telemetry: Telemetry, columns: int = COLUMNS) -> Drawn:
    """Roll and pitch over time, commanded and estimated, as far as the log carries them."""
    wanted = ((Signal.ATTITUDE_SETPOINT, style.COMMANDED, "commanded"), (Signal.ATTITUDE, MEASURED, "estimated"))
    there = [(telemetry.get(signal), line, name) for signal, line, name in wanted]
    shown = [(series, line, name) for series, line, name in there if series is not None and len(series) > 1]
    if not shown:
        raise NotDrawn("the log carries neither the commanded nor the estimated attitude")
    figure, several = panels(3.2, 2)
    for column, (axes, angle) in enumerate(zip(several, ("roll", "pitch"), strict=True)):
        for series, line, name in reversed(shown):
            line.draw(axes, *_line(series, column, 1 / DEG, columns), name)
        axes.set_ylabel(f"{angle} [°]")
    style.legend_above(several[0])
    most = ((name, np.nanmax(np.abs(series.values[:, :2]), axis=0, initial=0.0) / DEG) for series, _, name in shown)
    words = "; ".join(f"{name}: roll within {roll:.0f}°, pitch within {pitch:.0f}°" for name, (roll, pitch) in most)
    return figure, f"{words}.", "" if len(shown) == 2 else f"This log carries the {shown[0][2]} angles only."


def folded(hz: float, rate_hz: float) -> float:
    """Where a line is seen in a stream that is sampled at this rate.

    >>> folded(167.0, 1000.0), folded(167.0, 200.0)
    (167.0, 33.0)
    """
    return abs(hz - rate_hz * round(hz / rate_hz))


@picture("spectrum")
def spectrum_picture(
    spectrum: Spectrum | None, line: tuple[float, str] | None, corner_hz: float | None, rate_hz: float
) -> Drawn:
    """The spectrum of the judged flight.

    line: one per revolution [Hz], and where it is known from. corner_hz: of the low-pass in the stream; None if there
    is none. rate_hz: of the samples.
    """
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
    style.plain_log(axes)
    style.legend_above(axes)
    note += "" if corner_hz is None else f" This stream is low-passed at {corner_hz:g} Hz: above it little is left."
    peak = f"Highest peak at {hz[density.max(axis=1).argmax()]:.0f} Hz."
    return figure, f"{peak} {spectrum.averaged} stretches of {SPECTRUM_S:g} s averaged.", note


def sweep_of(
    blocks: Sequence[Block], axis: Axis, order: Order, method: Method, polynomial: int
) -> tuple[SweepRow, ...]:
    """Fit a model of one axis to the beginning of the flight at each window; a row for each, in order.

    blocks: one a segment. polynomial: order of the filter.
    """
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
    return window_sweep(prepare, counts, dt=dt_s, order=order, method=method)


@picture("windows")
def windows_picture(sweeps: Mapping[Axis, Sequence[SweepRow]], dt_s: float, window_s: float) -> Drawn:
    """R_T^2 against the window, by axis. dt_s: period of the rows. window_s: the baseline's."""
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
    style.legend_above(axes)
    best = "; ".join(f"{axis}: best {max(fit for _, fit in fits):.3f}" for axis, fits in known.items())
    return figure, f"{best}.", ""


def _line(series: Series, column: int, factor: float, columns: int) -> tuple[FloatArray, FloatArray]:
    """One column in order of time, for a picture."""
    order = np.argsort(series.t_ns, kind="stable")
    return envelope(series.t_s[order], factor * series.values[order, column], columns)
