"""`mavdiag balance`: is this unbalance permissible by ISO 1940-1?"""

from typing import Annotated

import typer

from mavdiag.airframe.balance import Grade, assess_unbalance, grade_named, unbalance_g_mm
from mavdiag.as_json import json_line


def balance(
    mass_g: Annotated[float, typer.Option(metavar="G", help="Unbalanced mass, e.g. what a nick removed.")],
    radius_mm: Annotated[float, typer.Option(metavar="MM", help="Its distance from the axis.")],
    rpm: Annotated[float, typer.Option(metavar="RPM", help="Rotor speed.")] = 10_000.0,
    rotor_mass_g: Annotated[float, typer.Option(metavar="G", help="Mass of all that rotates.")] = 30.0,
    grade: Annotated[str, typer.Option(metavar="GRADE", help="Balance quality grade.")] = Grade.G6_3.value,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as one JSON line.")] = False,
) -> None:
    """Hold an unbalance against ISO 1940-1. Exit code 0 if it is permissible, else 1."""
    unbalance = unbalance_g_mm(mass_g, radius_mm)
    report = assess_unbalance(unbalance, rotor_mass_g=rotor_mass_g, speed_rpm=rpm, grade=grade_named(grade))
    typer.echo(json_line(report) if as_json else report.sentence)
    raise typer.Exit(0 if report.within else 1)
