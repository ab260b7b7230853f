"""`mavdiag demo`: the emulator and the detector as two processes over MAVLink, received by a ground station."""

import hashlib
import json
import os
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from mavdiag import __version__
from mavdiag.baseline import Baseline
from mavdiag.commands.identify import make_baseline
from mavdiag.demo.closed_loop import POLL_S, DemoResult, Flight, Loop, closed_loop
from mavdiag.demo.subprocesses import run_child
from mavdiag.errors import BaselineError, UsageError
from mavdiag.face import with_airframe
from mavdiag.learning import thesis_options
from mavdiag.monitors.run_length import RunLengthSpec
from mavdiag.storage import load_baseline, save_baseline

__all__ = ["demo", "own_baseline", "source_digest"]

HEALTHY_FLIGHTS = 60  # one false alarm in 61 flights of equal length, METHOD section 4
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
) -> None:
    """Learn from fast healthy flights, fly healthy, inject a fault, and receive the alert as a ground station does.

    Exit code 0 only if the fault was alerted over MAVLink and nothing was alerted before its onset, else 1.
    """
    if duration < 10:
        raise UsageError(f"--duration {duration:g}: give the flight at least 10 s")
    reference = baseline or own_baseline(quiet=as_json)
    _print_baseline(reference, quiet=as_json)
    onset_s = round(ONSET_SHARE * duration, 1)
    with closed_loop(Flight(duration, fault, rotor, onset_s, seed), reference) as loop:
        _watch(loop, onset_s, duration, quiet=as_json)
    result = DemoResult(onset_s, tuple(loop.station.texts))
    _print_result(result, as_json)
    raise typer.Exit(0 if result.good else 1)


def _print_baseline(reference: Path, *, quiet: bool) -> None:
    thesis = _thesis_monitors(load_baseline(reference))
    if not thesis:
        raise UsageError(f"{reference}: has no fsd monitor; the demo needs one from `mavdiag identify`")
    margin_rad_s, fml_s = thesis[0]
    if not quiet:
        typer.echo(f"baseline {reference}: margin {margin_rad_s:.4f} rad/s, FML {fml_s:.3f} s")


def _thesis_monitors(baseline: Baseline) -> list[tuple[float, float]]:
    """Margin [rad/s] and FML [s] of each axis."""
    entries = ((entry.spec, entry.threshold.value) for entry in baseline.monitors)
    return [(spec.margin_rad_s, fml_s) for spec, fml_s in entries if isinstance(spec, RunLengthSpec)]


def own_baseline(*, quiet: bool) -> Path:
    """The demo's baseline, learnt once from recorded flights of the emulator and kept in the user's cache.

    It is learnt again after any change of the sources that make it.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mavdiag"
    path = cache / f"demo-{__version__}-{source_digest()}.json"
    if _usable(path):
        return path
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
        save_baseline(path, make_baseline(logs, with_airframe(thesis_options(), "qdrone2", "qdrone2 drone 1")))
    return path


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
        return bool(_thesis_monitors(load_baseline(path)))
    except BaselineError:
        return False


def _record(folder: Path, first: int, count: int) -> None:
    run_child(
        "sitl_plant", "record", "-o", str(folder / f"healthy{first:02d}.tlog"), "--flights", str(count),
        "--seed", str(1000 + first), "--duration", f"{HEALTHY_S:g}",
    )  # fmt: skip


def _watch(loop: Loop, onset_s: float, duration_s: float, *, quiet: bool) -> None:
    """Listen until the flight is over, showing it if there is somebody to show it to."""
    from mavdiag.demo.display import Display

    with Display(onset_s, duration_s, quiet=quiet) as display:
        while loop.plant.running:
            loop.station.listen(POLL_S)
            display.show(loop.station)
        loop.station.listen(POLL_S)
        display.show(loop.station)


def _print_result(result: DemoResult, as_json: bool) -> None:
    detected = result.detected_s
    latency = None if detected is None else round(detected - result.onset_s, 3)
    if as_json:
        content = {
            "verdict": "detected" if result.good else "false alarm" if result.false_alarms else "missed",
            "onset_s": result.onset_s,
            "detected_s": detected,
            "latency_s": latency,
            "alerts": [asdict(one) for one in result.alerts],
            "false_alarms": result.false_alarms,
        }
        typer.echo(json.dumps(content))
    elif result.good:
        typer.echo(f"alerted {latency:.2f} s after the onset, and nothing before: the loop is closed")
    else:
        why = f"{result.false_alarms} alerts before the onset" if result.false_alarms else "the fault was not alerted"
        typer.echo(f"not good: {why}")
