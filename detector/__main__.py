"""The `mavdiag-detector` command (edge): watch vehicles over MAVLink and report a damaged propeller."""

if __name__ == "__main__":  # before what takes time to load
    from mavdiag.__main__ import start

    start("detector.__main__")

import contextlib
import gc
import inspect
import os
import threading
import time
from contextlib import ExitStack, closing
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from detector.config import NOT_KEPT, Settings, collect_values, example_text, load_settings, options, split_address
from detector.daemon import Daemon, Host
from detector.fitting import ProcessFitter
from detector.flights import Flights
from detector.hooks import Courier, Hook, close_all
from detector.journal import Journal, Recorder, baselines_in, check_files, kept_baselines
from detector.notify import Notifier
from detector.web.access import Access
from mavdiag import commandline
from mavdiag.airframe.airframe import Airframe
from mavdiag.baseline import Baseline
from mavdiag.chain import warm
from mavdiag.errors import UsageError
from mavdiag.inspections import Inspections
from mavdiag.link.keys import open_signing
from mavdiag.link.ports import open_endpoint
from mavdiag.storage import COLLECT_AT
from mavdiag.telemetry import Instant

if TYPE_CHECKING:
    from detector.web.feed import Feed

COMPILE_S = 3.0  # before it is said; to load what was compiled takes half a second (our choice)

app = commandline.application("Watch vehicles over MAVLink for damaged propellers.", alone=True)


def _flag(name: str, text: str) -> Any:
    return typer.Option(name, help=text)


def detect(
    config: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Settings; options given here win over it.")
    ] = None,
    reset_stamp: Annotated[
        bool, _flag("--reset-stamp", "Forget the signing stamp that is kept: once, after the clock was ahead.")
    ] = False,
    check: Annotated[
        bool, _flag("--check", "Check the settings and files, print what a start would do, and exit.")
    ] = False,
    print_config: Annotated[bool, _flag("--print-config", "Print a documented configuration file, and exit.")] = False,
    working: Annotated[
        bool, _flag("--working", "Ask the daemon that serves --metrics whether it works: exit code 0 or 1.")
    ] = False,
    **given: Any,
) -> None:
    """Watch vehicles over MAVLink for damaged propellers, until SIGINT or SIGTERM.

    Needs --baseline FILE or --learn SECONDS. It sends a heartbeat, texts, their figures and stream requests, as
    component 191 of the vehicle's system; it never arms and never sets a parameter. Only --on-fault lets it command.

    Every setting of --config but `vehicles` can be given in the environment too, as MAVDIAG_DETECTOR_ and its name in
    capitals.

    Exit code 0 when stopped, 1 if --working finds it does not work, 2 for a wrong option, baseline or address.
    """
    given = {name: value or None if isinstance(value, list) else value for name, value in given.items()}
    if print_config:
        typer.echo(example_text(), nl=False)
    elif working:
        from detector.check import ask_working  # only if asked for: the import takes its time

        metrics = collect_values(config, given, os.environ)[0].get("metrics")
        reason = ask_working(None if metrics is None else str(metrics))
        commandline.say(f"not working: {reason}" if reason else "working")
        raise typer.Exit(1 if reason else 0)
    elif check:
        from detector.check import plan

        settings = load_settings(config, given, os.environ)
        commandline.say(*plan(settings, *_baselines(settings), _airframe(settings)))
    else:
        _serve(load_settings(config, given, os.environ), reset_stamp=reset_stamp)


own = [parameter for parameter in inspect.signature(detect).parameters.values() if parameter.name != "given"]
detect.__signature__ = inspect.Signature([*own, *options()])  # type: ignore[attr-defined]  # of a function
app.command()(detect)


