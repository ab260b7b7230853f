"""The `mavdiag-detector` command (edge): watch vehicles over MAVLink and report a damaged propeller.

Exit codes: 0 stopped by SIGINT or SIGTERM; 2 a wrong option, baseline or address, reported in one line on stderr.
"""

import contextlib
import time
from contextlib import ExitStack, closing
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from detector.config import Settings, load_settings, split_metrics_address
from detector.daemon import Daemon, Host
from detector.fitting import ProcessFitter
from detector.journal import Journal, Recorder
from mavdiag import commandline
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.load import airframe_from, with_layout
from mavdiag.baseline import Baseline
from mavdiag.link.ports import open_endpoint

if TYPE_CHECKING:
    from detector.metrics import Metrics

__all__ = ["app", "detect", "main"]

app = commandline.application("Watch vehicles over MAVLink for damaged propellers.")


@app.command()
def detect(
    context: typer.Context,
    connect: Annotated[
        str | None,
        typer.Option(
            metavar="ENDPOINT",
            help="udpin:H:P, udpout:H:P, tcp:H:P, tcpin:H:P or /dev/ttyX,BAUD.  [default: udpin:127.0.0.1:14550]",
        ),
    ] = None,
    baseline: Annotated[Path | None, typer.Option(metavar="FILE", help="Judge by this baseline.")] = None,
    learn: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Learn a baseline first, from so much healthy flight.")
    ] = None,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="Keep what was learned.")] = None,
    airframe: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE.toml", help="What is learned about: its rotors, mass, hover speed and gate."),
    ] = None,
    layout: Annotated[
        str | None,
        typer.Option(
            "--layout",
            "--frame",
            metavar="NAME",
            help="Its rotor layout, as in `mavdiag identify`.  [default: what it shows]",
        ),
    ] = None,
    name: Annotated[
        str | None, typer.Option(metavar="LABEL", help='Label of what is learned.  [default: "vehicle" and its id]')
    ] = None,
    forward: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENDPOINT", help="A further link that gets vehicle and alerts, e.g. a ground station; repeatable."
        ),
    ] = None,
    journal: Annotated[Path | None, typer.Option(metavar="FILE.jsonl", help="Append every event as a line.")] = None,
    record: Annotated[
        Path | None, typer.Option(metavar="FILE.tlog", help="Append every frame that the link brings.")
    ] = None,
    metrics: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Serve Prometheus figures; a bare port is on loopback.")
    ] = None,
    vehicle: Annotated[int | None, typer.Option(metavar="SYSID", help="Watch this system id only.")] = None,
    profile: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="qdrone2, spec, ardupilot or px4.  [default: what the vehicle sends]"),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Settings; options given here win over it.")
    ] = None,
    version: Annotated[bool, commandline.version_option("mavdiag-detector")] = False,
) -> None:
    """Watch vehicles over MAVLink for damaged propellers, until SIGINT or SIGTERM.

    Needs --baseline FILE or --learn SECONDS. It sends a heartbeat, texts, their figures and stream requests, as
    component 191 of the vehicle's system; it never arms and never sets a parameter.

    Exit code 0 when stopped, 2 for a wrong option, baseline or address.
    """
    own = ("config", "version")
    given = {name: value or None if name == "forward" else value for name, value in context.params.items()}
    _serve(load_settings(config, {name: value for name, value in given.items() if name not in own}))


def _serve(settings: Settings) -> None:
    with ExitStack() as stack:
        stop = stack.enter_context(commandline.stop_signals())
        baseline = None if settings.baseline is None else Baseline.load(settings.baseline)
        airframe = _airframe(settings)
        link = stack.enter_context(open_endpoint(settings.connect))
        behind = [stack.enter_context(open_endpoint(address)) for address in settings.forward]
        journal = None if settings.journal is None else stack.enter_context(closing(Journal(settings.journal, _say)))
        recorder = None if settings.record is None else stack.enter_context(closing(_recorder(settings.record)))
        metrics = None if settings.metrics is None else stack.enter_context(closing(_metrics(settings.metrics)))
        daemon = Daemon(
            settings,
            Host(_say),
            link,
            behind,
            baseline=baseline,
            fitter=ProcessFitter(),
            airframe=airframe,
            journal=journal,
            recorder=recorder,
            metrics=metrics,
        )
        daemon.run(stop)


def _airframe(settings: Settings) -> Airframe | None:
    """What the user said of the vehicle that is learned about; None for nothing."""
    told = None if settings.airframe is None else airframe_from(settings.airframe)
    return told if settings.layout is None else with_layout(told or Airframe(), settings.layout)


def _recorder(path: Path) -> Recorder:
    return Recorder(path, time.time_ns() - time.monotonic_ns(), _say)


def _metrics(address: str) -> "Metrics":
    from detector.metrics import Metrics  # only if asked for: the import takes its time

    return Metrics(*split_metrics_address(address))


def _say(text: str) -> None:
    """One log line on stderr, with the local time. A closed or full stderr must not stop the watch."""
    stamp = "" if text.startswith("ready") else f"{datetime.now().astimezone():%H:%M:%S} "
    with contextlib.suppress(OSError):
        typer.echo(stamp + text, err=True)


def main() -> NoReturn:
    """Entry point of the console script."""
    commandline.run(app, "mavdiag-detector")


if __name__ == "__main__":
    main()
