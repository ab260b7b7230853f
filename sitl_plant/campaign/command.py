"""`sitl-plant campaign`: a Monte Carlo study of the diagnosis, as tables or JSON (edge)."""

import json
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer import Option

from sitl_plant.campaign.plan import FACTORS, PRESETS, with_conditions
from sitl_plant.options import VehicleName
from sitl_plant.vehicle import vehicle_from

_RESULTS = "Results, one a line; a re-run goes on."
_LEVELS = f"Levels of {', '.join(FACTORS)}; repeatable."


def campaign(
    output: Annotated[Path, Option("-o", "--output", metavar="FILE.jsonl", help=_RESULTS)] = Path("campaign.jsonl"),
    preset: Annotated[Literal["quick", "full", "conditions"], Option(help="Size and levels to start from.")] = "quick",
    flights: Annotated[int | None, Option(metavar="N", help="Flights with a cause.")] = None,
    hours: Annotated[float | None, Option(metavar="H", help="Healthy flight.")] = None,
    airframes: Annotated[int | None, Option(metavar="N", help="Specimens, every second one aged.")] = None,
    learn: Annotated[Literal["mixed", "square"] | None, Option(help="From mixed flights, or T's square alone.")] = None,
    learn_flights: Annotated[int | None, Option(metavar="N", help="Healthy flights for a baseline.")] = None,
    duration: Annotated[float | None, Option(metavar="S", help="Length of each flight.")] = None,
    conditions: Annotated[list[str], Option(metavar="FACTOR=LEVEL,..", help=_LEVELS)] = [],  # noqa: B006  # copied
    vehicle: VehicleName = "qdrone2",
    seed: Annotated[int, Option(min=0, help="Equal seeds give equal numbers.")] = 0,
    workers: Annotated[int, Option(min=1, max=256, help="Processes on this machine.")] = 2,
    scheduler: Annotated[str | None, Option(metavar="ADDRESS", help="Use a Dask scheduler instead.")] = None,
    fresh: Annotated[bool, Option("--fresh", help="Start anew: empty the file of results first.")] = False,
    as_json: Annotated[bool, Option("--json", help="Print the summary as one JSON object.")] = False,
) -> None:
    """Fly many airframes healthy, damaged and otherwise wrong; learn from each, judge each, and count.

    Every airframe is drawn afresh and judged by a baseline learnt from its own healthy flights.
    """
    given = {"learn": learn, "flights": flights, "hours": hours, "airframes": airframes}
    given |= {"learn_flights": learn_flights, "duration_s": duration}
    asked: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    design = with_conditions(PRESETS[preset], conditions, vehicle=vehicle_from(vehicle), seed=seed, **asked)
    # Loaded here: the diagnosis and the plant take a second that --help should not.
    from sitl_plant.campaign.summary import print_summary, summarise
    from sitl_plant.campaign.worker import Journal, run_campaign

    with closing(Journal(output, fresh)) as journal:
        results = run_campaign(design, journal, workers if scheduler is None else scheduler)
    if results.reused or results.others:
        others = "lines of other campaigns, or of another version of the sources, not counted"
        typer.echo(f"{output}: {results.reused} results reused; {results.others} {others}", err=True)
    summary = summarise(results)
    if as_json:
        typer.echo(json.dumps(summary, default=asdict))
    else:
        print_summary(summary)
