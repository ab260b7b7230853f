"""`mavdiag identify`: healthy flights to a baseline."""

import datetime
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from mavdiag.baseline import Baseline
from mavdiag.commands.baseline import describe
from mavdiag.commands.options import AxisChoice, MethodChoice, parse_order, read_part
from mavdiag.learning import ALL_MONITORS, Flight, LearnOptions, learn
from mavdiag.monitors.margin import MarginRule
from mavdiag.storage import save_baseline
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, ThresholdRule, flights_for_guarantee, more_flights

__all__ = ["identify", "make_baseline"]


def identify(
    logs: Annotated[list[Path], typer.Argument(help="Logs of healthy flights: .tlog, .bin, .ulg, Crazyflie.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Baseline file to write.")],
    method: Annotated[MethodChoice, typer.Option(help="sriv is unbiased under noise.")] = MethodChoice.SRIV,
    order: Annotated[str, typer.Option(metavar="NA,NB,NK", help="Model order.")] = "2,2,1",
    axis: Annotated[AxisChoice, typer.Option(help="Axes to model and to watch.")] = AxisChoice.ROLL,
    window: Annotated[float, typer.Option(metavar="S", help="Savitzky-Golay window.")] = 0.1,
    margin: Annotated[MarginRule, typer.Option(help="Margin on |r|.")] = MarginRule.PERCENTILE_90,
    monitors: Annotated[
        str, typer.Option(metavar="NAMES", help=f"Comma-separated: {', '.join(ALL_MONITORS)}; or all, or thesis.")
    ] = "all",
    alarms_per_hour: Annotated[
        float, typer.Option(metavar="X", help="False-alarm budget of all monitors together.")
    ] = BUDGET_PER_HOUR,
    rule: Annotated[
        ThresholdRule, typer.Option(help="Thresholds by the budget, or the healthy maximum.")
    ] = ThresholdRule.GUMBEL,
    frame: Annotated[str | None, typer.Option(help="Rotor layout.  [default: found from the flights]")] = None,
    airframe: Annotated[str, typer.Option(help="Name of the airframe or type.")] = "unnamed",
    fleet: Annotated[bool, typer.Option("--fleet", help="The logs are of several vehicles of one type.")] = False,
    vehicle: Annotated[int | None, typer.Option(metavar="SYSID", help="System id to read from a .tlog.")] = None,
    from_s: Annotated[float | None, typer.Option("--from", metavar="S", help="Vehicle time to start at.")] = None,
    to_s: Annotated[float | None, typer.Option("--to", metavar="S", help="Vehicle time to stop at.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the baseline as JSON.")] = False,
) -> None:
    """Fit a baseline to healthy flights, and say what its alarms will cost."""
    thesis = monitors == "thesis"
    options = LearnOptions(
        axes=axis.axes,
        method=method.method,
        order=parse_order(order),
        window_s=window,
        margin_rule=margin,
        airframe=airframe,
        scope="type" if fleet else "airframe",
        monitors=("latency",) if thesis else ALL_MONITORS if monitors == "all" else tuple(monitors.split(",")),
        rule=ThresholdRule.MAXIMUM if thesis else rule,
        alarms_per_hour=alarms_per_hour,
        frame=frame,
    )
    baseline = make_baseline(logs, options, vehicle=vehicle, from_s=from_s, to_s=to_s)
    save_baseline(output, baseline)
    if as_json:
        typer.echo(json.dumps(baseline.model_dump(mode="json", by_alias=True)))
    else:
        _print(baseline, output)


def make_baseline(
    logs: Sequence[Path],
    options: LearnOptions,
    *,
    vehicle: int | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
) -> Baseline:
    """A baseline from log files, stamped with the time of now. Raises InputError or IdentificationError."""
    flights = []
    for path in logs:
        log = read_part(path, vehicle, from_s, to_s)
        flights.append(Flight(str(path), log.sha256, log.profile, log.telemetry))
    return learn(flights, options, created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"))


def _print(baseline: Baseline, path: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{path}: {baseline.airframe.name}, {baseline.link.profile} at {1 / baseline.link.dt_s:.1f} Hz")
    for heading in ("axis", "model", "R_T²", "fit %"):
        table.add_column(heading, justify="right")
    for model in baseline.models:
        order = ",".join(map(str, model.order))
        table.add_row(model.axis, f"{model.method} {order}", f"{model.r2t:.4f}", f"{model.nrmse_fit:.1f}")
    console = Console(highlight=False)
    console.print(table)
    for line in describe(baseline):
        console.print(line, soft_wrap=True)
    console.print(f"{len(baseline.provenance.logs)} healthy flights, {baseline.healthy_hours * 60:.1f} minutes judged.")
    for line in _advice(baseline):
        console.print(line)


def _advice(baseline: Baseline) -> list[str]:
    """How much more would be needed for what is promised to be shown."""
    shown = [entry.threshold for entry in baseline.monitors]
    lines = []
    missing = flights_for_guarantee() - len(baseline.provenance.logs)
    if missing > 0 and any(one.rule is ThresholdRule.MAXIMUM for one in shown):
        lines.append(f"A 95/95 guarantee by the longest healthy run needs {missing} more flights.")
    budgeted = [more_flights(one, one.budget_per_hour) for one in shown if one.rule is ThresholdRule.GUMBEL]
    if any(budgeted):
        lines.append(f"To show the budget instead of extrapolating to it takes {max(budgeted)} more such flights.")
    return lines
