"""`mavdiag scan`: judge logs by a baseline."""

import json
from pathlib import Path
from typing import Annotated

import typer

from mavdiag.as_json import verdict_json
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.options import AsJson, FromS, ToS, Vehicle, read_part
from mavdiag.commands.progress import each
from mavdiag.errors import InputError
from mavdiag.judging import LogVerdict, Verdict, exit_code, judge

__all__ = ["scan"]


def scan(
    logs: Annotated[list[Path], typer.Argument(help="Logs to judge: .tlog, .bin, .ulg, Crazyflie, DronePropA.")],
    baseline: Annotated[Path, typer.Option(help="Baseline made by `mavdiag identify`.")],
    as_json: AsJson = False,
    vehicle: Vehicle = None,
    from_s: FromS = None,
    to_s: ToS = None,
) -> None:
    """Judge logs. Exit code: 0 healthy, 1 fault, 2 error, 3 not judgeable; of several logs the first of 2, 1, 3, 0."""
    reference = Baseline.load(baseline)
    verdicts: list[LogVerdict] = []
    for path in each(logs, "judging"):
        verdict = _judge(path, reference, vehicle, from_s, to_s)
        verdicts.append(verdict)
        say(json.dumps(verdict_json(verdict)) if as_json else _line(verdict))
    raise typer.Exit(exit_code([verdict.verdict for verdict in verdicts]))


def _judge(path: Path, baseline: Baseline, vehicle: int | None, from_s: float | None, to_s: float | None) -> LogVerdict:
    """One bad log is reported and does not lose the others."""
    try:
        return judge(read_part(path, vehicle, from_s, to_s), baseline)
    except InputError as error:
        return LogVerdict(str(path), Verdict.ERROR, str(error).removeprefix(f"{path}: "))


def _line(verdict: LogVerdict) -> str:
    """The verdict in one line: what, why, and how long each monitor judged."""
    line = f"{verdict.log}: {verdict.verdict}, {verdict.reason}"
    if verdict.verdict is Verdict.ERROR:
        return line
    parts = [
        f"{one.name} {one.judged_s:.1f} s" + (f" ({one.not_judged})" if one.not_judged else "")
        for one in verdict.monitors
    ]
    return f"{line}; judged {verdict.judged_s:.1f} s" + (f": {', '.join(parts)}" if parts else "")
