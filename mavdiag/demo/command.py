"""`mavdiag demo`: the emulator and the detector as two processes over MAVLink, received by a ground station (edge)."""

import re
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavdiag import __version__
from mavdiag.archive.paths import check_output
from mavdiag.archive.scan import digest_of_sources, own_cache
from mavdiag.as_json import json_line
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.identify import make_baseline
from mavdiag.commands.report import write_report
from mavdiag.decision.diagnosis import Change, Stage
from mavdiag.demo.subprocesses import DemoResult, Flight, closed_loop, run_child
from mavdiag.errors import BaselineError, UsageError
from mavdiag.face import with_airframe
from mavdiag.learning import LearnOptions, thesis_options
from mavdiag.logs import read_log
from mavdiag.monitors.run_length import RunLengthSpec
from mavdiag.telemetry import Axis
from mavdiag.terminal.ground_station import GroundStation, Line
from mavdiag.units import NS_PER_S

if TYPE_CHECKING:  # rich takes time to load
    from mavdiag.terminal.view import View

CODE = re.compile(r"\s*F[123]\s*[/\\_-]?\s*SV[123]\s*", re.IGNORECASE)  # as the emulator has it
ONSET_SHARE = 0.3  # of the flight
SPAN_S = 12.0  # that the strips show
DETECTOR, THESIS = "detector: ", "thesis rule: "
QUICK_FLIGHTS = 4  # healthy ones: the first alert comes within a minute
THOROUGH_FLIGHTS = 60  # one false alarm of the thesis rule in 61 flights of equal length, METHOD section 4
FUSED_FLIGHTS = 20  # of them that teach all monitors: their thresholds follow from a law, not from the highest value
HEALTHY_S = 40.0


def demo(
    as_json: Annotated[bool, typer.Option("--json", help="End with one JSON line.")] = False,
    duration: Annotated[float, typer.Option(min=10.0, max=1e6, metavar="S", help="Flight time.")] = 50.0,
    fault: Annotated[str, typer.Option(metavar="CODE", help="Fault to inject.")] = "F2/SV2",
    rotor: Annotated[int, typer.Option(min=1, max=4, help="Rotor to damage.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the flight.")] = 1,
    baseline: Annotated[Path | None, typer.Option(help="Use this baseline instead of learning one.")] = None,
    thorough: Annotated[
        bool, typer.Option("--thorough", help=f"Learn from {THOROUGH_FLIGHTS} flights, as the thesis's rule asks.")
    ] = False,
    report: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="Where the report goes.  [default: the user's cache]")
    ] = None,
) -> None:
    """Learn from fast healthy flights, fly healthy, inject a fault, and receive the alert as a ground station does.

    The detector judges by all monitors; the thesis rule is shown beside it. Exit code 0 only if the fault was alerted
    over MAVLink and nothing was alerted before its onset, else 1.
    """
    from mavdiag.terminal.ground_station import LiveJudge
    from mavdiag.terminal.watching import listen

    if not CODE.fullmatch(fault):
        raise UsageError(f"--fault {fault}: give F1, F2 or F3 with SV1, SV2 or SV3, as in F2/SV2")
    if report is not None:
        check_output(report, baseline)
    fused, thesis = (baseline, baseline) if baseline is not None else own_baselines(quiet=as_json, thorough=thorough)
    reference = thesis_rule(Baseline.load(thesis))
    if not reference.monitors:
        raise UsageError(f"{thesis}: has no fsd monitor; the demo needs one from `mavdiag identify`")
    if not as_json:
        rule = reference.monitors[0]
        typer.echo(f"thesis rule: margin {rule.spec.margin_rad_s:.4f} rad/s, FML {rule.threshold.value:.3f} s")
    flight = Flight(duration, fault, rotor, round(ONSET_SHARE * duration, 1), seed)
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "flight.tlog"
        with closed_loop(flight, fused, LiveJudge(reference, SPAN_S), record) as (plant, _, station):
            view, whose = partial(flight_view, station, flight), (DETECTOR, THESIS)
            changes = listen(station, view, whose, lambda: not plant.running, quiet=as_json)
        result = DemoResult.of(flight.onset_s, station.texts)
        if not as_json:
            _print_result(result, flight, changes)
        if report is not None or not as_json:
            page, log = report or own_cache() / "demo-report.html", replace(read_log(record), name="the demo's flight")
            page.parent.mkdir(parents=True, exist_ok=True)
            verdict = write_report(log, Baseline.load(fused), fused, page)
            say(f"the recorded flight, judged as a log: {verdict}", err=as_json)
            say(f"its report: {page}", err=as_json)
        if as_json:
            typer.echo(json_line(asdict(result)))
    raise typer.Exit(0 if result.verdict == "detected" else 1)


