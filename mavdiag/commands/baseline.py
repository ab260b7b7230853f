"""`mavdiag baseline show|check|extend|upgrade`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from mavdiag import commandline
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.options import Accept, AsJson, FromS, ToS, Vehicle, read_part
from mavdiag.commands.progress import each, followed
from mavdiag.errors import BaselineError
from mavdiag.face import now
from mavdiag.learning.damage import accepted
from mavdiag.learning.extend import extend as extended
from mavdiag.storage import check_output, read_text
from mavdiag.upgrade import upgrade as upgraded

__all__ = ["app", "check", "extend", "show", "upgrade"]

app = commandline.application(
    "Look into a baseline file, add healthy flights to it, or bring it to the present schema."
)

File = Annotated[Path, typer.Argument(help="Baseline made by `mavdiag identify`.")]


@app.command()
def show(file: File, as_json: AsJson = False) -> None:
    """Print what a baseline says: whose it is, its thresholds with what supports them, and what cannot be judged."""
    baseline = Baseline.load(file)
    say(json.dumps(baseline.model_dump(mode="json", by_alias=True)) if as_json else str(baseline))


@app.command()
def check(file: File) -> None:
    """Validate a baseline: schema, every field, digest. Exit code 0 if it is sound, else 2."""
    baseline = Baseline.load(file)
    say(f"{file}: sound, {baseline.digest}")


@app.command()
def extend(
    file: File,
    logs: Annotated[list[Path], typer.Argument(help="Logs of more healthy flights of the same airframe.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Baseline file to write.")],
    new_propellers: Annotated[
        bool, typer.Option("--new-propellers", help="They were flown with new propellers; a hover of 15 s is enough.")
    ] = False,
    accept: Accept = False,
    vehicle: Vehicle = None,
    from_s: FromS = None,
    to_s: ToS = None,
) -> None:
    """Add healthy flights of another session, or tell that the propellers are new."""
    check_output(output)
    baseline = Baseline.load(file)
    flights = (read_part(path, vehicle, from_s, to_s) for path in each(logs, "reading"))
    with followed(flights, f"adding {len(logs)} flights ...") as taken:
        longer = extended(baseline, taken, new_propellers=new_propellers, created=now())
    if not accept:
        accepted(longer, "--accept")
    longer.save(output)
    say(f"{longer}\nwritten to {output}")


@app.command()
def upgrade(
    file: Annotated[Path, typer.Argument(help="Baseline of an older schema.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Baseline file to write.")],
) -> None:
    """Bring a baseline of schema /1 or /2 to the present one. What the old one did not know is left unknown."""
    check_output(output)
    try:
        raw = json.loads(read_text(file))
    except (ValueError, RecursionError) as error:
        raise BaselineError(f"{file}: the text is no JSON ({error}); name a baseline file") from error
    if not isinstance(raw, dict):
        raise BaselineError(f"{file}: is no baseline; name a baseline file")
    try:
        baseline = upgraded(raw)
    except BaselineError as error:
        raise BaselineError(f"{file}: {error}") from error
    baseline.save(output)
    say(f"{output}: {baseline.airframe.name}, {len(baseline.monitors)} monitors")
