"""`mavdiag ack`: somebody has looked at the vehicle after a fault."""

import getpass
from pathlib import Path
from typing import Annotated

import typer

from mavdiag.inspections import ask


def ack(
    journal: Annotated[Path, typer.Argument(metavar="JOURNAL", help="The journal of the detector.")],
    vehicle: Annotated[
        int | None, typer.Option(metavar="SYSID", help="Whose inspection.  [default: the only one that is open]")
    ] = None,
    by: Annotated[str | None, typer.Option(metavar="NAME", help="Who looked.  [default: the user]")] = None,
) -> None:
    """Acknowledge the inspection that a fault left open: the vehicle was looked at.

    A detector that runs takes it up within a second, says so, and writes it to its journal; another one at its next
    start. A fault in flight cannot be acknowledged.
    """
    inspection = ask(journal, vehicle, f"mavdiag ack by {by or getpass.getuser()}")
    typer.echo(f"{inspection}: handed to the detector; its journal tells what came of it")
