"""`mavdiag history`: flights of an airframe kept in a database, their trends, and warnings before a threshold."""

import csv
import importlib
import io
import json
import shutil
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from mavdiag.archive.paths import logs_named
from mavdiag.baseline import Baseline
from mavdiag.commandline import application, say
from mavdiag.commands.options import AsJson, Vehicle, read_part
from mavdiag.commands.progress import each
from mavdiag.errors import InputError, UsageError, missing_extra
from mavdiag.history.as_json import FLIGHT_COLUMNS, TREND_COLUMNS, flight_json, flight_rows, overview_json, trend_rows
from mavdiag.history.draw import Line, day, lines_of
from mavdiag.history.overview import Overview, overview_of
from mavdiag.history.records import FlightRecord, Mark, MarkKind
from mavdiag.history.summary import content_of, record_of
from mavdiag.judging import judge_in_full
from mavdiag.printable import printable
from mavdiag.storage import write_atomically
from mavdiag.telemetry import Log
from mavdiag.units import NS_PER_S

if TYPE_CHECKING:
    from mavdiag.history.store import History

__all__ = ["add", "app", "list_flights", "mark", "overview", "show"]

FILE = "mavdiag-history.sqlite"

Database: TypeAlias = Annotated[
    str, typer.Option(metavar="FILE|URL", help="SQLite file, or postgresql://user@host/name for a fleet.")
]
AirframeName: TypeAlias = Annotated[str | None, typer.Option("--airframe", metavar="NAME", help="Only this airframe.")]
CsvFile: TypeAlias = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write a table, too.")]

app = application("Keep the judged flights of airframes, draw their trends, warn before a threshold is reached.")


@app.callback(invoke_without_command=True, no_args_is_help=False)
def overview(
    context: typer.Context,
    airframe: AirframeName = None,
    database: Database = FILE,
    as_json: AsJson = False,
    csv_file: CsvFile = None,
) -> None:
    """Keep the judged flights of airframes, draw their trends, warn before a threshold is reached.

    Without a command: `show`.
    """
    if context.invoked_subcommand is None:
        show(airframe, database, as_json, csv_file)
    elif airframe is not None or database != FILE or as_json or csv_file is not None:
        name = context.invoked_subcommand
        raise UsageError(f"options belong behind the command, as in `mavdiag history {name} --airframe NAME`")


@app.command()
def add(
    logs: Annotated[list[Path], typer.Argument(help="Logs to judge and to keep, folders of them, or patterns.")],
    baseline: Annotated[Path, typer.Option(help="Baseline made by `mavdiag identify`.")],
    airframe: Annotated[
        str | None, typer.Option(metavar="NAME", help="Whose flights they are; else the baseline's airframe.")
    ] = None,
    database: Database = FILE,
    again: Annotated[bool, typer.Option("--again", help="Judge and replace flights that are there already.")] = False,
    vehicle: Vehicle = None,
    at: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="When logs without a clock were flown, ISO 8601.  [default: when added]"),
    ] = None,
) -> None:
    """Judge logs and keep what they showed. A flight is kept once. Exit code: 0, or 2 if a log could not be read.

    Logs that do not say when they were flown follow each other in the order in which they are named.
    """
    flown_ns = None if at is None else _time(at)
    reference = Baseline.load(baseline)
    name = reference.airframe.name if airframe is None else airframe
    if not name.strip():
        raise UsageError("the airframe needs a name; give --airframe NAME")
    named, failed = logs_named(logs), 0
    with _open(database, create=True) as history:
        for one in each(named.logs, "judging"):
            path = one.path
            try:
                if one.trouble:
                    raise InputError(one.trouble)
                log = read_part(path, vehicle, None, None)
                if flown_ns is not None and not log.started_ns:
                    log = replace(log, started_ns=flown_ns)
                say(f"{path}: {_added(history, log, reference, name, again)}")
            except InputError as error:
                failed += 1
                say(f"{path}: error, {str(error).removeprefix(f'{path}: ')}")
    if named.skipped_sentence:
        say(named.skipped_sentence, err=True)
    raise typer.Exit(2 if failed else 0)


@app.command("list")
def list_flights(
    airframe: AirframeName = None, database: Database = FILE, as_json: AsJson = False, csv_file: CsvFile = None
) -> None:
    """List the flights that are kept, with the statistic that came nearest to its threshold."""
    with _open(database) as history:
        kept = [history.flights(name) for name in _names(history, airframe)]
    numbered = [(number, one) for flights in kept for number, one in enumerate(flights, 1)]
    if csv_file is not None:
        _write_csv(csv_file, FLIGHT_COLUMNS, (row for number, one in numbered for row in flight_rows(number, one)))
    for number, one in numbered:
        say(json.dumps(flight_json(number, one)) if as_json else _flight_line(number, one))


