"""`mavdiag demo`: the emulator and the detector as two processes over MAVLink, received by a ground station."""

import json
import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.report import write_report
from mavdiag.decision.diagnosis import Change
from mavdiag.demo.baselines import cache_folder, own_baselines, thesis_monitors
from mavdiag.demo.closed_loop import DemoResult, Flight, closed_loop
from mavdiag.errors import UsageError
from mavdiag.logs import read_log
from mavdiag.storage import check_output
from mavdiag.units import NS_PER_S

__all__ = ["demo"]

ONSET_SHARE = 0.4  # of the flight


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
    from mavdiag.demo.showing import watch  # rich takes time to load
    from mavdiag.demo.story import SPAN_S, first_crossing
    from mavdiag.terminal.live_judge import LiveJudge

    if duration < 10:
        raise UsageError(f"--duration {duration:g}: give the flight at least 10 s")
    if report is not None:
        check_output(report)
    fused, thesis = (baseline, baseline) if baseline is not None else own_baselines(quiet=as_json)
    _print_baseline(thesis, quiet=as_json)
    flight = Flight(duration, fault, rotor, round(ONSET_SHARE * duration, 1), seed)
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "flight.tlog"
        beside = LiveJudge(Baseline.load(thesis), SPAN_S)
        with closed_loop(flight, fused, beside, record) as loop:
            changes = watch(loop, flight, quiet=as_json)
        result = DemoResult(flight.onset_s, tuple(loop.station.texts))
        if as_json:
            _print_json(result)
        else:
            _print_result(result, flight, first_crossing(changes, flight.onset_s))
            _print_report(record, fused, report or cache_folder() / "demo-report.html")
    raise typer.Exit(0 if result.good else 1)


def _print_baseline(reference: Path, *, quiet: bool) -> None:
    thesis = thesis_monitors(Baseline.load(reference))
    if not thesis:
        raise UsageError(f"{reference}: has no fsd monitor; the demo needs one from `mavdiag identify`")
    margin_rad_s, fml_s = thesis[0]
    if not quiet:
        typer.echo(f"thesis rule: margin {margin_rad_s:.4f} rad/s, FML {fml_s:.3f} s")


def _print_json(result: DemoResult) -> None:
    detected = result.detected_s
    content = {
        "verdict": "detected" if result.good else "false alarm" if result.false_alarms else "missed",
        "onset_s": result.onset_s,
        "detected_s": detected,
        "latency_s": None if detected is None else round(detected - result.onset_s, 3),
        "alerts": [asdict(one) for one in result.alerts],
        "false_alarms": result.false_alarms,
    }
    typer.echo(json.dumps(content))


def _print_result(result: DemoResult, flight: Flight, thesis: Change | None) -> None:
    """The story in four lines."""
    onset_s = flight.onset_s
    say(f"injected: {flight.fault} on rotor {flight.rotor} at {onset_s:g} s")
    if result.detected_s is None:
        say("detector: the fault was not alerted")
    else:
        last = [one.text for one in result.alerts if one.t_s >= onset_s][-1]
        say(f"detector: alerted {result.detected_s - onset_s:.2f} s after the onset; it ends with {last!r}")
    if thesis is None:
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
