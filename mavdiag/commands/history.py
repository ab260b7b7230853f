"""`mavdiag history`: flights of an airframe kept in a database, their trends, and warnings before a threshold."""

import json
import time
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import typer
from typer import Option

from mavdiag.archive.figures import FlightRecord
from mavdiag.archive.paths import check_output
from mavdiag.archive.scan import Answer, Options, Question
from mavdiag.archive.together import reference_of
from mavdiag.baseline import Baseline
from mavdiag.commandline import application, say
from mavdiag.commands import options as opt
from mavdiag.commands.scan import judging
from mavdiag.errors import UsageError, check_installed
from mavdiag.face import now
from mavdiag.history import show as shown
from mavdiag.history.warn import Mark, MarkKind, overview_of
from mavdiag.printable import printable
from mavdiag.storage import write_atomically
from mavdiag.telemetry import unix_ns

if TYPE_CHECKING:
    from mavdiag.history.store import History

FILE = "mavdiag-history.sqlite"

Database: TypeAlias = Annotated[str, Option(metavar="FILE|URL", help="SQLite, or postgresql://user@host/name.")]
Ordered: TypeAlias = Literal["named", "file-time"]
NAME = partial(Option, metavar="NAME", callback=lambda name: name and printable(name))
AirframeName: TypeAlias = Annotated[str | None, NAME("--airframe", help="Only this airframe.")]

app = application(
    "Keep the judged flights of airframes, tell their trends, warn before a threshold is reached.\n\n"
    "Without a command: `show`.",
    show_by_default=True,
)


@app.command()
def add(
    logs: opt.Logs,
    baseline: opt.BaselineFile,
    airframe: Annotated[str | None, NAME(help="Whose they are; else the baseline's.")] = None,
    database: Database = FILE,
    again: Annotated[bool, Option("--again", help="Judge and replace flights that are there already.")] = False,
    vehicle: opt.Vehicle = None,
    at: Annotated[str | None, Option(metavar="TIME", help="When logs without a clock were flown, ISO 8601.")] = None,
    ordered: Annotated[Ordered, Option(help="Logs without a clock follow each other so.")] = "named",
    jobs: opt.Jobs = None,
    scheduler: opt.Scheduler = None,
    cache: opt.CacheFolder = None,
    no_cache: opt.NoCache = False,
) -> None:
    """Judge logs and keep what they showed. A flight is kept once. Exit code: 0, or 2 if a log could not be read, or is
    not kept, for the baseline is of another link or vehicle.

    Logs that do not say when they were flown follow each other as they are named, or by the time of their files.
    """
    if at is not None and ordered == "file-time":
        raise UsageError("--at and --ordered file-time both say when; give one of them")
    reference = Baseline.load(baseline)
    question = Question.of(reference, Options(vehicle, figures=True, flown_ns=0 if at is None else unix_ns(at)))
    name = reference.airframe.name if airframe is None else airframe
    if not name.strip():
        raise UsageError("the airframe needs a name; give --airframe NAME")
    failed, found = 0, opt.find_logs(logs)[0].logs
    how = judging(found, question, scheduler or jobs, cache, no_cache=no_cache or again)
    with _open(database, create=True) as history, how as (answers, tell):
        history.refer(reference_of(reference))
        for answer in answers:
            failed += answer.record.flight is None or not answer.record.flight.slots
            told = _added(history, answer, name, again=again, by_file=ordered == "file-time")
            tell(f"{answer.path}: {told}")
    raise typer.Exit(2 if failed else 0)


@app.command("list")
def list_flights(airframe: AirframeName = None, database: Database = FILE, as_json: opt.AsJson = False) -> None:
    """List the flights that are kept, with the statistic that came nearest to its threshold."""
    with _open(database) as history:
        kept = [history.flights(name) for name in history.names(airframe)]
    for flights in kept:
        for number, record in enumerate(flights, 1):
            say(json.dumps(shown.flight_json(number, record)) if as_json else _flight_line(number, record))


