"""`mavdiag demo`: the emulator and the detector as two processes over MAVLink, heard by a ground station."""

import json
import os
import re
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from mavdiag import __version__
from mavdiag.commands.children import Child, child, run_child
from mavdiag.commands.ground import GroundStation, Heard
from mavdiag.commands.identify import make_baseline
from mavdiag.commands.options import AxisChoice
from mavdiag.errors import LinkError, UsageError
from mavdiag.learning import LearnOptions
from mavdiag.link.endpoint import open_endpoint
from mavdiag.link.messages import Severity
from mavdiag.storage import load_baseline, save_baseline

__all__ = ["demo"]

HEALTHY_FLIGHTS = 60  # one false alarm in 61 flights of equal length, METHOD section 4
HEALTHY_S = 40.0
ONSET_SHARE = 0.4  # of the flight
READY_S = 20.0
POLL_S = 0.05


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the ground station saw. Times in seconds of flight; detected_s is None if nothing was alerted in time."""

    onset_s: float
    texts: tuple[Heard, ...]

    @property
    def alerts(self) -> tuple[Heard, ...]:
        """Declared faults."""
        return tuple(one for one in self.texts if one.severity <= Severity.CRITICAL)

    @property
    def false_alarms(self) -> int:
        """Faults that were declared before there was one."""
        return sum(one.t_s < self.onset_s for one in self.alerts)

    @property
    def detected_s(self) -> float | None:
        """When the fault was first alerted."""
        return next((one.t_s for one in self.alerts if one.t_s >= self.onset_s), None)

    @property
    def good(self) -> bool:
        """Alerted after the onset, and silent before."""
        return self.detected_s is not None and self.false_alarms == 0


def demo(
    as_json: Annotated[bool, typer.Option("--json", help="End with one JSON line.")] = False,
    duration: Annotated[float, typer.Option(metavar="S", help="Flight time.")] = 50.0,
    fault: Annotated[str, typer.Option(metavar="CODE", help="Fault to inject.")] = "F2/SV2",
    rotor: Annotated[int, typer.Option(help="Rotor to damage, 1 to 4.")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of the flight.")] = 1,
    baseline: Annotated[Path | None, typer.Option(help="Use this baseline instead of learning one.")] = None,
) -> None:
    """Learn from fast healthy flights, fly healthy, inject a fault, and hear the alert as a ground station does.

    Exit code 0 only if the fault was alerted over MAVLink and nothing was alerted before its onset, else 1.
    """
    if duration < 10:
        raise UsageError(f"--duration {duration:g}: give the flight at least 10 s")
    reference = baseline or _own_baseline(as_json)
    monitor = load_baseline(reference).monitors[0]
    if not as_json:
        typer.echo(f"baseline {reference}: margin {monitor.margin_rad_s:.4f} rad/s, FML {monitor.fml_s:.3f} s")
    onset_s = round(ONSET_SHARE * duration, 1)
    with _vehicle_and_detector(reference, fault, rotor, onset_s, duration, seed) as (plant, station):
        _watch(plant, station, onset_s, duration, quiet=as_json)
    outcome = Outcome(onset_s, tuple(station.texts))
    _tell(outcome, as_json)
    raise typer.Exit(0 if outcome.good else 1)


def _own_baseline(quiet: bool) -> Path:
    """The demo's baseline, learnt once from recorded flights of the emulator and kept in the user's cache."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mavdiag"
    path = cache / f"demo-{__version__}.json"
    if path.exists():
        return path
    cache.mkdir(parents=True, exist_ok=True)
    if not quiet:
        typer.echo(f"recording {HEALTHY_FLIGHTS} healthy flights of {HEALTHY_S:g} s, as fast as they go ...")
    with tempfile.TemporaryDirectory() as folder:
        half = HEALTHY_FLIGHTS // 2
        with ThreadPoolExecutor(2) as pool:  # one process a core of a small machine
            list(pool.map(lambda first: _record(Path(folder), first, half), (0, half)))
        logs = sorted(Path(folder).glob("*.tlog"))
        if not quiet:
            typer.echo("identifying the healthy airframe ...")
        save_baseline(path, make_baseline(logs, LearnOptions(axes=AxisChoice.ROLL.axes, airframe="qdrone2 drone 1")))
    return path


def _record(folder: Path, first: int, count: int) -> None:
    run_child(
        "sitl_plant", "record", "-o", str(folder / f"healthy{first:02d}.tlog"), "--flights", str(count),
        "--seed", str(1000 + first), "--duration", f"{HEALTHY_S:g}",
    )  # fmt: skip


@contextmanager
def _vehicle_and_detector(
    baseline: Path, fault: str, rotor: int, onset_s: float, duration_s: float, seed: int
) -> Iterator[tuple[Child, GroundStation]]:
    with (
        open_endpoint("udpin:127.0.0.1:0") as endpoint,
        child("detector", "--connect", "udpin:127.0.0.1:0", "--baseline", str(baseline)) as detector,
    ):
        line = detector.wait_for("ready", READY_S)
        heard = re.search(r"udpin:([\d.]+:\d+)", line)
        if heard is None:
            raise LinkError(f"the detector did not say where it listens: {line}")
        with child(
            "sitl_plant", "run", "--out", f"udpout:{heard[1]}", "--out", endpoint.address.replace("udpin", "udpout"),
            "--fault", fault, "--rotor", str(rotor), "--onset", f"{onset_s:g}", "--duration", f"{duration_s:g}",
            "--seed", str(seed),
        ) as plant:  # fmt: skip
            plant.wait_for("flies", READY_S)
            yield plant, GroundStation(endpoint)


def _watch(plant: Child, station: GroundStation, onset_s: float, duration_s: float, *, quiet: bool) -> None:
    """Listen until the flight is over, showing it if there is somebody to show it to."""
    from mavdiag.commands.display import Display

    with Display(onset_s, duration_s, quiet=quiet) as display:
        while plant.running:
            station.listen(POLL_S)
            display.show(station)
    station.listen(POLL_S)


def _tell(outcome: Outcome, as_json: bool) -> None:
    detected = outcome.detected_s
    latency = None if detected is None else round(detected - outcome.onset_s, 3)
    if as_json:
        typer.echo(
            json.dumps(
                {
                    "verdict": "detected" if outcome.good else "false alarm" if outcome.false_alarms else "missed",
                    "onset_s": outcome.onset_s,
                    "detected_s": detected,
                    "latency_s": latency,
                    "alerts": [{"severity": one.severity, "text": one.text, "t_s": one.t_s} for one in outcome.alerts],
                    "false_alarms": outcome.false_alarms,
                }
            )
        )
    elif outcome.good:
        typer.echo(f"alerted {latency:.2f} s after the onset, and nothing before: the loop is closed")
    else:
        why = f"{outcome.false_alarms} alerts before the onset" if outcome.false_alarms else "the fault was not alerted"
        typer.echo(f"not good: {why}")
