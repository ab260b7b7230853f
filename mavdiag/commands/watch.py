"""`mavdiag watch`: a flight in the terminal while it goes on, from a link or from a detector's journal."""

import time
from contextlib import closing
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from mavdiag.baseline import Baseline
from mavdiag.commandline import stop_signals
from mavdiag.commands import options as opt
from mavdiag.errors import UsageError
from mavdiag.link.keys import read_key
from mavdiag.link.ports import open_endpoint
from mavdiag.link.signing import Signing, stamp_at
from mavdiag.telemetry import Axis

LISTENING = ("udpin:", "tcpin:")
SPAN_S = 20.0


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
    from mavdiag.terminal import watching
    from mavdiag.terminal.ground_station import (
        GroundStation,  # here, for rich takes time to load
        LiveJudge,
    )

    until = float("inf") if duration is None else time.monotonic() + duration
    with stop_signals() as stopped:

        def ended() -> bool:
            return stopped() or time.monotonic() >= until

        if not opt.is_endpoint(source):
            if baseline is not None or signing_key is not None:
                raise UsageError("--baseline and --signing-key are for a link; a journal has its verdicts")
            with closing(watching.Journal(Path(source))) as journal:
                return watching.follow(journal, vehicle, ended)
        judged_by, key = (
            None if baseline is None else Baseline.load(baseline),
            None if signing_key is None else read_key(signing_key),
        )

        def signing() -> Signing | None:
            return None if key is None else Signing(key, stamp=stamp_at(time.time_ns()))

        with open_endpoint(source) as endpoint:
            judge = None
            if judged_by is not None:
                judge = LiveJudge(judged_by, span, vehicle, endpoint.datagrams, time.time_ns(), signing())
            speaks = not source.startswith(LISTENING)
            station = GroundStation(endpoint, judge, speaks, vehicle=vehicle, signing=signing())
            return watching.watch(station, endpoint.address, axis, span, ended)
