"""`mavdiag baseline show|check`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from mavdiag import commandline
from mavdiag.baseline import Baseline
from mavdiag.chain import chain_of
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
    for line in describe(baseline):
        typer.echo(line)
    typer.echo(f"support    {len(baseline.provenance.logs)} flights, {baseline.healthy_hours:.3f} h judged")
    typer.echo(f"made       {baseline.provenance.created} by {baseline.provenance.tool}")


@app.command()
def check(file: Annotated[Path, typer.Argument(help="Baseline made by `mavdiag identify`.")]) -> None:
    """Validate a baseline: schema, every field, digest. Exit code 0 if it is sound, else 2."""
    baseline = load_baseline(file)
    typer.echo(f"{file}: sound, {baseline.digest}")


def describe(baseline: Baseline) -> list[str]:
    """Two lines a monitor: its threshold, and what supports it; then what cannot be judged."""
    lines = []
    for entry, watch in zip(baseline.monitors, chain_of(baseline).watches, strict=True):
        name = watch.monitor.name if watch.monitor.axis is None else f"{watch.monitor.name} {watch.monitor.axis}"
        over = f" of |r| above {watch.reference:.4f} rad/s" if watch.reference else ""
        lines.append(f"{name:<13} threshold {entry.threshold.value:.4g} {watch.monitor.unit}{over}")
        lines.append(f"{'':<13} {entry.threshold.statement()}")
    return lines + [f"{one.monitor:<13} not judgeable: {one.reason}" for one in baseline.not_judgeable]


def _row(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.5g}" for value in values) + "]"
