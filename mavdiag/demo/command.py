"""`mavdiag demo`: the emulator and the detector as two processes over MAVLink, received by a ground station (edge)."""

import tempfile
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavdiag.as_json import json_line
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.report import write_report
from mavdiag.decision.diagnosis import Change, Stage
from mavdiag.demo.baselines import cache_folder, own_baselines, thesis_rule
from mavdiag.demo.closed_loop import POLL_S, DemoResult, Flight, Loop, closed_loop
from mavdiag.errors import UsageError
from mavdiag.link.messages import Severity
from mavdiag.logs import read_log
from mavdiag.storage import check_output
from mavdiag.telemetry import Axis
from mavdiag.terminal.ground_station import GroundStation
from mavdiag.units import NS_PER_S

if TYPE_CHECKING:  # rich takes time to load
    from mavdiag.terminal.view import Line, View

ONSET_SHARE = 0.4  # of the flight
SPAN_S = 12.0  # that the strips show
DETECTOR, THESIS = "detector: ", "thesis rule: "


def demo(
    as_json: Annotated[bool, typer.Option("--json", help="End with one JSON line.")] = False,
    duration: Annotated[float, typer.Option(metavar="S", help="Flight time.")] = 50.0,
    fault: Annotated[str, typer.Option(metavar="CODE", help="Fault to inject.")] = "F2/SV2",
    rotor: Annotated[int, typer.Option(help="Rotor to damage, 1 to 4.")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of the flight.")] = 1,
    baseline: Annotated[Path | None, typer.Option(help="Use this baseline instead of learning one.")] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="Where the report goes.  [default: the user's cache]")
    ] = None,
) -> None:
    """Learn from fast healthy flights, fly healthy, inject a fault, and receive the alert as a ground station does.

    The detector judges by all monitors; the thesis rule is shown beside it. Exit code 0 only if the fault was alerted
    over MAVLink and nothing was alerted before its onset, else 1.
    """
    from mavdiag.terminal.live_judge import LiveJudge

    if duration < 10:
        raise UsageError(f"--duration {duration:g}: give the flight at least 10 s")
    if report is not None:
        check_output(report)
    fused, thesis = (baseline, baseline) if baseline is not None else own_baselines(quiet=as_json)
    reference = thesis_rule(Baseline.load(thesis))
    if not reference.monitors:
        raise UsageError(f"{thesis}: has no fsd monitor; the demo needs one from `mavdiag identify`")
    if not as_json:
        rule = reference.monitors[0]
        typer.echo(f"thesis rule: margin {rule.spec.margin_rad_s:.4f} rad/s, FML {rule.threshold.value:.3f} s")
    flight = Flight(duration, fault, rotor, round(ONSET_SHARE * duration, 1), seed)
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "flight.tlog"
        with closed_loop(flight, fused, LiveJudge(reference, SPAN_S), record) as loop:
            changes = watch(loop, flight, quiet=as_json)
        result = DemoResult(flight.onset_s, tuple(loop.station.texts))
        if as_json:
            typer.echo(_json(result))
        else:
            _print_result(result, flight, changes)
            _print_report(record, fused, report or cache_folder() / "demo-report.html")
    raise typer.Exit(0 if result.good else 1)


def watch(loop: Loop, flight: Flight, *, quiet: bool) -> list[Change]:
    """Listen until the flight is over, showing it if there is somebody to show it to.

    Returns how the decision of the thesis rule changed.
    """
    from mavdiag.terminal.view import line_for
    from mavdiag.terminal.watching import Screen

    changes: list[Change] = []
    with Screen(lambda events: flight_view(loop.station, flight, events), quiet=quiet) as screen:
        running = True
        while running:
            running = loop.plant.running
            fresh = loop.station.listen(POLL_S)
            changes += [news for news in fresh if isinstance(news, Change)]
            screen.show([line_for(news, DETECTOR, THESIS) for news in fresh], last=not running)
    return changes


def flight_view(station: GroundStation, flight: Flight, events: Sequence["Line"]) -> "View":
    """The picture of a moment. events: so far."""
    from mavdiag.terminal.view import LEGEND, View, figure_levels, levels_of, rate_strips

    now_s, judge = station.t_s, station.judge
    fault = f"{flight.fault} on rotor {flight.rotor}"
    phase = f"damaged: {fault} since" if now_s >= flight.onset_s else f"healthy; {fault} comes at"
    alerts = [line for line in events if line.severity <= Severity.CRITICAL and line.text.startswith(DETECTOR)]
    return View(
        title=f"flight {now_s:.1f} of {flight.duration_s:g} s, {phase} {flight.onset_s:g} s",
        headline=alerts[-1].text.removeprefix(DETECTOR) if alerts else "no alert",
        alert=bool(alerts),
        from_s=now_s - SPAN_S,
        to_s=now_s,
        strips=() if judge is None else rate_strips(judge, Axis.ROLL),
        levels=figure_levels(station) if judge is None else levels_of(judge),
        events=tuple(events),
        foot="" if judge is None else f"{LEGEND}; {judge.link_line}",
    )


def _json(result: DemoResult) -> str:
    detected = result.detected_s
    return json_line(
        {
            "verdict": "detected" if result.good else "false alarm" if result.false_alarms else "missed",
            "onset_s": result.onset_s,
            "detected_s": detected,
            "latency_s": None if detected is None else round(detected - result.onset_s, 3),
            "alerts": [asdict(text) for text in result.alerts],
            "false_alarms": result.false_alarms,
        }
    )


def _print_result(result: DemoResult, flight: Flight, changes: Sequence[Change]) -> None:
    """The story in four lines. changes: of the decision of the thesis rule."""
    onset_s = flight.onset_s
    say(f"injected: {flight.fault} on rotor {flight.rotor} at {onset_s:g} s")
    if result.detected_s is None:
        say("detector: the fault was not alerted")
    else:
        last = [text.text for text in result.alerts if text.t_s >= onset_s][-1]
        say(f"detector: alerted {result.detected_s - onset_s:.2f} s after the onset; it ends with {last!r}")
    faults = (one for one in changes if one.stage is Stage.FAULT and one.t_ns / NS_PER_S >= onset_s)
    if (thesis := next(faults, None)) is None:
        say("thesis rule: it did not alarm after the onset")
    else:
        after_s = thesis.t_ns / NS_PER_S - onset_s
        evidence = f"FSD {thesis.statistic:.3f} s > FML {thesis.threshold:.3f} s on {thesis.axis}"
        say(f"thesis rule: {evidence}, {after_s:.2f} s after the onset; it names no rotor and no type")
    if result.good:
        say("before the onset nothing was alerted: the loop is closed")
    else:
        say(f"not good: {result.false_alarms} alerts before the onset" if result.false_alarms else "not good")


def _print_report(record: Path, baseline: Path, page: Path) -> None:
    """Judge the recorded flight once more, as a log, and draw its report."""
    flown, log = Baseline.load(baseline), replace(read_log(record), name="the demo's flight")
    page.parent.mkdir(parents=True, exist_ok=True)
    verdict = write_report(log, flown, baseline, page)
    say(f"the recorded flight, judged as a log: {verdict}")
    say(f"its report: {page}")
