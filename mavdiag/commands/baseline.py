"""`mavdiag baseline show|check`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from mavdiag import commandline
from mavdiag.baseline import MonitorEntry
from mavdiag.diagnose.monitors.effort import EffortSpec
from mavdiag.diagnose.monitors.innovation import InnovationSpec
from mavdiag.diagnose.monitors.latency import LatencySpec
from mavdiag.diagnose.monitors.shake import ShakeSpec
from mavdiag.storage import load_baseline

__all__ = ["app", "check", "describe", "show"]

app = commandline.application("Look into a baseline file.")


@app.command()
def show(
    file: Annotated[Path, typer.Argument(help="Baseline made by `mavdiag identify`.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print the whole file as one JSON line.")] = False,
) -> None:
    """Print what a baseline says."""
    baseline = load_baseline(file)
    if as_json:
        typer.echo(json.dumps(baseline.model_dump(mode="json", by_alias=True)))
        return
    link = baseline.link
    typer.echo(
        f"airframe   {baseline.airframe.name} ({baseline.airframe.scope}), frame {baseline.airframe.frame or 'unknown'}"
    )
    typer.echo(f"link       {link.profile}, {1 / link.dt_s:.2f} Hz, {link.grid} grid")
    typer.echo(f"window     {baseline.window.samples} samples, order {baseline.window.order}")
    for model in baseline.models:
        fit = f"{model.method} {model.order}, R_T² {model.r2t:.4f}"
        typer.echo(f"{model.axis:<10} {fit}, a = {_row(model.a)}, b = {_row(model.b)}")
    for entry in baseline.monitors:
        unit, detail = describe(entry)
        typer.echo(f"{entry.spec.kind:<10} threshold {entry.threshold.value:.4g} {unit}{detail}")
        typer.echo(f"           {entry.threshold.statement()}")
    for refusal in baseline.not_judgeable:
        typer.echo(f"{refusal.monitor:<10} not judgeable: {refusal.reason}")
    typer.echo(f"support    {len(baseline.provenance.logs)} flights, {baseline.healthy_hours:.3f} h judged")
    typer.echo(f"made       {baseline.provenance.created} by {baseline.provenance.tool}")


@app.command()
def check(file: Annotated[Path, typer.Argument(help="Baseline made by `mavdiag identify`.")]) -> None:
    """Validate a baseline: schema, every field, digest. Exit code 0 if it is sound, else 2."""
    baseline = load_baseline(file)
    typer.echo(f"{file}: sound, {baseline.digest}")


def describe(entry: MonitorEntry) -> tuple[str, str]:
    """Unit of a monitor's threshold, and what else its healthy reference says."""
    match entry.spec:
        case LatencySpec() as spec:
            return "s", f", margin {spec.margin_rad_s:.4f} rad/s ({spec.margin_rule}) on {spec.axis}"
        case InnovationSpec():
            return "x healthy", ""
        case EffortSpec() as spec:
            return "of hover", f", frame {spec.frame} by {spec.source}"
        case ShakeSpec() as spec:
            return "m/s^2", f", healthy mean {spec.healthy:.3g}"


def _row(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.5g}" for value in values) + "]"
