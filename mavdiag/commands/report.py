"""`mavdiag report`: flights, or a campaign, as one page with figures."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.options import Vehicle
from mavdiag.commands.progress import each
from mavdiag.errors import InputError, UsageError
from mavdiag.face import now, read_log
from mavdiag.judging import LogVerdict, Verdict, judge_in_full
from mavdiag.storage import check_output, write_atomically

if TYPE_CHECKING:
    from mavdiag.report.flight import FlightReport

__all__ = ["report"]

DRAWN = 40  # logs of one page that have figures, so that the page stays small (our choice)
LEAST_COLUMNS = 120


def report(
    logs: Annotated[
        list[Path] | None, typer.Argument(metavar="LOG|DIR", help="Logs to judge, or folders of them.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE.html", help="Page to write.")] = Path(
        "report.html"
    ),
    baseline: Annotated[Path | None, typer.Option(help="Baseline made by `mavdiag identify`.")] = None,
    campaign: Annotated[
        Path | None, typer.Option(metavar="FILE.jsonl", help="Results of `sitl-plant campaign`, instead of logs.")
    ] = None,
    vehicle: Vehicle = None,
) -> None:
    """Write one self-contained page: the verdict on each log, its evidence, and the figures of the thesis.

    The page needs no network and no script. Exit code: 0 written, whatever the verdicts; 2 error.
    """
    check_output(output)
    if campaign is not None:
        if logs or baseline is not None:
            raise UsageError("--campaign takes neither logs nor --baseline; make two pages")
        _campaign(campaign, output)
        return
    if not logs or baseline is None:
        raise UsageError("name logs and --baseline FILE, or --campaign FILE")
    _flights(logs, baseline, output, vehicle)


def _flights(logs: Sequence[Path], baseline: Path, output: Path, vehicle: int | None) -> None:
    from mavdiag.report.page import Made, flights_page
    from mavdiag.report.style import check_matplotlib

    check_matplotlib()
    reference = Baseline.load(baseline)
    paths = _files(logs)
    columns = _columns(len(paths))
    found = [
        _flight(path, reference, vehicle, columns, figures=number < DRAWN)
        for number, path in enumerate(each(paths, "drawing"))
    ]
    write_atomically(output, flights_page(found, reference, Made(now(), str(baseline))))
    for one in found:
        say(f"{one.verdict.log}: {one.verdict.verdict}")
    say(f"written to {output}")


def _flight(path: Path, baseline: Baseline, vehicle: int | None, columns: int, *, figures: bool) -> "FlightReport":
    """One bad log is reported and does not lose the others."""
    from mavdiag.report.flight import flight_report, unread_report

    try:
        log = replace(read_log(path, vehicle=vehicle), name=str(path))
        return flight_report(log, baseline, judge_in_full(log, baseline), columns, figures=figures)
    except InputError as error:
        return unread_report(LogVerdict(str(path), Verdict.ERROR, str(error).removeprefix(f"{path}: ")))


def _files(paths: Sequence[Path]) -> list[Path]:
    """The files that the arguments name, those of a folder in order. Raises InputError if there are none."""
    found = []
    for path in paths:
        if path.is_dir():
            inside = sorted(one for one in path.iterdir() if one.is_file() and not one.name.startswith("."))
            if not inside:
                raise InputError(f"{path}: no file in this folder; name one with logs")
            found += inside
        else:
            found.append(path)
    return found


def _columns(logs: int) -> int:
    """Points across a figure: fewer where many logs share a page."""
    from mavdiag.report.thinned import COLUMNS

    return max(LEAST_COLUMNS, COLUMNS // max(1, logs // 4))


def _campaign(path: Path, output: Path) -> None:
    from mavdiag.report.campaign import read_campaign
    from mavdiag.report.campaign_page import campaign_page

    write_atomically(output, campaign_page(read_campaign(path), str(path), now()))
    say(f"written to {output}")
