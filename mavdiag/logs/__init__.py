"""Logs of flights, whatever wrote them: a file becomes the same telemetry as a live link.

The kind of a file is decided by its content, never by its name. A new kind is a reader module that exposes KIND, and
its name in `_READERS`.
"""

from functools import cache
from importlib import import_module
from pathlib import Path

from mavdiag.airframe.vehicle_type import refusal
from mavdiag.errors import InputError, UsageError
from mavdiag.logs.csv_columns import ColumnMap, read_csv
from mavdiag.logs.log import LogKind, read_bytes
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import Log

HEAD_BYTES = 4096
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
        return read_csv(path, columns)
    kind = _kind_of(path)
    if kind is None:
        raise InputError(f"{path}: not a flight log of a known kind ({', '.join(known.name for known in kinds())})")
    log = kind.read(path, vehicle, profile)
    if refused := refusal(log.mav_type):
        raise InputError(f"{path}: {refused}")
    return log


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
