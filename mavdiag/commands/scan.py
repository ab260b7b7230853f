"""`mavdiag scan`: judge logs by a baseline."""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, closing
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from mavdiag.archive.cache import Cache, cache_folder, open_cache
from mavdiag.archive.cluster import dask_executor
from mavdiag.archive.job import Answer, Options, Question
from mavdiag.archive.paths import Found, logs_named
from mavdiag.archive.pool import TaskExecutor, in_this_process, local_executor
from mavdiag.archive.scan import in_order
from mavdiag.archive.scan import scan as archive
from mavdiag.archive.sources import judging_version
from mavdiag.archive.tables import check_parquet, rows_of, write_csv, write_parquet
from mavdiag.archive.windows import Window
from mavdiag.as_json import verdict_json
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.options import AsJson, Columns, FromS, ToS, Vehicle
from mavdiag.commands.progress import shown, sizes_of
from mavdiag.errors import UsageError
from mavdiag.judging import JUDGED_SHARE, Verdict, exit_code
from mavdiag.logs.csv_columns import column_map_text, is_csv
from mavdiag.logs.part import check_times
from mavdiag.storage import check_output

__all__ = ["scan"]

Row = tuple[Any, ...]


def scan(
    logs: Annotated[
        list[Path],
        typer.Argument(help="Logs to judge: .tlog, .bin, .ulg, Crazyflie, DronePropA; folders; quoted patterns."),
    ],
    baseline: Annotated[Path, typer.Option(help="Baseline made by `mavdiag identify`.")],
    as_json: AsJson = False,
    vehicle: Vehicle = None,
    from_s: FromS = None,
    to_s: ToS = None,
    columns: Columns = None,
    judged_share: Annotated[
        float, typer.Option(min=0.0, max=1.0, metavar="SHARE", help="Of the flown time, judged: less is not healthy.")
    ] = JUDGED_SHARE,
    windows: Annotated[
        float | None, typer.Option(metavar="S", min=1.0, help="Judge each log in windows of this length besides.")
    ] = None,
    csv: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a table, one row a log or window.")] = None,
    parquet: Annotated[Path | None, typer.Option(metavar="FILE", help="The same table as Parquet.")] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Worker processes.  [default: as many as processors]")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Judge on the workers of this Dask scheduler instead.")
    ] = None,
    cache: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep answers there.  [default: ~/.cache/mavdiag]")
    ] = None,
    no_cache: Annotated[bool, typer.Option("--no-cache", help="Judge all anew, and keep nothing.")] = False,
) -> None:
    """Judge logs. Exit code: 0 healthy, 1 fault, 2 error, 3 not judgeable, 4 suspected; of several logs the first of
    2, 1, 4, 3, 0.

    Answers are kept, so a scan that was stopped goes on where it was.
    """
    reference = Baseline.load(baseline)
    check_times(from_s, to_s)
    for path in (csv, parquet):
        if path is not None:
            check_output(path)
    if parquet is not None:
        check_parquet()
    mapped = None if columns is None else column_map_text(columns)
    question = Question.of(reference, Options(vehicle, from_s, to_s, windows, mapped, judged_share), judging_version())
    kept = None if no_cache else _cache(cache, question.scope)
    found = logs_named(logs) if mapped is None else logs_named(logs, is_csv)
    opened = _opened(scheduler, min(jobs or _processors(), len(found.logs)))
    verdicts, rows = _answered(found, question, opened, kept, as_json, csv is not None or parquet is not None)
    if csv is not None:
        write_csv(csv, rows)
    if parquet is not None:
        write_parquet(parquet, rows)
    raise typer.Exit(exit_code(verdicts))


def _answered(
    found: Found,
    question: Question,
    opened: Callable[[], AbstractContextManager[TaskExecutor]],
    kept: Cache | None,
    as_json: bool,
    tabled: bool,
) -> tuple[list[Verdict], list[Row]]:
    """Print the answers as they come; return the verdicts, and the rows of a table if one is wanted."""
    verdicts: list[Verdict] = []
    rows: list[Row] = []
    before = 0
    sizes = sizes_of([one.path for one in found.logs])
    with shown("judged", sizes, quiet=as_json) as progress:

        def warn(text: str) -> None:
            with progress.cleared():
                say(text, err=True)

        def counted(answers: Iterable[Answer]) -> Iterator[Answer]:
            for answer in answers:
                progress.add(sizes[answer.number])
                yield answer

        if found.skipped:
            warn(found.skipped_sentence)
        with closing(archive(found.logs, question, opened, kept, warn)) as run:
            for answer in in_order(counted(run)):
                before += not answer.fresh
                verdicts.append(answer.record.verdict.verdict)
                rows += rows_of(answer) if tabled else ()
                with progress.cleared():
                    say(_json_line(answer) if as_json else _lines(answer))
    if before and not as_json:
        say(f"{before} of {len(verdicts)} answers were known already; --no-cache judges anew", err=True)
    return verdicts, rows


def _opened(scheduler: str | None, jobs: int) -> Callable[[], AbstractContextManager[TaskExecutor]]:
    if scheduler is not None:
        return partial(dask_executor, scheduler)
    return partial(local_executor, jobs) if jobs > 1 else in_this_process


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _cache(folder: Path | None, scope: str) -> Cache | None:
    """Where answers are kept. Only a folder that was asked for must be usable."""
    chosen = cache_folder() if folder is None else folder
    try:
        return None if chosen is None else open_cache(chosen, scope)
    except UsageError as error:
        if folder is not None:
            raise
        say(f"answers are not kept: {error}", err=True)
        return None


def _json_line(answer: Answer) -> str:
    told = verdict_json(answer.verdict)
    if answer.record.windows:
        told["windows"] = [_window_json(one) for one in answer.record.windows]
    return json.dumps(told)


def _window_json(one: Window) -> dict[str, Any]:
    return {
        "from_s": one.from_s,
        "to_s": one.to_s,
        "verdict": one.verdict,
        "judged_s": round(one.judged_s, 3),
        "flown_s": round(one.flown_s, 3),
        "ratio": None if one.ratio is None else float(f"{one.ratio:.9g}"),
        "monitor": one.monitor,
    }


def _lines(answer: Answer) -> str:
    return "\n".join((str(answer.verdict), *_window_lines(answer.record.windows)))


def _window_lines(windows: Sequence[Window]) -> list[str]:
    lines = []
    for one in windows:
        nearest = "" if one.ratio is None else f", {one.monitor} at {one.ratio:.2f} of its threshold"
        judged = f"judged {one.judged_s:.1f} s of {one.flown_s:.1f} s"
        lines.append(f"  {one.from_s:g} to {one.to_s:g} s: {one.verdict}, {judged}{nearest}")
    return lines
