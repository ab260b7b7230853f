"""The part of a log between two times."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from mavdiag.errors import InputError, UsageError
from mavdiag.logs import read_log
from mavdiag.logs.csv_columns import ColumnMap
from mavdiag.telemetry import Log, Series, Telemetry
from mavdiag.units import NS_PER_S


def read_part(
    path: Path,
    vehicle: int | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
    columns: ColumnMap | None = None,
    profile: str | None = None,
) -> Log:
    """A log, or the part of it between two times [s], under the path as given. Raises as `read_log` and `between`."""
    log = read_log(path, vehicle, profile, columns)
    try:
        return replace(log, name=str(path), telemetry=between(log.telemetry, from_s, to_s))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def between(telemetry: Telemetry, from_s: float | None, to_s: float | None) -> Telemetry:
    """The part of a log between two times of the vehicle's clock [s].

    Raises UsageError if a time is not a number, and InputError if the part is empty.
    """
    check_times(from_s, to_s)
    if from_s is None and to_s is None:
        return telemetry
    low, high = (-math.inf if from_s is None else from_s), (math.inf if to_s is None else to_s)
    kept = []
    for series in telemetry:
        inside = (series.t_ns >= low * NS_PER_S) & (series.t_ns < high * NS_PER_S)
        kept.append(Series(series.signal, series.t_ns[inside], series.host_ns[inside], series.values[inside]))
    if not any(map(len, kept)):
        times = np.concatenate([np.empty(0), *(series.t_s for series in telemetry.series)])
        span = f"it goes from {times.min():.1f} to {times.max():.1f} s" if len(times) else "it is empty"
        wanted = " ".join(f"{word} {t:g} s" for word, t in (("from", from_s), ("to", to_s)) if t is not None)
        raise InputError(f"no data {wanted} of the vehicle's clock; {span}")
    return Telemetry(tuple(kept))


def check_times(from_s: float | None, to_s: float | None) -> None:
    """Raise UsageError if a time is not a number [s]."""
    for name, value in (("--from", from_s), ("--to", to_s)):
        if value is not None and not math.isfinite(value):
            raise UsageError(f"{name} {value}: give a time in seconds of the vehicle's clock")
