"""`mavdiag model`: what a control engineer asks of a model, from a baseline or fitted to a log.

`mavdiag model FILE` shows it; `sweep`, `compare` and `track` are the lab's tools on a log.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import typer
from typer import Argument, Option

from mavdiag.archive.paths import check_output
from mavdiag.as_json import json_line, plain
from mavdiag.baseline import Baseline
from mavdiag.commandline import application, say
from mavdiag.commands import options as opt
from mavdiag.commands.progress import working
from mavdiag.errors import BaselineError, IdentificationError, UsageError
from mavdiag.face import FlightRates, rates, read_log
from mavdiag.identify import ArxModel, Method, ModelRecord, fit, lab
from mavdiag.identify.estimate import ORDERS, Flights, ResidualReport, best_row, examine_residual, validate
from mavdiag.identify.estimate import sweep as fit_each
from mavdiag.identify.lab import Figure, ModelFigures, draw_model, model_figures
from mavdiag.monitors.run_length import RunLengthSpec
from mavdiag.rows.savgol import MIN_WINDOW
from mavdiag.storage import begins
from mavdiag.telemetry import Axis

SETTLE_S = 1.0  # of each stretch that the fit figures leave out: it may begin in motion
WINDOWS_S = (0.02, 0.05, 0.1, 0.2, 0.4)
SHOWN_ROWS = 12
SAME_RATE = 0.02  # by which two rates may differ and be called one (our choice)
RESPONSE_WINDOW_S = 2.0  # of the frequency-response estimate: lines 0.5 Hz apart (our choice)
PASSED = 0.5  # cycles a window: above it the slope and the smoothing filter no longer pass alike (our choice)


app = application("Look at a model: `model FILE` shows that of a baseline, or fits one to a log.", show_by_default=True)

LogFile: TypeAlias = Annotated[Path, Argument(metavar="LOG", help="Log of a flight.")]
OneAxis: TypeAlias = Annotated[Axis, Option(help="Body axis.")]
Methods: TypeAlias = Annotated[opt.MethodChoice, Option("--method", help="How the model is fitted.")]


@app.command()
def show(
    file: Annotated[Path, Argument(metavar="BASELINE|LOG", help="Baseline, or log to fit a model to.")],
    axis: Annotated[opt.AxisChoice, Option(help="Axes to show.")] = "both",
    order: opt.Orders = "2,2,1",
    method: Methods = "sriv",
    window: opt.WindowS = 0.1,
    vehicle: opt.Vehicle = None,
    plot: Annotated[Path | None, Option(metavar="FILE.svg", help="Draw Bode, step response, poles, residual.")] = None,
    as_json: opt.AsJson = False,
) -> None:
    """Print poles, damping, bandwidth, margins and DC gain with standard errors. Options of the fit are for a log."""
    if plot is not None:
        check_output(plot, file)
    flights: dict[Axis, FlightRates] = {}
    if begins(file, rb"\s*\{"):  # as JSON does, and no log
        specs = (entry.spec for entry in Baseline.load(file).monitors)
        known = {spec.axis: spec.model for spec in specs if isinstance(spec, RunLengthSpec)}
        if not known:
            why = "the baseline has no fsd monitor, so no model; `mavdiag model LOG` fits one to a flight"
            raise BaselineError(why)
        models = {name: record.model() for name, record in known.items() if name in opt.axes_of(axis)}
        if not models:
            raise UsageError(f"{file}: has no model of the {axis} axis; choose another --axis")
    else:
        log = read_log(file, vehicle=vehicle)
        flights = {name: rates(log, name, window) for name in opt.axes_of(axis)}
        models = {name: _fitted(flight, order, method) for name, flight in flights.items()}
    for name, model in models.items():
        figures = model_figures(model)
        told = {"axis": name, **asdict(ModelRecord.of(model)), **asdict(figures)}
        typer.echo(json_line(told) if as_json else _text_of(name, model, figures))
        if plot is not None:
            path = plot if len(models) == 1 else plot.with_stem(f"{plot.stem}-{name}")
            shown = (_residual(model, flights[name]), _response(flights[name], window)) if flights else (None, None)
            draw_model(path, model, f"{file.name}, {name}", residual=shown[0], measured=shown[1])
            say(f"written to {path}", err=True)


@app.command()
def sweep(
    log: LogFile,
    over: Annotated[Literal["order", "window"], Option(help="What to vary (T 5.3, 5.4).")] = "order",
    axis: OneAxis = Axis.ROLL,
    validation: Annotated[
        Path | None, Option("--validate", metavar="LOG", help="Another flight, that decides.")
    ] = None,
    order: opt.Orders = "2,2,1",
    method: Methods = "sriv",
    window: opt.WindowS = 0.1,
    vehicle: opt.Vehicle = None,
    as_json: opt.AsJson = False,
) -> None:
    """Fit one model for each order or filter window; the best fit with the best known parameters is marked."""
    train = read_log(log, vehicle=vehicle)
    other = None if validation is None else read_log(validation, vehicle=vehicle)
    dt_s, chosen = rates(train, axis).dt_s, opt.parse_order(order)
    if other is not None and not math.isclose(rates(other, axis).dt_s, dt_s, rel_tol=SAME_RATE):
        raise UsageError(f"{validation}: its rate is not that of {log}; give --validate a flight of the same rate")

    def flights(window_s: float) -> tuple[Flights, Flights | None]:
        held_out = None if other is None else rates(other, axis, window_s)
        return rates(train, axis, window_s)[:2], held_out and held_out[:2]

    with working("fitting a model for each; this takes a minute or more ..."):
        if over == "order":
            smoothed = flights(window)
            rows = fit_each(((one, 0, *smoothed) for one in ORDERS), dt=dt_s, method=method)
        else:
            counts = sorted({max(round(seconds / dt_s) | 1, MIN_WINDOW) for seconds in WINDOWS_S})
            rows = fit_each(((chosen, n, *flights(n * dt_s)) for n in counts), dt=dt_s, method=method)
    best = best_row(rows)
    known = sorted((row for row in rows if row.model), key=lambda row: (row is best, row.score), reverse=True)
    lines = []
    for row in rows if as_json else known[:SHOWN_ROWS]:
        fitted = {name: getattr(row.model, name, None) for name in ("r2t", "yic")}
        line = {"order": ",".join(map(str, row.order)), "window": row.window or None}
        line |= plain({**fitted, "r2t_validation": row.r2t_validation}) | {"best": row is best}
        lines.append(line | ({"refused": row.refused} if row.refused else {}))
    _print(lines, as_json=as_json)
    if not as_json:
        typer.echo(f"{len(rows) - len(known)} of {len(rows)} could not be identified; --json prints all, with reasons")


@app.command(name="compare")
def compare_models(
    log: LogFile,
    axis: OneAxis = Axis.ROLL,
    order: opt.Orders = "2,2,1",
    method: Methods = "sriv",
    window: opt.WindowS = 0.1,
    vehicle: opt.Vehicle = None,
    as_json: opt.AsJson = False,
) -> None:
    """Compare the fit, and the thesis's published model, with the frequency response that the data show."""
    flight = rates(read_log(log, vehicle=vehicle), axis, window)
    models = {f"fit {method} {order}": _fitted(flight, order, method)}
    if axis in lab.PUBLISHED and math.isclose(flight.dt_s, lab.ASSUMED_DT_S, rel_tol=SAME_RATE):
        source, printed = lab.PUBLISHED[axis]
        models[source] = printed
    measured = _response(flight, window)
    if measured is None:
        raise IdentificationError(f"{log}: no stretch of {2 * RESPONSE_WINDOW_S:g} s; record a longer flight")
    lines = []
    for name, model in models.items():
        gap, fitness = lab.compare(measured, model), validate(model, flight.u, flight.y, SETTLE_S)
        lines.append({"model": name, "r2t": fitness.r2t, **asdict(gap)})
    _print(lines, as_json=as_json)
    if len(models) == 1 and not as_json:
        typer.echo(f"the thesis's models are of roll and pitch at 1 kHz; this is {axis} at {1 / flight.dt_s:.0f} Hz")


