"""`mavdiag report`: flights, or a campaign, as one page with figures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavdiag.archive.paths import Named, logs_named
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.options import Columns, Vehicle
from mavdiag.commands.progress import each, sizes_of
from mavdiag.errors import InputError, UsageError
from mavdiag.face import now
from mavdiag.judging import LogVerdict, Verdict, judge_in_full
from mavdiag.logs import read_log
from mavdiag.logs.csv_columns import ColumnMap, is_csv, load_column_map
from mavdiag.storage import check_output, write_atomically
from mavdiag.telemetry import Log

if TYPE_CHECKING:
    from mavdiag.report.flight import FlightReport

__all__ = ["report", "write_report"]

DRAWN = 40  # logs of one page that have figures, so that the page stays small (our choice)
LEAST_POINTS = 120


@dataclass(frozen=True, slots=True)
class _Reading:
    """How logs are read and drawn. columns: of CSV recordings. points: across a figure."""

    vehicle: int | None
    columns: ColumnMap | None
    points: int


def report(
    logs: Annotated[
        list[Path] | None, typer.Argument(metavar="LOG|DIR", help="Logs to judge; folders; quoted patterns.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE.html", help="Page to write.")] = Path(
        "report.html"
    ),
    baseline: Annotated[Path | None, typer.Option(help="Baseline made by `mavdiag identify`.")] = None,
    campaign: Annotated[
        Path | None, typer.Option(metavar="FILE.jsonl", help="Results of `sitl-plant campaign`, instead of logs.")
    ] = None,
    vehicle: Vehicle = None,
    columns: Columns = None,
) -> None:
    """Write one self-contained page: the verdict on each log, its evidence, and the figures of the thesis.

    The page needs no network and no script. Exit code: 0 written, whatever the verdicts; 2 error: also if no log could
    be read, and then there is no page.
    """
    check_output(output)
    if campaign is not None:
        if logs or baseline is not None:
            raise UsageError("--campaign takes neither logs nor --baseline; make two pages")
        _campaign(campaign, output)
        return
    if not logs or baseline is None:
        raise UsageError("name logs and --baseline FILE, or --campaign FILE")
    mapped = None if columns is None else load_column_map(columns)
    _flights(logs, baseline, output, vehicle, mapped)


def _flights(logs: Sequence[Path], baseline: Path, output: Path, vehicle: int | None, mapped: ColumnMap | None) -> None:
    from mavdiag.report.page import Made, flights_page

    reference = Baseline.load(baseline)
    found = logs_named(logs) if mapped is None else logs_named(logs, is_csv)
    if found.skipped:
        say(found.skipped_sentence, err=True)
    options = _Reading(vehicle, mapped, _points(len(found.logs)))
    reports = [
        _flight(one, reference, options, figures=number < DRAWN)
        for number, one in enumerate(each(found.logs, "drawn", sizes_of([one.path for one in found.logs])))
    ]
    if all(one.verdict.verdict is Verdict.ERROR for one in reports):
        first = reports[0].verdict
        more = f"; nor could {len(reports) - 1} others be read" if len(reports) > 1 else ""
        raise InputError(f"{first.log}: {first.reason}{more}")
    write_atomically(output, flights_page(reports, reference, Made(now(), str(baseline))))
    for one in reports:
        say(f"{one.verdict.log}: {one.verdict.verdict}")
    say(f"written to {output}")


def write_report(log: Log, baseline: Baseline, baseline_path: Path, output: Path) -> LogVerdict:
    """Judge one log, write its page, return the verdict. Raises UsageError if it cannot be drawn or written."""
    from mavdiag.report.flight import flight_report
    from mavdiag.report.page import Made, flights_page

    judged = judge_in_full(log, baseline)
    page = flights_page([flight_report(log, baseline, judged)], baseline, Made(now(), str(baseline_path)))
    write_atomically(output, page)
    return judged.verdict


def _flight(named: Named, baseline: Baseline, options: _Reading, *, figures: bool) -> "FlightReport":
    """One bad log is reported and does not lose the others."""
    from mavdiag.report.flight import flight_report, unread_report

    name, trouble = str(named.path), named.trouble
    try:
        if not trouble:
            log = replace(read_log(named.path, options.vehicle, columns=options.columns), name=name)
            return flight_report(log, baseline, judge_in_full(log, baseline), options.points, figures=figures)
    except InputError as error:
        trouble = str(error).removeprefix(f"{name}: ")
    return unread_report(LogVerdict(name, Verdict.ERROR, trouble))


def _points(logs: int) -> int:
    """Points across a figure: fewer where many logs share a page."""
    from mavdiag.report.thinned import COLUMNS

    return max(LEAST_POINTS, COLUMNS // max(1, logs // 4))


def _campaign(path: Path, output: Path) -> None:
    from mavdiag.report.campaign import read_campaign
    from mavdiag.report.campaign_page import campaign_page

    write_atomically(output, campaign_page(read_campaign(path), str(path), now()))
    say(f"written to {output}")
