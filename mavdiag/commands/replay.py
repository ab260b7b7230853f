"""`mavdiag replay`: a log as if it were flown now, in the terminal or on the live page."""

import os
import sys
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from mavdiag.baseline import Baseline
from mavdiag.commandline import stop_signals
from mavdiag.commands import options as opt
from mavdiag.commands.watch import SPAN_S
from mavdiag.logs import read_log
from mavdiag.telemetry import Axis

PAGE = "detector.replay"  # the module that plays on the live page; the daemon's package, so it is a process of its own


def replay(
    log: Annotated[Path, Argument(metavar="LOG", help="A flight log of any kind that `mavdiag scan` reads.")],
    baseline: opt.BaselineFile,
    speed: Annotated[float, Option(min=0.01, metavar="X", help="Times as fast as flown; inf does not wait.")] = 1.0,
    web: Annotated[
        str | None, Option(metavar="HOST:PORT", help="Play on the live page there; a bare port is on loopback.")
    ] = None,
    web_token_file: Annotated[
        Path | None, Option(metavar="FILE", help="Token of the page: a file of mode 0600.")
    ] = None,
    from_s: Annotated[float, Option("--from", min=0.0, metavar="S", help="Begin so many seconds into the log.")] = 0.0,
    vehicle: opt.Vehicle = None,
    axis: Annotated[Axis, Option(help="Whose rates the terminal's strips show.")] = Axis.ROLL,
) -> None:
    """Play a log as if it were flown now: judged as a link is, and shown as `watch` or the live page show a flight.

    In the terminal the arrow keys go back and on by 10 s, the space bar stops it, and q ends it. On the page it can be
    stopped, sped up, and moved to any time; that needs the extra `web`. On a pipe it prints one line an event.
    """
    if web is not None:
        given = {"web-token-file": web_token_file, "vehicle": vehicle, "speed": speed, "from-s": from_s}
        options = [part for name, value in given.items() if value is not None for part in (f"--{name}", str(value))]
        os.execv(sys.executable, [sys.executable, "-P", "-m", PAGE, *options, "--", str(log), str(baseline), web])
    from mavdiag.judging import suited
    from mavdiag.terminal.ground_station import LiveJudge  # here, for rich takes time to load
    from mavdiag.terminal.playing import play

    with stop_signals() as stopped:
        read, known = read_log(log, vehicle), Baseline.load(baseline)
        fitting = suited(known, read)

        def begin() -> LiveJudge:
            return LiveJudge(fitting, SPAN_S, vehicle, began_ns=read.started_ns)

        play(read, begin, speed, from_s, axis, stopped)
