"""Logs of flights, whatever wrote them: a file becomes the same telemetry as a live link.

A file's kind is decided by its content, never by its name. A new one is a module that has KIND, named in `_READERS`.
"""

import math
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np

from mavdiag.airframe.vehicle_type import refusal
from mavdiag.errors import InputError, UsageError
from mavdiag.logs.csv_columns import ColumnMap, read_csv
from mavdiag.logs.log import LogKind, read_bytes
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.grid import LEAST_SAMPLES, onward, steps_of
from mavdiag.telemetry import Log, Signal, Telemetry
from mavdiag.units import NS_PER_S

HEAD_BYTES = 4096
PARTS, CHANGED = 8, 1.5  # of a log whose usual rates are compared; by more they are two rates (our choice)
_READERS = ("dataflash", "ulog", "crazyflie", "dronepropa", "tlog", "csv_columns")  # tlog: a weak signature


@cache
def kinds() -> tuple[LogKind, ...]:
    """All kinds of logs. The readers are imported here, at the first need: the daemon has none."""
    return tuple(import_module(f"mavdiag.logs.{name}").KIND for name in _READERS)


def read_log(
    path: Path, vehicle: int | None = None, profile: str | None = None, columns: ColumnMap | None = None
) -> Log:
    """Read a flight from a .tlog, DataFlash .bin, .ulg, Crazyflie or DronePropA log, chosen by its content.

    vehicle: MAVLink system id to read where a file can hold several. profile: link profile of a .tlog whose messages do
    not show it, or a variant of another kind. columns: the file is a CSV recording with these columns.
    Raises InputError, in one line, for a file that is absent, empty, damaged beyond use or of another kind, and for a
    vehicle that is no multirotor.
    """
    if columns is not None:
        return onward(read_csv(path, columns))
    kind = _kind_of(path)
    if kind is None:
        raise InputError(f"{path}: not a flight log of a known kind ({', '.join(known.name for known in kinds())})")
    log = kind.read(path, vehicle, profile)
    if refused := refusal(log.mav_type):
        raise InputError(f"{path}: {refused}")
    return onward(log)


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
        part = between(log.telemetry, from_s, to_s)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    started_ns, notes = log.started_ns and log.epoch_ns + part.first_ns, (*log.notes, *_rate_notes(part))
    return replace(log, name=str(path), telemetry=part, started_ns=started_ns, notes=notes)


def _rate_notes(telemetry: Telemetry) -> tuple[str, ...]:
    """Whether the gyro came faster in one part of a log than in another: all of it is judged by one rate."""
    gyro = telemetry.get(Signal.BODY_RATE)
    steps = np.empty(0) if gyro is None else steps_of(gyro.t_ns)
    if len(steps) < PARTS * LEAST_SAMPLES:
        return ()
    rates_hz = [NS_PER_S / float(np.median(part)) for part in np.array_split(steps, PARTS)]
    slow, fast = min(rates_hz), max(rates_hz)
    told = f"the gyro comes at {slow:.0f} Hz in one part of the log and at {fast:.0f} Hz in another: cut it there"
    return (told,) if fast > CHANGED * slow else ()


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
        kept.append(series.where(inside))
    if not any(map(len, kept)):
        times = np.concatenate([np.empty(0), *(series.t_s for series in telemetry.series)])
        span = f"it goes from {times.min():.1f} to {times.max():.1f} s" if len(times) else "it is empty"
        wanted = " ".join(f"{word} {t:.10g} s" for word, t in (("from", from_s), ("to", to_s)) if t is not None)
        raise InputError(f"no data {wanted} of the vehicle's clock; {span}")
    return Telemetry(tuple(kept))


def check_times(from_s: float | None, to_s: float | None) -> None:
    """Raise UsageError if a time is not a number [s]."""
    for name, value in (("--from", from_s), ("--to", to_s)):
        if value is not None and not math.isfinite(value):
            raise UsageError(f"{name} {value}: give a time in seconds of the vehicle's clock")


def is_log(path: Path) -> bool:
    """Whether a file is a log of a known kind, by its first bytes. Raises InputError if it cannot be read."""
    return _kind_of(path) is not None


def _kind_of(path: Path) -> LogKind | None:
    head = read_bytes(path, HEAD_BYTES)
    return next((kind for kind in kinds() if kind.recognise(head)), None)


def gate_for(profile: str) -> GateSpec:
    """What counts as flying, by the profile of a link or of a kind of log. Raises UsageError for an unknown profile."""
    from mavdiag.link.profiles import PROFILES  # loads the MAVLink dialect, which no reader but that of .tlog needs

    found = next((kind.gate for kind in kinds() if profile in kind.profiles), None)
    if found is not None:
        return found
    if profile not in PROFILES:
        names = (*PROFILES, *(name for kind in kinds() for name in kind.profiles))
        raise UsageError(f"no profile {profile}; there are {', '.join(names)}")
    return PROFILES[profile].gate


def airframe_name_for(profile: str) -> str | None:
    """Name of the one airframe whose logs have this profile, None if it may be any or comes over a link."""
    return next((kind.airframe_name for kind in kinds() if profile in kind.profiles), None)