def _serve(settings: Settings, *, reset_stamp: bool) -> None:
    check_files(settings)
    if reset_stamp and settings.signing_key is None:
        raise UsageError("--reset-stamp is about the stamp of a signing key; name it with --signing-key FILE")
    with ExitStack() as stack:
        enter = stack.enter_context
        stop = enter(commandline.stop_signals())
        notifier = enter(closing(Notifier(os.environ)))
        baseline, baselines = _baselines(settings)
        airframe = _airframe(settings)
        if settings.learn is not None and settings.save is None:
            _say(f"what is learned is {NOT_KEPT}")
        _warm()
        signing, journal, recorder, flights, metrics, web = None, None, None, None, None, None
        if settings.signing_key is not None:
            kept = open_signing(settings.signing_key, "detector", time.time_ns(), reset=reset_stamp)
            signing = enter(closing(kept))
            if signing.doubt:
                _say(signing.doubt)
        link = enter(open_endpoint(settings.connect))
        behind = [enter(open_endpoint(address, absent_ok=True)) for address in settings.forward]
        if settings.journal is not None:
            journal = enter(closing(Journal(settings.journal, _say, settings.journal_mb, settings.journal_keep)))
        if settings.record is not None:
            sizes = settings.record_mb, settings.record_keep
            recorder = enter(closing(Recorder(settings.record, _say, *sizes)))
        hooks = [Hook(address, _say) for address in settings.hook]
        stack.callback(close_all, couriers := list[Courier[Any]](hooks))
        if settings.history is not None:
            flights = Flights(settings.history, settings.flights or Path(), _say)
            couriers.append(flights)
        if settings.metrics is not None:
            from detector.metrics import Metrics  # only if asked for: the import takes its time

            metrics = enter(closing(Metrics(*split_address(settings.metrics, "metrics"))))
        if settings.web is not None:
            web = enter(closing(_web(settings, settings.web)))
        gc.set_threshold(COLLECT_AT)
        gc.freeze()  # what is there by now stays: to go through it again would hold up the link
        Daemon(
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
            hooks=hooks,
            flights=flights,
            metrics=metrics,
            web=web,
            notifier=notifier,
            signing=signing,
            inspections=Inspections(settings.journal, _say),
        ).run(stop)


def _warm() -> None:
    telling = threading.Timer(COMPILE_S, _say, ["loading what judges; after an installation it is compiled first"])
    telling.daemon = True
    telling.start()
    try:
        warm()
    finally:
        telling.cancel()


def _baselines(settings: Settings) -> tuple[Baseline | None, dict[int | str, Baseline]]:
    """The baseline for all vehicles, and those of single ones, by system id or uid; what was learned earlier, too."""
    baseline = None if settings.baseline is None else Baseline.load(settings.baseline)
    learned = {} if settings.learn is None or settings.save is None else kept_baselines(settings.save)
    baseline = learned.pop(0, baseline)
    folder = {} if settings.baselines is None else baselines_in(settings.baselines)
    return baseline, learned | folder | {sysid: Baseline.load(own.baseline) for sysid, own in settings.vehicles.items()}


def _airframe(settings: Settings) -> Airframe | None:
    if settings.airframe is None and settings.layout is None:
        return None
    from mavdiag.airframe.load import airframe_from, with_layout  # only if asked for

    told = Airframe() if settings.airframe is None else airframe_from(settings.airframe)
    return told if settings.layout is None else with_layout(told, settings.layout)


def _web(settings: Settings, address: str) -> "Feed":
    from detector.web.child import ServerProcess, read_token  # only if asked for
    from detector.web.feed import Feed

    token = None if settings.web_token_file is None else read_token(settings.web_token_file)
    child = ServerProcess(
        Access(*split_address(address, "web"), token, settings.web_names), f"{time.time_ns():x}", _say
    )
    child.start()
    return Feed(child, Instant(time.monotonic_ns()))


def _say(text: str) -> None:
    """One log line on stderr, with the local time. A closed or full stderr must not stop the watch."""
    stamp = "" if text.startswith("ready") else f"{datetime.now().astimezone():%H:%M:%S} "
    with contextlib.suppress(OSError):
        commandline.say(stamp + text, err=True)


def main() -> NoReturn:
    """Entry point of the console script."""
    commandline.run(app, "mavdiag-detector")
