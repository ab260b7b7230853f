"""`mavdiag ack`, `balance` and `warm`: small commands of one call each."""

import os
import time
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from mavdiag.airframe.balance import Grade, assess_unbalance, grade_named, unbalance_g_mm
from mavdiag.as_json import json_line
from mavdiag.commands.options import AsJson
from mavdiag.commands.progress import working
from mavdiag.errors import InputError
from mavdiag.inspections import ask, read_open


def ack(
    journal: Annotated[Path, Argument(metavar="JOURNAL", help="The journal of the detector.")],
    vehicle: Annotated[int | None, Option(metavar="SYSID", help="Whose.  [default: the only open one]")] = None,
    by: Annotated[str | None, Option(metavar="NAME", help="Who looked.  [default: the user]")] = None,
) -> None:
    """Acknowledge the inspection that a fault left open: the vehicle was looked at.

    A detector that runs takes it up within a second, says so, and writes it to its journal; another one at its next
    start. A fault in flight cannot be acknowledged.
    """
    if not journal.is_file() and not read_open(journal):
        raise InputError(f"{journal}: no such file; name the detector's --journal")
    by = by or os.environ.get("LOGNAME") or f"user {os.getuid()}"  # of a container, which has no name
    inspection, waits = ask(journal, vehicle, f"mavdiag ack by {by}")
    when = "a detector that runs takes it up within a second, else at its next start; its journal tells what came of it"
    told = "handed over before, but no detector took it up; one does at its start" if waits else f"handed over; {when}"
    typer.echo(f"{inspection}: {told}")


def balance(
    mass_g: Annotated[float, Option(metavar="G", help="Unbalanced mass, e.g. what a nick removed.")],
    radius_mm: Annotated[float, Option(metavar="MM", help="Its distance from the axis.")],
    rpm: Annotated[float, Option(metavar="RPM", help="Rotor speed.")] = 10_000.0,
    rotor_mass_g: Annotated[float, Option(metavar="G", help="Mass of all that rotates.")] = 30.0,
    grade: Annotated[str, Option(metavar="GRADE", help="Balance quality grade.")] = Grade.G6_3.value,
    as_json: AsJson = False,
) -> None:
    """Hold an unbalance against ISO 1940-1. Exit code 0 if it is permissible, else 1."""
    unbalance = unbalance_g_mm(mass_g, radius_mm)
    report = assess_unbalance(unbalance, rotor_mass_g=rotor_mass_g, speed_rpm=rpm, grade=grade_named(grade))
    typer.echo(json_line(report) if as_json else report.sentence)
    raise typer.Exit(0 if report.within else 1)


def warm() -> None:
    """Compile what judges and learns and keep the machine code; after an installation, for all users.

    The detector compiles what judges at its start. It takes two minutes of processor time, and some seconds later on.
    """
    with working("compiling"):
        from mavdiag import chain, learning

        started = time.monotonic()
        chain.warm()
        learning.warm()
    typer.echo(f"compiled, or loaded from where it is kept, in {time.monotonic() - started:.1f} s")
