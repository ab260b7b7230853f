"""The `mavdiag-detector` command (edge): watch vehicles over MAVLink and report a damaged propeller.

Exit codes: 0 stopped by SIGINT or SIGTERM; 1 not working (--working); 2 a wrong option, baseline or address, in
one line on stderr.
"""

import contextlib
import os
import threading
import time
from contextlib import ExitStack, closing
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from detector.appender import Rotation
from detector.config import (
    Settings,
    collect_values,
    example_text,
    load_settings,
    split_metrics_address,
    split_web_address,
)
from detector.daemon import Daemon, Host
from detector.fitting import ProcessFitter
from detector.journal import Journal, Recorder
from detector.notify import Notifier
from detector.reporting import kept_baselines
from detector.web.token import read_token
from mavdiag import commandline
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.load import airframe_from, with_layout
from mavdiag.baseline import Baseline
from mavdiag.chain import warm
from mavdiag.inspections import Inspections
from mavdiag.link.keys import KeptSigning, open_signing
from mavdiag.link.ports import open_endpoint
from mavdiag.printable import printable
from mavdiag.telemetry import Instant

if TYPE_CHECKING:
    from detector.metrics import Metrics
    from detector.web.feed import Feed

__all__ = ["app", "detect", "main"]

COMPILE_S = 3.0  # of compiling before it is said; to load what was compiled takes half a second (our choice)

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
    save: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Keep what was learned; where it is there, judge by it.")
    ] = None,
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
    keep_rates: Annotated[
        bool | None, typer.Option("--keep-rates", help="Keep back what from there would change the rates needed here.")
    ] = None,
    journal: Annotated[Path | None, typer.Option(metavar="FILE.jsonl", help="Append every event as a line.")] = None,
    record: Annotated[
        Path | None, typer.Option(metavar="FILE.tlog", help="Append every frame that the link brings.")
    ] = None,
    metrics: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Serve Prometheus figures; a bare port is on loopback.")
    ] = None,
    web: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT", help="Serve the live page; a bare port is on loopback, elsewhere it needs a token."
        ),
    ] = None,
    web_token_file: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The token that the live page asks for: a file of mode 0600.")
    ] = None,
    vehicle: Annotated[int | None, typer.Option(metavar="SYSID", help="Watch this system id only.")] = None,
    signing_key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Key of MAVLink 2 signing: sign, and refuse what is not signed.")
    ] = None,
    reset_stamp: Annotated[
        bool,
        typer.Option("--reset-stamp", help="Forget the signing stamp that is kept: once, after the clock was ahead."),
    ] = False,
    profile: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="qdrone2, spec, ardupilot or px4.  [default: what the vehicle sends]"),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Settings; options given here win over it.")
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Check the settings and files, print what a start would do, and exit.")
    ] = False,
    print_config: Annotated[
        bool, typer.Option("--print-config", help="Print a documented configuration file, and exit.")
    ] = False,
    working: Annotated[
        bool, typer.Option("--working", help="Ask the daemon that serves --metrics whether it works: exit code 0 or 1.")
    ] = False,
    version: Annotated[bool, commandline.version_option("mavdiag-detector")] = False,
) -> None:
    """Watch vehicles over MAVLink for damaged propellers, until SIGINT or SIGTERM.

    Needs --baseline FILE or --learn SECONDS. It sends a heartbeat, texts, their figures and stream requests, as
    component 191 of the vehicle's system; it never arms and never sets a parameter.

    Every setting of --config can be given in the environment too, as MAVDIAG_DETECTOR_ and its name in capitals.

    Exit code 0 when stopped, 1 if --working finds it does not work, 2 for a wrong option, baseline or address.
    """
    own = ("config", "version", "check", "print_config", "working", "reset_stamp")
    given = {name: value or None if name == "forward" else value for name, value in context.params.items()}
    given = {name: value for name, value in given.items() if name not in own}
    if print_config:
        typer.echo(example_text(), nl=False)
    elif working:
        _working(config, given)
    elif check:
        _check(load_settings(config, given, os.environ))
    else:
        _serve(load_settings(config, given, os.environ), reset_stamp=reset_stamp)


def _working(config: Path | None, given: dict[str, object]) -> None:
    from detector.working import ask_working  # only if asked for: the import takes its time

    values, _ = collect_values(config, given, os.environ)
    metrics = values.get("metrics")
    works, words = ask_working(None if metrics is None else str(metrics))
    commandline.say(words)
    raise typer.Exit(0 if works else 1)


