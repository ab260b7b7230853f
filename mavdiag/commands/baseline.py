"""`mavdiag baseline show|check|extend`."""

import json
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from mavdiag import commandline
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands import options as opt
from mavdiag.commands.progress import each, followed
from mavdiag.face import now
from mavdiag.learning.learn import extend as extended
from mavdiag.learning.suspicions import accepted
from mavdiag.logs import read_part
from mavdiag.storage import check_output

app = commandline.application("Look into a baseline file, or add healthy flights to it.")

File = Annotated[Path, Argument(help="Baseline made by `mavdiag identify`.")]


@app.command()
def show(file: File, as_json: opt.AsJson = False) -> None:
    """Print what a baseline says: whose it is, its thresholds with what supports them, and what cannot be judged."""
    baseline = Baseline.load(file)
    say(json.dumps(baseline.model_dump(mode="json", by_alias=True)) if as_json else str(baseline))


@app.command()
def check(file: File) -> None:
    """Validate a baseline: schema, every field, digest. Exit code 0 if it is sound, else 2."""
    baseline = Baseline.load(file)
    say(f"{file}: sound, {baseline.digest}\n{baseline.promises}")


@app.command()
def extend(
    file: File,
    logs: Annotated[list[Path], Argument(help="Logs of more healthy flights of the same airframe.")],
    output: opt.BaselineOutput,
    new_propellers: Annotated[bool, Option("--new-propellers", help="With new ones; 15 s of hover do.")] = False,
    accept: opt.Accept = False,
    vehicle: opt.Vehicle = None,
    from_s: opt.FromS = None,
    to_s: opt.ToS = None,
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