def thesis_rule(baseline: Baseline) -> Baseline:
    """The part of a baseline that judges by the thesis's rule alone; without monitors if it has none."""
    rules = tuple(entry for entry in baseline.monitors if isinstance(entry.spec, RunLengthSpec))
    return baseline.model_copy(update={"monitors": rules})


def own_baselines(*, quiet: bool, thorough: bool = False) -> tuple[Path, Path]:
    """The demo's baselines, of all monitors and of the thesis rule, learnt anew after any change of the sources."""
    cache, digest = own_cache(), digest_of_sources(("mavdiag", "sitl_plant"))
    count = THOROUGH_FLIGHTS if thorough else QUICK_FLIGHTS
    fused, thesis = (cache / f"demo-{name}-{count}-{__version__}-{digest}.json" for name in ("fused", "thesis"))
    if _usable(fused) and _usable(thesis):
        return fused, thesis
    cache.mkdir(parents=True, exist_ok=True)
    if not quiet:
        typer.echo(f"recording {count} healthy flights of {HEALTHY_S:g} s, as fast as they go ...")
    with tempfile.TemporaryDirectory() as folder:
        half = count // 2

        def record(first: int) -> None:
            file = str(Path(folder) / f"healthy{first:02d}.tlog")
            flights = ("--flights", str(half), "--seed", str(1000 + first), "--duration", f"{HEALTHY_S:g}")
            run_child("sitl_plant", "record", "-o", file, *flights)

        with ThreadPoolExecutor(2) as pool:  # one process a core of a small machine
            list(pool.map(record, (0, half)))
        logs = sorted(Path(folder).glob("*.tlog"))
        if not quiet:
            typer.echo("identifying the healthy airframe ...")
        learnt = ((thesis, thesis_options(), logs), (fused, LearnOptions(), logs[:FUSED_FLIGHTS]))
        for path, options, flights in learnt:
            make_baseline(flights, with_airframe(options, "qdrone2", "qdrone2 drone 1")).save(path)
    return fused, thesis


def _usable(path: Path) -> bool:
    try:
        return bool(thesis_rule(Baseline.load(path)).monitors)
    except BaselineError:
        return False


def flight_view(station: GroundStation, flight: Flight, events: Sequence[Line]) -> "View":
    """The picture of a moment. events: so far."""
    from mavdiag.terminal.watching import link_view

    now_s, fault = station.t_s, f"{flight.fault} on rotor {flight.rotor}"
    phase = f"damaged: {fault} since" if now_s >= flight.onset_s else f"healthy; {fault} comes at"
    alerts = [line for line in events if line.alert and line.text.startswith(DETECTOR)]
    shown = link_view(station, now_s, SPAN_S, Axis.ROLL, events)
    title = f"flight {now_s:.1f} of {flight.duration_s:g} s, {phase} {flight.onset_s:g} s"
    says = alerts[-1].text.removeprefix(DETECTOR) if alerts else "no alert"
    return replace(shown, title=title, headline=says, stage=Stage.FAULT if alerts else Stage.QUIET)


def _print_result(result: DemoResult, flight: Flight, changes: Sequence[Change]) -> None:
    onset_s = flight.onset_s
    say(f"injected: {flight.fault} on rotor {flight.rotor} at {onset_s:g} s")
    if result.latency_s is None:
        say("detector: the fault was not alerted")
    else:
        say(f"detector: alerted {result.latency_s:.2f} s after the onset; it ends with {result.alerts[-1].text!r}")
    faults = [one for one in changes if one.stage is Stage.FAULT and one.t_ns / NS_PER_S >= onset_s]
    for thesis in faults[:1]:
        after_s = thesis.t_ns / NS_PER_S - onset_s
        evidence = f"FSD {thesis.statistic:.3f} s > FML {thesis.threshold:.3f} s on {thesis.axis}"
        say(f"thesis rule: {evidence}, {after_s:.2f} s after the onset; it names no rotor and no type")
    if not faults:
        say("thesis rule: it did not alarm after the onset")
    if result.verdict == "detected":
        say("before the onset nothing was alerted: the loop is closed")
    else:
        say(f"not good: {result.false_alarms} alerts before the onset" if result.false_alarms else "not good")