def _check(settings: Settings) -> None:
    from detector.check import plan

    commandline.say(plan(settings, *_baselines(settings), _airframe(settings)))


def _serve(settings: Settings, *, reset_stamp: bool) -> None:
    with ExitStack() as stack:
        stop = stack.enter_context(commandline.stop_signals())
        notifier = stack.enter_context(closing(Notifier(os.environ)))
        baseline, baselines = _baselines(settings)
        airframe = _airframe(settings)
        _warm()
        signing = _signing(settings, stack, reset=reset_stamp)
        link = stack.enter_context(open_endpoint(settings.connect))
        behind = [stack.enter_context(open_endpoint(address, absent_ok=True)) for address in settings.forward]
        journal = (
            None if settings.journal is None else stack.enter_context(closing(_journal(settings, settings.journal)))
        )
        recorder = (
            None if settings.record is None else stack.enter_context(closing(_recorder(settings, settings.record)))
        )
        metrics = None if settings.metrics is None else stack.enter_context(closing(_metrics(settings.metrics)))
        web = _web(settings, stack)
        daemon = Daemon(
            settings,
            Host(_say),
            link,
            behind,
            baseline=baseline,
            baselines=baselines,
            fitter=ProcessFitter(),
            airframe=airframe,
            journal=journal,
            recorder=recorder,
            metrics=metrics,
            web=web,
            notifier=notifier,
            signing=signing,
            inspections=Inspections(settings.journal, _say),
        )
        daemon.run(stop)


def _warm() -> None:
    """Compile what judges before the first frame comes; say so where it takes long, as after an installation."""
    late = threading.Timer(COMPILE_S, _say, ["compiling what judges; only the first start after an installation does"])
    late.start()
    try:
        warm()
    finally:
        late.cancel()


def _signing(settings: Settings, stack: ExitStack, *, reset: bool) -> KeptSigning | None:
    key = settings.signing_key
    if key is None:
        return None
    signing = stack.enter_context(closing(open_signing(key, "detector", time.time_ns(), reset=reset)))
    if signing.doubt:
        _say(signing.doubt)
    return signing


def _baselines(settings: Settings) -> tuple[Baseline | None, dict[int, Baseline]]:
    """The baseline for all vehicles, and those of single ones, by system id; what was learned earlier among them."""
    baseline = None if settings.baseline is None else Baseline.load(settings.baseline)
    kept = {} if settings.learn is None or settings.save is None else kept_baselines(settings.save)
    learned = {sysid: one for sysid, (_, one) in kept.items()}
    baseline = learned.pop(0, baseline)
    return baseline, learned | {sysid: Baseline.load(one.baseline) for sysid, one in settings.vehicles.items()}


def _airframe(settings: Settings) -> Airframe | None:
    """What the user said of the vehicle that is learned about; None for nothing."""
    told = None if settings.airframe is None else airframe_from(settings.airframe)
    return told if settings.layout is None else with_layout(told or Airframe(), settings.layout)


def _journal(settings: Settings, path: Path) -> Journal:
    return Journal(path, _say, Rotation.of(settings.journal_mb, settings.journal_keep), settings.journal_fsync)


def _recorder(settings: Settings, path: Path) -> Recorder:
    rotation = Rotation.of(settings.record_mb, settings.record_keep)
    return Recorder(path, time.time_ns() - time.monotonic_ns(), _say, rotation)


def _metrics(address: str) -> "Metrics":
    from detector.metrics import Metrics  # only if asked for: the import takes its time

    return Metrics(*split_metrics_address(address))


def _web(settings: Settings, stack: ExitStack) -> "Feed | None":
    """The live page, once it is served."""
    if settings.web is None:
        return None
    from detector.web.child import Place, ServerProcess  # only if asked for: the import takes its time
    from detector.web.feed import Feed

    token = None if settings.web_token_file is None else read_token(settings.web_token_file)
    child = ServerProcess(Place(*split_web_address(settings.web), token), f"{time.time_ns():x}", _say)
    child.start()
    return stack.enter_context(closing(Feed(child, Instant(time.monotonic_ns()))))


def _say(text: str) -> None:
    """One log line on stderr, with the local time. A closed or full stderr must not stop the watch."""
    stamp = "" if text.startswith("ready") else f"{datetime.now().astimezone():%H:%M:%S} "
    with contextlib.suppress(OSError):
        commandline.say(stamp + printable(text), err=True)


def main() -> NoReturn:
    """Entry point of the console script."""
    commandline.run(app, "mavdiag-detector")


if __name__ == "__main__":
    main()
