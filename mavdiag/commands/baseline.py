"""`mavdiag baseline show|check|upgrade`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from mavdiag import commandline
from mavdiag.baseline import upgrade as upgraded
from mavdiag.commands.options import AsJson
from mavdiag.errors import BaselineError
from mavdiag.storage import check_output, load_baseline, read_text, save_baseline

__all__ = ["app", "check", "show", "upgrade"]

app = commandline.application("Look into a baseline file, or bring it to the present schema.")

File = Annotated[Path, typer.Argument(help="Baseline made by `mavdiag identify`.")]


@app.command()
def show(file: File, as_json: AsJson = False) -> None:
    """Print what a baseline says: whose it is, its thresholds with what supports them, and what cannot be judged."""
    baseline = load_baseline(file)
    typer.echo(json.dumps(baseline.model_dump(mode="json", by_alias=True)) if as_json else str(baseline))


@app.command()
def check(file: File) -> None:
    """Validate a baseline: schema, every field, digest. Exit code 0 if it is sound, else 2."""
    baseline = load_baseline(file)
    typer.echo(f"{file}: sound, {baseline.digest}")


@app.command()
def upgrade(
    file: Annotated[Path, typer.Argument(help="Baseline of an older schema.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Baseline file to write.")],
) -> None:
    """Bring a baseline of schema /1 to the present one. What the old one did not know is left unknown."""
    check_output(output)
    try:
        raw = json.loads(read_text(file))
    except ValueError as error:
        raise BaselineError(f"{file}: the text is no JSON ({error}); name a baseline file") from error
    if not isinstance(raw, dict):
        raise BaselineError(f"{file}: is no baseline; name a baseline file")
    try:
        baseline = upgraded(raw)
    except BaselineError as error:
        raise BaselineError(f"{file}: {error}") from error
    save_baseline(output, baseline)
    typer.echo(f"{output}: {baseline.airframe.name}, {len(baseline.monitors)} monitors")
