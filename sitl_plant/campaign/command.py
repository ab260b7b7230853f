"""`sitl-plant campaign`: a Monte Carlo study of the diagnosis, as tables or JSON (edge)."""

import json
from contextlib import ExitStack, closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer import Option

from mavdiag.commands.progress import Shown, shown
from sitl_plant.campaign.plan import FACTORS, PRESETS, Design, make_plan, with_conditions
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
    design = replace(PRESETS[preset], vehicle=vehicle_from(vehicle), seed=seed, **asked)
    _run(with_conditions(design, conditions), output, workers, scheduler, fresh, as_json)


def _run(design: Design, output: Path, workers: int, scheduler: str | None, fresh: bool, as_json: bool) -> None:
    # Loaded here: the diagnosis and the plant take a second that --help should not.
    from mavdiag.archive.pool import dask_executor
    from sitl_plant.campaign.summary import print_summary, summarise
    from sitl_plant.campaign.worker import Journal, local_executor, run_campaign

    plan, stages = make_plan(design), dict[str, Shown]()
    chosen = dask_executor(scheduler) if scheduler is not None else local_executor(workers)
    with chosen as executor, closing(Journal(output, fresh)) as journal, ExitStack() as bars:

        def report(stage: str, done: int, total: int) -> None:
            if stage in stages:
                stages[stage].add(1.0)
            else:
                stages[stage] = bars.enter_context(shown(stage, (1.0,) * (total - done)))

        results = run_campaign(plan, journal, executor, report)
    if results.reused or results.others:
        others = "lines of other campaigns, or of another version of the sources, not counted"
        typer.echo(f"{output}: {results.reused} results reused; {results.others} {others}", err=True)
    summary = summarise(results)
    if as_json:
        typer.echo(json.dumps(summary, default=asdict))
    else:
        print_summary(summary)
