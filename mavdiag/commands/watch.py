"""`mavdiag watch`: a flight in the terminal while it goes on; `mavdiag replay`: a log as if it were flown now."""

import os
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from mavdiag.baseline import Baseline
from mavdiag.commandline import stop_signals
from mavdiag.commands import options as opt
from mavdiag.errors import InputError, UsageError
from mavdiag.link.keys import read_key
from mavdiag.link.ports import open_endpoint
from mavdiag.logs import read_log
from mavdiag.telemetry import Axis

LISTENING = ("udpin:", "tcpin:")
SPAN_S = 20.0
PAGE = "detector.replay"  # the module that plays on the live page; the daemon's package, so it is a process of its own


def watch(
    source: Annotated[str, Argument(metavar="ENDPOINT|JOURNAL", help="A link, or a detector's journal.")],
    baseline: Annotated[Path | None, Option(metavar="FILE", help="Judge here, too: strips and monitors.")] = None,
    vehicle: opt.Vehicle = None,
    axis: Annotated[Axis, Option(help="Whose rates the strips show.")] = Axis.ROLL,
    span: Annotated[float, Option(min=1.0, metavar="S", help="How much of the flight the strips show.")] = SPAN_S,
    duration: Annotated[float | None, Option(min=0.0, metavar="S", help="Stop after so long.")] = None,
    signing_key: opt.SigningKey = None,
) -> None:
    """Watch a flight: a link with its detector's alerts, or the journal that a detector writes.

    Give the detector `--forward udpout:HOST:PORT` and watch `udpin:HOST:PORT`. Without --baseline the detector's own
    figures and texts are shown. On a link that it listens on it sends nothing, on others a ground station's heartbeat.
    On a pipe it prints one line an event.
    """
    from mavdiag.terminal import watching  # here, for rich takes time to load
    from mavdiag.terminal.ground_station import GroundStation, LiveJudge

    until = float("inf") if duration is None else time.monotonic() + duration
    with stop_signals() as stopped:

        def ended() -> bool:
            return stopped() or time.monotonic() >= until

        if not opt.is_endpoint(source):
            if baseline is not None or signing_key is not None:
                raise UsageError("--baseline and --signing-key are for a link; a journal has its verdicts")
            with closing(watching.Journal(Path(source))) as journal:
                watching.follow(journal, vehicle, ended)
            return
        judged_by = None if baseline is None else Baseline.load(baseline)
        judge = None if judged_by is None else LiveJudge(judged_by, span, time.time_ns())
        key = None if signing_key is None else read_key(signing_key)
        with open_endpoint(source) as endpoint:
            station = GroundStation(endpoint, judge, not source.startswith(LISTENING), vehicle, key)
            watching.watch(station, endpoint.address, axis, span, ended)
            if not station.heard and stopped():
                raise KeyboardInterrupt
            if not station.heard:
                raise InputError(endpoint.absent or f"{endpoint.address}: {watching.SILENT}")


def replay(
    log: Annotated[Path, Argument(metavar="LOG", help="A flight log of any kind but CSV.")],
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
    from mavdiag.judging import playable
    from mavdiag.terminal.ground_station import LiveJudge  # here, for rich takes time to load
    from mavdiag.terminal.watching import play

    with stop_signals() as stopped:
        read, known = read_log(log, vehicle), Baseline.load(baseline)
        fitting = playable(known, read, from_s)
        begun_ns = read.started_ns
        play(read, lambda: LiveJudge(fitting, SPAN_S, begun_ns), speed, from_s, axis, stopped)