@app.command()
def show(
    airframe: AirframeName = None,
    database: Database = FILE,
    as_json: opt.AsJson = False,
    html: Annotated[Path | None, Option(metavar="FILE", help="Write a page with the trends.")] = None,
) -> None:
    """Tell the trends since the propellers were new.

    Exit code 1 if a statistic reaches its threshold soon, a rotor has changed, or the last flight is a fault; else 0.
    """
    if html is not None:
        check_output(html, Path(database))
    with _open(database) as history:
        names = history.names(airframe)
        known = history.references()
        found = [overview_of(name, history.flights(name), history.marks(name), known) for name in names]
    if html is not None:
        from mavdiag.report.page import history_page

        write_atomically(html, history_page(found, now()))
    for overview in found:
        texts = [line.text for line in shown.lines_of(overview)]
        say(*([json.dumps(shown.overview_json(overview))] if as_json else texts))
    raise typer.Exit(1 if any(overview.asks for overview in found) else 0)


@app.command()
def mark(
    airframe: Annotated[str, NAME(help="Whose it is.")],
    new_propellers: Annotated[bool, Option("--new-propellers", help="The propellers are new.")] = False,
    repair: Annotated[bool, Option("--repair", help="Something else was repaired.")] = False,
    at: Annotated[str | None, Option(metavar="TIME", help="When, ISO 8601 (UTC if without zone); else now.")] = None,
    note: Annotated[str, Option(metavar="TEXT", help="What else there is to say.")] = "",
    database: Database = FILE,
) -> None:
    """Tell that an airframe was worked on: its trends begin anew there."""
    if new_propellers == repair:
        raise UsageError("say what was done: --new-propellers or --repair")
    kind = MarkKind.NEW_PROPELLERS if new_propellers else MarkKind.REPAIR
    t_ns = time.time_ns() if at is None else unix_ns(at)
    with _open(database, write=True) as history:
        history.mark(Mark(airframe, t_ns, kind, printable(note)))
    say(f"{airframe}: {kind.value}, {shown.day(t_ns)}")


def _added(history: "History", answer: Answer, airframe: str, *, again: bool, by_file: bool) -> str:
    verdict, flight = answer.verdict, answer.record.flight
    if flight is None:
        return f"error, {verdict.reason}"
    if not flight.slots:  # refused before any monitor saw it
        return f"not kept: {verdict.reason}"
    there = history.kept_as(flight.content)
    if there is not None and not again:
        other = "" if there == (airframe, flight.baseline) else ", by another baseline or name; --again judges it anew"
        return f"is there already, of {there[0]}{other}"
    started_ns = flight.started_ns or (answer.path.stat().st_mtime_ns if by_file else 0)
    flight = replace(
        flight, airframe=airframe, log=printable(verdict.log), started_ns=started_ns, added_ns=time.time_ns()
    )
    if not history.add(flight, again=again):
        return "is there already"
    return f"{'judged again' if there else 'added'}, {verdict.verdict.value.replace('_', ' ')}, {verdict.reason}"


def _open(database: str, *, create: bool = False, write: bool = False) -> "AbstractContextManager[History]":
    check_installed("a history", "SQLAlchemy", "history")
    from mavdiag.history.store import open_history  # SQLAlchemy is loaded here and nowhere else

    return open_history(database, create=create, write=write)


def _flight_line(number: int, record: FlightRecord) -> str:
    told = f"{record.airframe} {number}: {shown.day(record.t_ns)}, {record.verdict.value.replace('_', ' ')}"
    told += f", judged {record.judged_s:.1f} s"
    ratios = [(slot.peak / slot.threshold, slot) for slot in record.slots if slot.peak is not None]
    if ratios:
        ratio, slot = max(ratios, key=lambda pair: pair[0])
        told += f", {slot.monitor}{f' {slot.axis}' if slot.axis else ''} {ratio:.2f} of its threshold"
    return f"{told}, {record.log}"
