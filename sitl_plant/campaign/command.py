"""`sitl-plant campaign`: a Monte Carlo study of the diagnosis, as tables, JSON and Parquet (edge)."""

import json
from contextlib import ExitStack, closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Option

from mavdiag.commands.progress import Shown, shown
from mavdiag.errors import UsageError
from sitl_plant.campaign.plan import PRESETS, Design, make_plan, with_conditions
from sitl_plant.options import VehicleName
from sitl_plant.vehicle import vehicle_from

if TYPE_CHECKING:
    from sitl_plant.campaign.worker import FlightResult, Results


def campaign(
    output: Annotated[
        Path, Option("-o", "--output", metavar="FILE.jsonl", help="Results, one a line; a re-run goes on.")
    ] = Path("campaign.jsonl"),
    preset: Annotated[Literal["quick", "full", "conditions"], Option(help="Size and levels to start from.")] = "quick",
    flights: Annotated[int | None, Option(metavar="N", help="Flights with a cause.")] = None,
    hours: Annotated[float | None, Option(metavar="H", help="Healthy flight.")] = None,
    airframes: Annotated[int | None, Option(metavar="N", help="Specimens, every second one aged.")] = None,
    learn: Annotated[
        Literal["mixed", "square"] | None,
        Option(help="Learn from mixed flights, or from T's square alone.  [default: the preset's]"),
    ] = None,
    learn_flights: Annotated[int | None, Option(metavar="N", help="Healthy flights for a baseline.")] = None,
    duration: Annotated[float | None, Option(metavar="S", help="Length of each flight.")] = None,
    conditions: Annotated[
        list[str],
        Option(
            metavar="FACTOR=LEVEL,..",
            help="Levels of cause, rotor, phenomenology, condition, manoeuvre, wind, payload, link, loss; repeatable.",
        ),
    ] = [],  # noqa: B006  # typer copies its defaults
    vehicle: VehicleName = "qdrone2",
    seed: Annotated[int, Option(min=0, help="Equal seeds give equal numbers.")] = 0,
    workers: Annotated[int, Option(min=1, max=256, help="Processes on this machine.")] = 2,
    scheduler: Annotated[str | None, Option(metavar="ADDRESS", help="Use a Dask scheduler instead.")] = None,
    fresh: Annotated[bool, Option("--fresh", help="Start anew: empty the file of results first.")] = False,
    as_json: Annotated[bool, Option("--json", help="Print the summary as one JSON object.")] = False,
    summary_file: Annotated[Path | None, Option("--summary", metavar="FILE.json", help="Write it, too.")] = None,
    parquet: Annotated[Path | None, Option(metavar="FILE.parquet", help="Write the flights as a table, too.")] = None,
) -> None:
    """Fly many airframes healthy, damaged and otherwise wrong; learn from each, judge each, and count.

    Every airframe is drawn afresh and judged by a baseline learnt from its own healthy flights.
    """
    given = {"learn": learn, "flights": flights, "hours": hours, "airframes": airframes}
    given |= {"learn_flights": learn_flights, "duration_s": duration}
    asked: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    design = replace(PRESETS[preset], vehicle=vehicle_from(vehicle), seed=seed, **asked)
    summary = _run(with_conditions(design, conditions), output, workers, scheduler, fresh, parquet)
    text = json.dumps(summary, default=asdict)
    if summary_file is not None:
        from mavdiag.storage import write_atomically

        write_atomically(summary_file, text + "\n")
    if as_json:
        typer.echo(text)
    else:
        from sitl_plant.campaign.summary import print_summary

        print_summary(summary)


def _run(
    design: Design, output: Path, workers: int, scheduler: str | None, fresh: bool, parquet: Path | None
) -> dict[str, Any]:
    # Loaded here: the diagnosis and the plant take a second that --help should not.
    from mavdiag.archive.pool import dask_executor
    from mavdiag.archive.tables import check_parquet
    from sitl_plant.campaign.summary import summarise
    from sitl_plant.campaign.worker import Journal, local_executor, run_campaign

    plan = make_plan(design)
    if parquet is not None:
        check_parquet()
    chosen = dask_executor(scheduler) if scheduler is not None else local_executor(workers)
    stages: dict[str, Shown] = {}
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
    if parquet is not None:
        _write_parquet(parquet, results)
    return summarise(results)


def _write_parquet(path: Path, results: "Results") -> None:
    from pyarrow import Table
    from pyarrow.parquet import write_table

    rows = [_row(flight) for flight in results.flights]
    names = dict.fromkeys(name for row in rows for name in row)  # pyarrow takes the first row's names for all
    try:
        write_table(Table.from_pylist([{name: row.get(name) for name in names} for row in rows]), str(path))
    except OSError as error:
        raise UsageError(f"cannot write {path} ({error}); choose another --parquet file") from error


def _row(flight: "FlightResult") -> dict[str, object]:
    row: dict[str, object] = asdict(flight)
    del row["monitors"], row["conditions"], row["answer"], row["record"]
    row |= asdict(flight.conditions)
    row |= {f"answer_{name}": value for name, value in asdict(flight.answer).items()}
    for monitor in flight.monitors:
        row |= {f"{monitor.name}_{name}": value for name, value in asdict(monitor).items() if name != "name"}
    return row
