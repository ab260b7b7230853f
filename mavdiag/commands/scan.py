"""`mavdiag scan`: judge logs by a baseline."""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from mavdiag.archive.figures import FlightRecord
from mavdiag.archive.paths import Named, check_output
from mavdiag.archive.scan import Answer, Cache, Options, Question, open_cache
from mavdiag.archive.scan import scan as archive
from mavdiag.archive.tables import Row, rows_of, write_csv, write_parquet
from mavdiag.archive.together import reference_of, together
from mavdiag.as_json import number, verdict_json
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands import options as opt
from mavdiag.commands.progress import shown, sizes_of
from mavdiag.errors import check_installed
from mavdiag.judging import JUDGED_SHARE, Verdict, exit_code
from mavdiag.logs import check_times

LONGEST_S = 1e6  # of a window: 11 days (our choice)


def scan(
    logs: opt.Logs,
    baseline: opt.BaselineFile,
    as_json: opt.AsJson = False,
    vehicle: opt.Vehicle = None,
    from_s: opt.FromS = None,
    to_s: opt.ToS = None,
    columns: opt.Columns = None,
    judged_share: Annotated[
        float, Option(min=0.0, max=1.0, metavar="SHARE", help="Of the flown time, judged: less is not healthy.")
    ] = JUDGED_SHARE,
    windows: Annotated[
        float | None, Option(metavar="S", min=1.0, max=LONGEST_S, help="Judge windows of this length, too.")
    ] = None,
    as_one: Annotated[
        bool, Option("--together", help="These flights flew one set of propellers: has a rotor changed?")
    ] = False,
    csv: Annotated[Path | None, Option(metavar="FILE", help="Write a table, one row a log or window.")] = None,
    parquet: Annotated[Path | None, Option(metavar="FILE", help="The same table as Parquet.")] = None,
    jobs: opt.Jobs = None,
    scheduler: opt.Scheduler = None,
    cache: opt.CacheFolder = None,
    no_cache: opt.NoCache = False,
) -> None:
    """Judge logs. Exit code: 0 healthy, 1 fault, 2 error, 3 not judgeable, 4 suspected; of several logs the first of
    2, 1, 4, 3, 0.

    Several logs are a table on a terminal, the gravest first, and a line each on a pipe. Answers are kept, so a scan
    that was stopped goes on where it was. With --together the last line is about all flights, in their order, and a
    change of 50 to 1 counts as suspected.
    """
    reference = Baseline.load(baseline)
    check_times(from_s, to_s)
    found, mapped = opt.find_logs(logs, columns)
    read = (baseline, columns, *(log.path for log in found.logs))
    if csv is not None:
        check_output(csv, parquet, *read)
    if parquet is not None:
        check_output(parquet, *read)
        check_installed("--parquet", "pyarrow", "fleet")
    question = Question.of(reference, Options(vehicle, from_s, to_s, windows, mapped, judged_share, figures=as_one))
    verdicts, rows, flights = list[Verdict](), list[Row](), dict[str, FlightRecord]()
    before = copies = 0
    as_table = len(found.logs) > 1 and windows is None and not as_json and opt.table_fits()
    how = judging(found.logs, question, scheduler or jobs, cache, no_cache=no_cache, quiet=as_json)
    with how as (answers, tell):
        for answer in answers:
            if not as_table:
                tell(*([_json_line(answer)] if as_json else _lines(answer)))
            verdicts.append(answer.record.verdict.verdict)
            rows += rows_of(answer) if csv or parquet or as_table else ()
            before, copies = before + answer.known, copies + answer.copy
            if (flight := answer.record.flight) is not None:  # a copy is no further flight
                flights.setdefault(flight.content, replace(flight, log=str(answer.path)))
    if as_table:
        from mavdiag.terminal.tables import verdict_table  # rich takes time to load

        verdict_table(rows)
    if as_one:
        found_together = together(reference_of(reference), list(flights.values()))
        say(json.dumps({"together": found_together.as_json()}) if as_json else str(found_together))
        verdicts += [Verdict.SUSPECTED] if found_together.changed else []
    if before and not as_json:
        say(f"{before} of {len(found.logs)} answers were known already; --no-cache judges anew", err=True)
    if copies and not as_json:
        say(f"{copies} of {len(found.logs)} logs: a copy of another log in the list, which was judged once", err=True)
    if csv is not None:
        write_csv(csv, rows)
    if parquet is not None:
        write_parquet(parquet, rows)
    raise typer.Exit(exit_code(verdicts))


@contextmanager
def judging(
    logs: Sequence[Named],
    question: Question,
    workers: int | str | None,
    cache: Path | None,
    *,
    no_cache: bool,
    quiet: bool = False,
) -> Iterator[tuple[Iterator[Answer], Callable[..., None]]]:
    """The answers in order, and what prints lines beside the progress. quiet: no progress where no terminal is."""
    sizes = sizes_of(logs)
    with shown("judged", sizes, quiet=quiet) as progress:
        warn = partial(progress.say, err=True)
        kept = Cache() if no_cache else open_cache(cache, question.scope, warn)
        chosen = workers if isinstance(workers, str) else min(workers or os.cpu_count() or 1, len(logs))

        def counted() -> Iterator[Answer]:
            for answer, size in zip(run, sizes, strict=True):
                progress.add(size)
                yield answer

        with closing(archive(logs, question, chosen, kept, warn)) as run:
            yield counted(), progress.say


def _json_line(answer: Answer) -> str:
    told = verdict_json(answer.verdict)
    for window in answer.record.windows:
        part = {name: getattr(window, name) for name in ("from_s", "to_s", "verdict")}
        part |= {"judged_s": round(window.judged_s, 3), "flown_s": round(window.flown_s, 3)}
        part |= {"ratio": number(window.ratio), "monitor": window.monitor}
        told.setdefault("windows", []).append(part)
    return json.dumps(told)


def _lines(answer: Answer) -> list[str]:
    lines = [str(answer.verdict)]
    for window in answer.record.windows:
        nearest = "" if window.ratio is None else f", {window.monitor} at {window.ratio:.2f} of its threshold"
        judged = f"judged {window.judged_s:.1f} s of {window.flown_s:.1f} s"
        lines.append(f"  {window.from_s:.10g} to {window.to_s:.10g} s: {window.verdict}, {judged}{nearest}")
    return lines
