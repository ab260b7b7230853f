"""The demo's two baselines, learnt once from flights of the emulator and kept in the user's cache (edge)."""

import os
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import typer

from mavdiag import __version__
from mavdiag.archive.sources import digest_of_sources
from mavdiag.baseline import Baseline
from mavdiag.commands.identify import make_baseline
from mavdiag.demo.subprocesses import run_child
from mavdiag.errors import BaselineError
from mavdiag.face import with_airframe
from mavdiag.learning import LearnOptions, thesis_options
from mavdiag.monitors.run_length import RunLengthSpec

HEALTHY_FLIGHTS = 60  # one false alarm of the thesis rule in 61 flights of equal length, METHOD section 4
FUSED_FLIGHTS = 20  # of them that teach all monitors: their thresholds follow from a law, not from the highest value
HEALTHY_S = 40.0
UNUSED_S = 30 * 86_400.0  # after which a baseline is deleted (our choice)


def thesis_rule(baseline: Baseline) -> Baseline:
    """The part of a baseline that judges by the thesis's rule alone; without monitors if it has none."""
    rules = tuple(entry for entry in baseline.monitors if isinstance(entry.spec, RunLengthSpec))
    return baseline.model_copy(update={"monitors": rules})


def own_baselines(*, quiet: bool) -> tuple[Path, Path]:
    """The demo's two baselines, of all monitors and of the thesis rule, learnt once from flights of the emulator.

    They are kept in the user's cache, and learnt again after any change of the sources that make them. Those of other
    versions, which may be running, are deleted when they were not used for a month.
    """
    cache, digest = cache_folder(), digest_of_sources(("mavdiag", "sitl_plant"), ("__pycache__",))
    fused, thesis = (cache / f"demo-{name}-{__version__}-{digest}.json" for name in ("fused", "thesis"))
    if _usable(fused) and _usable(thesis):
        return fused, thesis
    cache.mkdir(parents=True, exist_ok=True)
    delete_unused(cache, time.time())
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


def delete_unused(cache: Path, now_s: float) -> None:
    """Delete the demo's baselines that were not used for UNUSED_S. now_s: unix time [s]."""
    for kept in cache.glob("demo-*.json"):
        with suppress(FileNotFoundError):  # another demo was quicker
            if now_s - kept.stat().st_mtime > UNUSED_S:
                kept.unlink()


def cache_folder() -> Path:
    """Where the demo keeps what it made."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mavdiag"


def _usable(path: Path) -> bool:
    """Whether there is one, and it can be read; then it is marked as used now."""
    try:
        usable = bool(thesis_rule(Baseline.load(path)).monitors)
    except BaselineError:
        return False
    with suppress(OSError):
        os.utime(path)
    return usable


def _record(folder: Path, first: int, count: int) -> None:
    run_child(
        "sitl_plant", "record", "-o", str(folder / f"healthy{first:02d}.tlog"), "--flights", str(count),
        "--seed", str(1000 + first), "--duration", f"{HEALTHY_S:g}",
    )  # fmt: skip
