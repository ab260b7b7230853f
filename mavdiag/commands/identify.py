"""`mavdiag identify`: healthy flights to a baseline."""

import datetime
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from mavdiag.baseline import Baseline
from mavdiag.commands.options import AxisChoice, MethodChoice, parse_order, read_part
from mavdiag.diagnose.calibrate import MarginRule
from mavdiag.learning import Flight, LearnOptions, learn
from mavdiag.storage import save_baseline

__all__ = ["identify", "make_baseline"]


def identify(
    logs: Annotated[list[Path], typer.Argument(help="Logs of healthy flights: .tlog, .bin, .ulg, Crazyflie.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Baseline file to write.")],
    method: Annotated[MethodChoice, typer.Option(help="sriv is unbiased under noise.")] = MethodChoice.SRIV,
    order: Annotated[str, typer.Option(metavar="NA,NB,NK", help="Model order.")] = "2,2,1",
    axis: Annotated[AxisChoice, typer.Option(help="Axes to model and to watch.")] = AxisChoice.ROLL,
    window: Annotated[float, typer.Option(metavar="S", help="Savitzky-Golay window.")] = 0.1,
    margin: Annotated[MarginRule, typer.Option(help="Margin on |r|.")] = MarginRule.PERCENTILE_90,
    airframe: Annotated[str, typer.Option(help="Name of the airframe or type.")] = "unnamed",
    fleet: Annotated[bool, typer.Option("--fleet", help="The logs are of several vehicles of one type.")] = False,
    vehicle: Annotated[int | None, typer.Option(metavar="SYSID", help="System id to read from a .tlog.")] = None,
    from_s: Annotated[float | None, typer.Option("--from", metavar="S", help="Start this far into each log.")] = None,
    to_s: Annotated[float | None, typer.Option("--to", metavar="S", help="Stop this far into each log.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the baseline as JSON.")] = False,
) -> None:
    """Fit a baseline to healthy flights, and say what its alarms will cost."""
    options = LearnOptions(
        axes=axis.axes,
        method=method.method,
        order=parse_order(order),
        window_s=window,
        margin_rule=margin,
        airframe=airframe,
        scope="type" if fleet else "airframe",
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
    for heading in ("axis", "model", "R_T²", "fit %", "margin rad/s", "FML s", "false alarms per flight"):
        table.add_column(heading, justify="right")
    for monitor in baseline.monitors:
        model = baseline.model_of(monitor.axis)
        table.add_row(
            monitor.axis,
            f"{model.method} {model.order}",
            f"{model.r2t:.4f}",
            f"{model.nrmse_fit:.1f}",
            f"{monitor.margin_rad_s:.4f}",
            f"{monitor.fml_s:.3f}",
            f"1/{len(monitor.longest_run_s) + 1} = {monitor.false_alarms_per_flight:.3f}",
        )
    console = Console()
    console.print(table)
    flights = len(baseline.provenance.logs)
    console.print(f"{flights} healthy flights, {baseline.healthy_hours * 60:.1f} minutes judged.")
    if flights < 59:
        console.print(f"A 95/95 guarantee needs 59 flights: record {59 - flights} more for it.")