@app.command()
def track(
    log: LogFile,
    axis: OneAxis = Axis.ROLL,
    every: Annotated[float, Option(metavar="S", help="Flight time between two lines.")] = 5.0,
    memory: Annotated[float, Option(metavar="S", help="Memory of the estimate.")] = 10.0,
    order: opt.Orders = "2,2,1",
    window: opt.WindowS = 0.1,
    vehicle: opt.Vehicle = None,
    as_json: opt.AsJson = False,
) -> None:
    """Follow the model through a flight by recursive least squares with forgetting: does the airframe change?

    The estimate has the bias of least squares under noise: look at its changes, not at its values.
    """
    flight = rates(read_log(log, vehicle=vehicle), axis, window)
    chosen = opt.parse_order(order)
    least_s = sum(chosen[:2]) * flight.dt_s
    if not (every >= flight.dt_s and memory > least_s):
        raise UsageError(f"--every and --memory must be longer than {flight.dt_s:g} and {least_s:g} s for this order")
    count, lines = max(1, round(every / flight.dt_s)), []
    told = {"dt": flight.dt_s, "forgetting": 1.0 - flight.dt_s / memory}
    for flown, model in lab.track(flight.u, flight.y, chosen, every=count, **told):
        found = model_figures(model)
        figures = {"pole_hz": found.poles[0].natural_hz, "damping": found.poles[0].damping}  # of the slowest
        line = {"flight_s": round(flown * flight.dt_s, 3), "dc_gain": found.dc_gain}
        lines.append({**line, **figures, "stable": model.stable})
    _print(lines, as_json=as_json)