@app.command()
def show(
    airframe: AirframeName = None, database: Database = FILE, as_json: AsJson = False, csv_file: CsvFile = None
) -> None:
    """Draw the trends since the propellers were new.

    Exit code 1 if a statistic reaches its threshold soon, or the last flight is a fault; else 0.
    """
    with _open(database) as history:
        names = _names(history, airframe)
        found = [overview_of(name, history.flights(name), history.marks(name)) for name in names]
    if csv_file is not None:
        _write_csv(csv_file, TREND_COLUMNS, (row for one in found for row in trend_rows(one)))
    for one in found:
        if as_json:
            say(json.dumps(overview_json(one)))
        else:
            _print_lines(one)
    raise typer.Exit(1 if any(one.warned or one.faulty for one in found) else 0)


@app.command()
def mark(
    airframe: Annotated[str, typer.Option(metavar="NAME", help="Whose it is.")],
    new_propellers: Annotated[bool, typer.Option("--new-propellers", help="The propellers are new.")] = False,
    repair: Annotated[bool, typer.Option("--repair", help="Something else was repaired.")] = False,
    at: Annotated[
        str | None, typer.Option(metavar="TIME", help="When, ISO 8601 (UTC if it names no zone); else now.")
    ] = None,
    note: Annotated[str, typer.Option(metavar="TEXT", help="What else there is to say.")] = "",
    database: Database = FILE,
) -> None:
    """Tell that an airframe was worked on: its trends begin anew there."""
    if new_propellers == repair:
        raise UsageError("say what was done: --new-propellers or --repair")
    kind = MarkKind.NEW_PROPELLERS if new_propellers else MarkKind.REPAIR
    t_ns = time.time_ns() if at is None else _time(at)
    with _open(database, write=True) as history:
        history.mark(Mark(airframe, t_ns, kind, note))
    say(f"{airframe}: {kind.value}, {day(t_ns)}")


def _added(history: "History", log: Log, baseline: Baseline, airframe: str, again: bool) -> str:
    """Judge and keep one log; what came of it."""
    there = history.airframe_of(content_of(log))
    if there is not None and not again:
        return f"is there already, of {there}"
    record = _judged(log, baseline, airframe)
    if not history.add(record, again=again):
        return "is there already"
    return f"{'judged again' if there else 'added'}, {record.verdict.value.replace('_', ' ')}, {record.reason}"


def _judged(log: Log, baseline: Baseline, airframe: str) -> FlightRecord:
    judged = judge_in_full(log, baseline)
    return record_of(log, judged, baseline, airframe=airframe, added_ns=time.time_ns())


def _open(database: str, *, create: bool = False, write: bool = False) -> "AbstractContextManager[History]":
    """The history. SQLAlchemy is loaded here and nowhere else. Raises UsageError if it is not installed."""
    try:
        store = importlib.import_module("mavdiag.history.store")
    except ImportError as error:
        raise missing_extra("a history", "SQLAlchemy or Alembic", "history") from error
    opened: AbstractContextManager[History] = store.open_history(database, create=create, write=write)
    return opened


def _names(history: "History", airframe: str | None) -> Sequence[str]:
    """The airframes asked for. Raises UsageError for one that is not there."""
    names = history.airframes()
    if airframe is None:
        return names
    if airframe not in names:
        raise UsageError(f"no airframe {airframe!r} in the history; there is {', '.join(names) or 'none yet'}")
    return (airframe,)


def _time(text: str) -> int:
    """A time as unix epoch [ns]. Raises UsageError, showing the notation."""
    try:
        at = datetime.fromisoformat(text)
    except ValueError as error:
        raise UsageError(f"time {text!r}: write it like 2026-03-01 or 2026-03-01T14:30") from error
    at = at.replace(tzinfo=UTC) if at.tzinfo is None else at
    return round(at.timestamp()) * NS_PER_S


def _flight_line(number: int, record: FlightRecord) -> str:
    near = max(
        ((one.peak / one.threshold, one) for one in record.slots if one.peak is not None),
        key=lambda pair: pair[0],
        default=None,
    )
    axis = f" {near[1].axis}" if near and near[1].axis else ""
    nearest = f", {near[1].monitor}{axis} {near[0]:.2f} of its threshold" if near else ""
    verdict = record.verdict.value.replace("_", " ")
    told = f"{record.airframe} {number}: {day(record.t_ns)}, {verdict}, judged {record.judged_s:.1f} s{nearest}"
    return f"{told}, {record.log}"


def _write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write rows with a head. What is not known is an empty field. Raises UsageError if it cannot be written."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode(errors="surrogateescape"))


def _print_lines(one: Overview) -> None:
    """Drawn on a terminal, in its width; plain lines elsewhere."""
    drawn = sys.stdout.isatty()
    width = shutil.get_terminal_size().columns if drawn else None
    for line in lines_of(one, width):
        _print_line(line, drawn)


def _print_line(line: Line, drawn: bool) -> None:
    text = printable(line.text)
    typer.echo(typer.style(text, fg=typer.colors.RED, bold=True) if line.loud and drawn else text)
