"""Logs of flights, whatever wrote them: a file becomes the same telemetry as a live link.

The kind of a file is decided by its content, never by its name. A new kind is one row of `_KINDS`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mavdiag.errors import InputError
from mavdiag.logs.log import Log, read_bytes, sha256_of

__all__ = ["Log", "read_log", "sha256_of"]

HEAD_BYTES = 4096


@dataclass(frozen=True, slots=True)
class _Kind:
    """One kind of file: its name for messages, how its first bytes are recognised, and its reader."""

    name: str
    recognise: Callable[[bytes], bool]
    read: Callable[[Path, int | None, str | None], Log]


def _is_dataflash(head: bytes) -> bool:
    """A DataFlash log starts with the format record of the format message: A3 95 80 80."""
    return head.startswith(b"\xa3\x95\x80\x80")


def _is_ulog(head: bytes) -> bool:
    """A ULog starts with 'ULog' and 01 12 35."""
    return head.startswith(b"ULog\x01\x12\x35")


def _is_crazyflie(head: bytes) -> bool:
    """A Crazyflie uSD-card log starts with its token 0xBC."""
    return head.startswith(b"\xbc")


def _is_tlog(head: bytes) -> bool:
    """A telemetry log has a MAVLink marker after its first 8-byte time stamp, or soon after damage."""
    return b"\xfd" in head or b"\xfe" in head


# The readers are imported when a file of their kind is met: each brings a library that the daemon does not need.
def _read_dataflash(path: Path, vehicle: int | None, profile: str | None) -> Log:
    from mavdiag.logs.dataflash import read_dataflash

    return read_dataflash(path)


def _read_ulog(path: Path, vehicle: int | None, profile: str | None) -> Log:
    from mavdiag.logs.ulog import read_ulog

    return read_ulog(path)


def _read_crazyflie(path: Path, vehicle: int | None, profile: str | None) -> Log:
    from mavdiag.logs.crazyflie import read_crazyflie

    return read_crazyflie(path)


def _read_tlog(path: Path, vehicle: int | None, profile: str | None) -> Log:
    from mavdiag.logs.tlog import read_tlog

    return read_tlog(path, vehicle, profile)


_KINDS = (
    _Kind("DataFlash", _is_dataflash, _read_dataflash),
    _Kind("ULog", _is_ulog, _read_ulog),
    _Kind("Crazyflie", _is_crazyflie, _read_crazyflie),
    _Kind("tlog", _is_tlog, _read_tlog),  # last: the weakest signature
)


def read_log(path: Path, vehicle: int | None = None, profile: str | None = None) -> Log:
    """Read a flight from a .tlog, DataFlash .bin, .ulg or Crazyflie log, chosen by its content.

    vehicle: MAVLink system id to read where a file can hold several; None takes the only one there is. profile: link
    profile of a .tlog where its messages do not tell; other kinds know their own.
    Raises InputError, in one line, for a file that is absent, empty, damaged beyond use or of another kind.
    """
    head = read_bytes(path, HEAD_BYTES)
    kind = next((k for k in _KINDS if k.recognise(head)), None)
    if kind is None:
        names = ", ".join(k.name for k in _KINDS)
        raise InputError(f"{path}: not a flight log of a known kind ({names})")
    return kind.read(path, vehicle, profile)