def _fitted(flight: FlightRates, order: str, method: opt.MethodChoice) -> ArxModel:
    return fit(flight.u, flight.y, opt.parse_order(order), dt=flight.dt_s, method=Method(method), settle_s=SETTLE_S)


def _residual(model: ArxModel, flight: FlightRates) -> ResidualReport:
    """Tests of the residual over the longest stretch: y - y_sim, or for LS the one-step error, which it makes white."""
    u, y = max(zip(flight.u, flight.y, strict=True), key=lambda pair: len(pair[0]))
    if model.method is Method.LS:
        return examine_residual(y[model.lag :] - model.predict(u, y), u[model.lag :])
    settled = round(SETTLE_S / model.dt)
    return examine_residual((y - model.simulate(u))[settled:], u[settled:])


def _response(flight: FlightRates, window_s: float) -> lab.FrequencyResponse | None:
    """The measured frequency response, as far as the filters pass it; None if the flight is too short for one."""
    segment = round(RESPONSE_WINDOW_S / flight.dt_s)
    if max(map(len, flight.u)) < 2 * segment:
        return None
    return lab.estimate_response(flight.u, flight.y, dt=flight.dt_s, segment=segment, most_hz=PASSED / window_s)


def _text_of(axis: Axis, model: ArxModel, figures: ModelFigures) -> str:
    order = ",".join(map(str, model.order))
    lines = [f"{axis}: {model.method} {order}, {1 / model.dt:.1f} Hz, R_T2 {model.r2t:.4f}, {model.samples} samples"]
    for pole in figures.poles:
        place = _text(pole.real) + (f" ± j ({_text(pole.imaginary)})" if pole.imaginary.value else "")
        lines.append(f"  pole            {place}: {_text(pole.natural_hz)} Hz, damping {_text(pole.damping)}")
    rows = [("DC gain", figures.dc_gain, ""), ("bandwidth", figures.bandwidth_hz, " Hz (-3 dB)")]
    rows += [("gain margin", figures.gain_margin_db, " dB"), ("phase margin", figures.phase_margin_deg, " °")]
    rows.append(("modulus margin", figures.modulus_margin, ""))
    lines += [f"  {name:<15} {_text(figure)}{unit}" for name, figure, unit in rows]
    lines.append("  margins are of the loop that unit feedback closes to this model")
    return "\n".join([*lines, f"  standard errors from {figures.errors_from}"])


def _text(figure: Figure) -> str:
    """A figure with its standard error, to the digits that the error leaves."""
    if figure.value is None:
        return "none"
    if not figure.standard_error:
        return f"{figure.value:.4g}"
    places = min(max(0, 1 - math.floor(math.log10(figure.standard_error))), 9)
    return f"{figure.value:.{places}f} ± {figure.standard_error:.{places}f}"


def _print(lines: Sequence[Mapping[str, Any]], *, as_json: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    if as_json:
        return typer.echo("\n".join(map(json_line, lines)))
    table = Table(*(lines[0] if lines else ()), box=None, padding=(0, 2, 0, 0))
    for line in lines:
        table.add_row(*map(_cell, line.values()))
    return Console(highlight=False).print(table)


def _cell(value: object) -> str:
    if isinstance(value, bool) or value is None:
        return "yes" if value else "-"
    return _text(value) if isinstance(value, Figure) else f"{value:.4f}" if isinstance(value, float) else str(value)
