"""`mavdiag inspect`: which rates, units and profile arrive?"""

import itertools
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from mavdiag.commands.options import AsJson, Vehicle
from mavdiag.link.keys import read_key
from mavdiag.link.link import open_link
from mavdiag.logs import read_log
from mavdiag.printable import printable
from mavdiag.telemetry import FloatArray, Log, Series
from mavdiag.units import NS_PER_S

__all__ = ["Summary", "inspect", "summary"]

ADDRESSES = ("udpin:", "udpout:", "tcp:", "tcpin:", "/dev/")
USUAL = 3.0  # steps above this multiple of the median are gaps, and no jitter (our choice)


@dataclass(frozen=True, slots=True)
class Summary:
    """One signal as it arrives.

    signal, unit: what it measures.
    samples: how many there are.
    rate_hz: their mean rate, gaps included; None with fewer than two times.
    jitter_ms: standard deviation of the steps that are no gaps.
    longest_gap_s: the longest step.
    lowest, highest: of each column; None where a column holds no number.
    """

    signal: str
    unit: str
    samples: int
    rate_hz: float | None
    jitter_ms: float | None
    longest_gap_s: float | None
    lowest: tuple[float | None, ...]
    highest: tuple[float | None, ...]


def inspect(
    source: Annotated[str, typer.Argument(metavar="ENDPOINT|LOG", help="udpin:127.0.0.1:14550, ... or a log file.")],
    duration: Annotated[float, typer.Option(metavar="S", help="How long to listen to an endpoint.")] = 5.0,
    vehicle: Vehicle = None,
    profile: Annotated[str | None, typer.Option(metavar="NAME", help="Link profile, where it is not clear.")] = None,
    signing_key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Hear only what is signed with this key (MAVLink 2 signing).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure each signal of a log or a live link: rate, jitter, gaps, and its range in SI units."""
    if source.startswith(ADDRESSES):
        key = None if signing_key is None else read_key(signing_key)
        with open_link(source, vehicle, profile, key) as link:
            log = link.record(duration)
    else:
        log = read_log(Path(source), vehicle, profile)
    found = [summary(series) for series in log.telemetry.series if len(series)]
    if as_json:
        signals = [asdict(one) for one in found]
        typer.echo(json.dumps({"source": source, "profile": log.profile, "notes": log.notes, "signals": signals}))
    else:
        _print(log, found)


def summary(series: Series) -> Summary:
    """Figures of one signal, which has samples."""
    steps: FloatArray = np.diff(np.unique(series.t_ns)).astype(np.float64) / NS_PER_S
    rate = jitter = gap = None
    if len(steps):
        rate, gap = float(len(steps) / steps.sum()), float(steps.max())
        jitter = 1e3 * float(steps[steps < USUAL * np.median(steps)].std())
    known = [column[np.isfinite(column)] for column in series.values.T]
    lowest, highest = (tuple(float(of(column)) if len(column) else None for column in known) for of in (np.min, np.max))
    return Summary(series.signal, series.unit, len(series), rate, jitter, gap, lowest, highest)


def _print(log: Log, found: list[Summary]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False)
    console.print(printable(f"{log.name}: profile {log.profile}"), soft_wrap=True, markup=False)
    for note in log.notes:
        console.print(printable(f"note: {note}"), soft_wrap=True, markup=False)
    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("signal", "samples", "rate\nHz", "jitter\nms", "longest\ngap s"):
        table.add_column(heading, justify="left" if heading == "signal" else "right", no_wrap=True)
    table.add_column("range of each column")
    for one in found:
        each = (_range(low, high) for low, high in zip(one.lowest, one.highest, strict=True))
        counted = ((text, len(list(some))) for text, some in itertools.groupby(each))
        ranges = "\n".join(text if count == 1 else f"{text} ({count} columns)" for text, count in counted)
        timing = (_number(one.rate_hz, 1), _number(one.jitter_ms, 2), _number(one.longest_gap_s, 3))
        table.add_row(f"{one.signal}\n  {one.unit}".rstrip(), str(one.samples), *timing, ranges)
    console.print(table)


def _range(low: float | None, high: float | None) -> str:
    return "no number" if low is None or high is None else f"{low:.3g}..{high:.3g}"


def _number(value: float | None, places: int) -> str:
    return "-" if value is None else f"{value:.{places}f}"
