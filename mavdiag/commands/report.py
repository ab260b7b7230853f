"""`mavdiag report`: flights, or a campaign, as one page with figures."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from mavdiag.archive.paths import Named, check_output
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands import options as opt
from mavdiag.commands.progress import each
from mavdiag.errors import InputError, UsageError
from mavdiag.face import now
from mavdiag.judging import LogVerdict, Verdict
from mavdiag.logs import read_part
from mavdiag.logs.csv_columns import ColumnMap
from mavdiag.storage import write_atomically
from mavdiag.telemetry import Log

if TYPE_CHECKING:
    from mavdiag.report.page import FlightReport

DRAWN = 40  # logs of one page that have figures, so that the page stays small (our choice)
LEAST_POINTS = 120
PAGE = Path("report.html")


def report(
    logs: Annotated[list[Path] | None, Argument(metavar="LOG|DIR", help="Logs, folders, quoted patterns.")] = None,
    output: Annotated[Path, Option("-o", "--output", metavar="FILE.html", help="Page to write.")] = PAGE,
    baseline: Annotated[Path | None, Option(help="Baseline made by `mavdiag identify`.")] = None,
    campaign: Annotated[Path | None, Option(metavar="FILE.jsonl", help="Results of `sitl-plant campaign`.")] = None,
    vehicle: opt.Vehicle = None,
    columns: opt.Columns = None,
) -> None:
    """Write one self-contained page: the verdict on each log, what happened when, and the method folded away.

    The page needs no network; it can be read without its script, which zooms and sorts. Exit code: 0 written, whatever
    the verdicts; 2 error: also if no log could be read, and then there is no page.
    """
    from mavdiag.report import page
    from mavdiag.report.campaign import read_campaign
    from mavdiag.report.chart import COLUMNS

    check_output(output, baseline, campaign, columns, *(logs or ()))
    if campaign is not None:
        if logs or baseline is not None:
            raise UsageError("--campaign takes neither logs nor --baseline; make two pages")
        write_atomically(output, page.campaign_page(read_campaign(campaign), str(campaign), now()))
        return say(f"written to {output}")
    if not logs or baseline is None:
        raise UsageError("name logs and --baseline FILE, or --campaign FILE")
    reference = Baseline.load(baseline)
    found, mapped = opt.find_logs(logs, columns)
    points = max(LEAST_POINTS, COLUMNS // max(1, len(found.logs) // 4))  # fewer where many logs share a page
    numbered = enumerate(each(found.logs, "drawn"))
    reports = [_flight(one, reference, vehicle, mapped, points, figures=number < DRAWN) for number, one in numbered]
    verdicts = [flight.verdict for flight in reports]
    if all(verdict.verdict is Verdict.ERROR for verdict in verdicts):
        more = f"; nor could {len(reports) - 1} others be read" if len(reports) > 1 else ""
        raise InputError(f"{verdicts[0].log}: {verdicts[0].reason}{more}")
    write_atomically(output, page.flights_page(reports, reference, str(baseline), now()))
    return say(*(f"{verdict.log}: {verdict.verdict}" for verdict in verdicts), f"written to {output}")


def write_report(log: Log, baseline: Baseline, baseline_path: Path, output: Path) -> LogVerdict:
    """Judge one log, write its page, return the verdict. Raises UsageError if it cannot be written."""
    from mavdiag.report.page import flight_report, flights_page

    flight = flight_report(log, baseline)
    write_atomically(output, flights_page([flight], baseline, str(baseline_path), now()))
    return flight.verdict


def _flight(
    named: Named, baseline: Baseline, vehicle: int | None, columns: ColumnMap | None, points: int, *, figures: bool
) -> "FlightReport":
    from mavdiag.report.page import FlightReport, flight_report

    try:
        if named.trouble:
            raise InputError(named.trouble)
        log = read_part(named.path, vehicle, columns=columns)
        return flight_report(log, baseline, points, figures=figures)
    except InputError as error:
        reason = str(error).removeprefix(f"{named.path}: ")
        return FlightReport(LogVerdict(str(named.path), Verdict.ERROR, reason))
