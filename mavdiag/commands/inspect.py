"""`mavdiag inspect`: what rates, units and profile do I really get?"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from mavdiag.link.link import open_link
from mavdiag.logs import read_log
from mavdiag.telemetry import FloatArray, Log, Series
from mavdiag.units import NS_PER_S

__all__ = ["inspect"]


def inspect(
    source: Annotated[str, typer.Argument(metavar="ENDPOINT|LOG", help="udpin:127.0.0.1:14550, ... or a log file.")],
    duration: Annotated[float, typer.Option(metavar="S", help="How long to listen to an endpoint.")] = 5.0,
    vehicle: Annotated[int | None, typer.Option(metavar="SYSID", help="System id, where there are several.")] = None,
    profile: Annotated[str | None, typer.Option(metavar="NAME", help="Link profile, where it is not clear.")] = None,
) -> None:
    """Measure each signal of a log or a live link: rate, jitter, gaps, and its range in SI units."""
    if _is_address(source):
        with open_link(source, vehicle, profile) as link:
            _print(link.record(duration))
    else:
        _print(read_log(Path(source), vehicle, profile))


def _is_address(source: str) -> bool:
    return source.startswith(("udpin:", "udpout:", "tcp:", "tcpin:", "/dev/"))


def _print(log: Log) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{log.name}: profile {log.profile}")
    for heading in ("signal", "samples", "rate Hz", "jitter ms", "longest gap s", "range of each column"):
        table.add_column(heading, justify="right", overflow="fold")
    for series in log.telemetry.series:
        if len(series):
            table.add_row(series.signal, str(len(series)), *_timing(series), _extent(series))
    console = Console()
    console.print(table)
    for note in log.notes:
        console.print(f"note: {note}")


def _timing(series: Series) -> tuple[str, str, str]:
    """Rate by the median step, jitter as the standard deviation of the usual steps, and the longest step."""
    steps: FloatArray = np.diff(np.unique(series.t_ns)).astype(np.float64) / NS_PER_S
    if len(steps) == 0:
        return "-", "-", "-"
    median = float(np.median(steps))
    usual = steps[steps < 3 * median]
    return f"{1 / median:.1f}", f"{1e3 * float(usual.std()):.3f}", f"{float(steps.max()):.3f}"


def _extent(series: Series) -> str:
    columns = (column[np.isfinite(column)] for column in series.values.T)
    return ", ".join(f"{known.min():.3g}..{known.max():.3g}" if len(known) else "-" for known in columns)
