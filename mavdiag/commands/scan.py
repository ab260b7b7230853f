"""`mavdiag scan`: judge logs by a baseline."""

import json
from pathlib import Path
from typing import Annotated

import typer

from mavdiag.baseline import Baseline
from mavdiag.commands.options import read_part
from mavdiag.errors import InputError
from mavdiag.judging import LogVerdict, Verdict, exit_code, judge
from mavdiag.report import verdict_json
from mavdiag.storage import load_baseline

__all__ = ["scan"]


def scan(
    logs: Annotated[list[Path], typer.Argument(help="Logs to judge: .tlog, .bin, .ulg, Crazyflie.")],
    baseline: Annotated[Path, typer.Option(help="Baseline made by `mavdiag identify`.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object a line per log.")] = False,
    vehicle: Annotated[int | None, typer.Option(metavar="SYSID", help="System id to read from a .tlog.")] = None,
    from_s: Annotated[float | None, typer.Option("--from", metavar="S", help="Vehicle time to start at.")] = None,
    to_s: Annotated[float | None, typer.Option("--to", metavar="S", help="Vehicle time to stop at.")] = None,
) -> None:
    """Judge logs. Exit code: 0 healthy, 1 fault, 2 error, 3 not judgeable; of several logs the first of 2, 1, 3, 0."""
    reference = load_baseline(baseline)
    verdicts: list[LogVerdict] = []
    for path in logs:
        verdict = _judge(path, reference, vehicle, from_s, to_s)
        verdicts.append(verdict)
        if as_json:
            typer.echo(json.dumps(verdict_json(verdict)))
        else:
            typer.echo(f"{path}: {verdict.verdict.value}, {verdict.reason} ({verdict.judged_s:.1f} s judged)")
    raise typer.Exit(exit_code([verdict.verdict for verdict in verdicts]))


def _judge(path: Path, baseline: Baseline, vehicle: int | None, from_s: float | None, to_s: float | None) -> LogVerdict:
    """One bad log is reported and does not lose the others."""
    try:
        return judge(read_part(path, vehicle, from_s, to_s), baseline)
    except InputError as error:
        return LogVerdict(str(path), Verdict.ERROR, str(error))
