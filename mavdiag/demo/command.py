"""`mavdiag demo`: the emulator and the detector as two processes over MAVLink, received by a ground station."""

import hashlib
import json
import os
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer
from rich.panel import Panel

from mavdiag import __version__
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.identify import make_baseline
from mavdiag.commands.report import write_report
from mavdiag.decision.diagnosis import Change
from mavdiag.demo.closed_loop import POLL_S, DemoResult, Flight, Loop, closed_loop
from mavdiag.demo.story import DETECTOR, SPAN_S, THESIS, first_crossing, flight_view
from mavdiag.demo.subprocesses import run_child
from mavdiag.errors import BaselineError, UsageError
from mavdiag.face import with_airframe
from mavdiag.judging import judge
from mavdiag.learning import LearnOptions, thesis_options
from mavdiag.logs import read_log
from mavdiag.monitors.run_length import RunLengthSpec
from mavdiag.storage import check_output
from mavdiag.terminal.live_judge import LiveJudge
from mavdiag.terminal.screen import Screen
from mavdiag.terminal.view import Line, picture
from mavdiag.terminal.views import line_for
from mavdiag.units import NS_PER_S

__all__ = ["cache_folder", "demo", "own_baselines", "source_digest"]

HEALTHY_FLIGHTS = 60  # one false alarm of the thesis rule in 61 flights of equal length, METHOD section 4
FUSED_FLIGHTS = 20  # of them that teach all monitors: their thresholds follow from a law, not from the highest value
HEALTHY_S = 40.0
ONSET_SHARE = 0.4  # of the flight
SOURCES = (".py", ".toml", ".json")


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
            changes = _watch(loop, flight, quiet=as_json)
        result = DemoResult(flight.onset_s, tuple(loop.station.texts))
        if as_json:
            _print_json(result)
        else:
            _print_result(result, flight, first_crossing(changes, flight.onset_s))
            _print_report(record, fused, report or cache_folder() / "demo-report.html")
    raise typer.Exit(0 if result.good else 1)


def _print_baseline(reference: Path, *, quiet: bool) -> None:
    thesis = _thesis_monitors(Baseline.load(reference))
    if not thesis:
        raise UsageError(f"{reference}: has no fsd monitor; the demo needs one from `mavdiag identify`")
    margin_rad_s, fml_s = thesis[0]
    if not quiet:
        typer.echo(f"thesis rule: margin {margin_rad_s:.4f} rad/s, FML {fml_s:.3f} s")


def _thesis_monitors(baseline: Baseline) -> list[tuple[float, float]]:
    """Margin [rad/s] and FML [s] of each axis."""
    entries = ((entry.spec, entry.threshold.value) for entry in baseline.monitors)
    return [(spec.margin_rad_s, fml_s) for spec, fml_s in entries if isinstance(spec, RunLengthSpec)]


def own_baselines(*, quiet: bool) -> tuple[Path, Path]:
    """The demo's two baselines, of all monitors and of the thesis rule, learnt once from flights of the emulator.

    They are kept in the user's cache, and learnt again after any change of the sources that make them.
    """
    cache, digest = cache_folder(), source_digest()
    fused, thesis = (cache / f"demo-{name}-{__version__}-{digest}.json" for name in ("fused", "thesis"))
    if _usable(fused) and _usable(thesis):
        return fused, thesis
    cache.mkdir(parents=True, exist_ok=True)
    for stale in cache.glob("demo-*.json"):
        stale.unlink(missing_ok=True)
    if not quiet:
        typer.echo(f"recording {HEALTHY_FLIGHTS} healthy flights of {HEALTHY_S:g} s, as fast as they go ...")
    with tempfile.TemporaryDirectory() as folder:
        half = HEALTHY_FLIGHTS // 2
        with ThreadPoolExecutor(2) as pool:  # one process a core of a small machine
            list(pool.map(lambda first: _record(Path(folder), first, half), (0, half)))
        logs = sorted(Path(folder).glob("*.tlog"))
        if not quiet:
            typer.echo("identifying the healthy airframe ...")
        learnt = ((thesis, thesis_options(), logs), (fused, LearnOptions(), logs[:FUSED_FLIGHTS]))
        for path, options, flights in learnt:
            make_baseline(flights, with_airframe(options, "qdrone2", "qdrone2 drone 1")).save(path)
    return fused, thesis


def cache_folder() -> Path:
    """Where the demo keeps what it made."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mavdiag"


def source_digest(packages: Sequence[str] = ("mavdiag", "sitl_plant")) -> str:
    """Digest of all that these packages consist of, 12 hexadecimal digits; a package that is absent counts as empty."""
    digest = hashlib.sha256()
    for package in packages:
        spec = find_spec(package)
        for folder in (spec.submodule_search_locations or ()) if spec is not None else ():
            files = (path for path in Path(folder).rglob("*") if path.suffix in SOURCES)
            for path in sorted(files):
                digest.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def _usable(path: Path) -> bool:
    """Whether there is one, and it can be read."""
    try:
        return bool(_thesis_monitors(Baseline.load(path)))
    except BaselineError:
        return False


def _record(folder: Path, first: int, count: int) -> None:
    run_child(
        "sitl_plant", "record", "-o", str(folder / f"healthy{first:02d}.tlog"), "--flights", str(count),
        "--seed", str(1000 + first), "--duration", f"{HEALTHY_S:g}",
    )  # fmt: skip


def _watch(loop: Loop, flight: Flight, *, quiet: bool) -> list[Change]:
    """Listen until the flight is over, showing it if there is somebody to show it to.

    Returns how the decision of the thesis rule changed.
    """
    changes: list[Change] = []
    events: list[Line] = []

    def draw(width: int) -> Panel:
        return picture(flight_view(loop.station, flight, events), width)

    with Screen(quiet=quiet) as screen:
        running = True
        while running:
            running = loop.plant.running
            fresh = loop.station.listen(POLL_S)
            changes += [one for one in fresh if isinstance(one, Change)]
            lines = [line_for(one, DETECTOR, THESIS) for one in fresh]
            events.extend(lines)
            screen.show(draw, lines, last=not running)
    return changes


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
    """Judge the recorded flight once more, as a log, and draw its report where the extra `report` is installed."""
    flown, log = Baseline.load(baseline), replace(read_log(record), name="the demo's flight")
    if find_spec("matplotlib") is None:
        verdict, where = judge(log, flown), "none, for matplotlib is not installed: pip install 'mavdiag[report]'"
    else:
        page.parent.mkdir(parents=True, exist_ok=True)
        verdict, where = write_report(log, flown, baseline, page), str(page)
    say(f"the recorded flight, judged as a log: {verdict}")
    say(f"its report: {where}")
