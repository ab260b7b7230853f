"""What a kind of log is, and how the content of a file is read."""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from mavdiag.errors import InputError
from mavdiag.rows.gate import GateSpec
from mavdiag.storage import open_regular
from mavdiag.telemetry import Log

#: Logs of the big autopilots have both ends of a flight in them: as live, and its last 0.6 s are dropped (our choice).
RECORDED_GATE = GateSpec(min_thrust=0.1, need_armed=True, trim_start_s=5.0, trim_end_s=0.6)

LOG_BYTES = 2 << 30  # of a log, at most: what it records is held in memory (our choice; half a day at 1 kHz)
TLOG_BYTES = 8 << 30  # of a telemetry log, at most: about as much is held in memory (our choice; two days at 1 kHz)
WINDOW_BYTES = 8 << 20  # of a file that is read piece by piece (our choice: most logs are one piece)

#: Reads a file. The arguments are the path, the MAVLink system id and the link profile, each None if it is not given.
Reader = Callable[[Path, int | None, str | None], Log]


@dataclass(frozen=True, slots=True)
class LogKind:
    """One kind of log; every reader module exposes its own as KIND.

    name: for messages.
    recognise: whether a file's first bytes are of this kind.
    read: the reader.
    profile: the profile of every such log; None where the file's messages show it.
    gate: what counts as flying in it; None where the profile's holds.
    airframe_name: name of the one airframe that writes such logs; None if it may be any.
    variants: other profiles that the reader can be asked for, with the same gate and airframe.
    """

    name: str
    recognise: Callable[[bytes], bool]
    read: Reader
    profile: str | None = None
    gate: GateSpec | None = None
    airframe_name: str | None = None
    variants: tuple[str, ...] = ()

    @property
    def profiles(self) -> tuple[str, ...]:
        """All profiles that its logs can have; none where the file's messages show it."""
        return self.variants if self.profile is None else (self.profile, *self.variants)


def sha256_of(data: bytes) -> str:
    """The SHA-256 of a file's content, hexadecimal: how a baseline names the flights it was fitted to."""
    return hashlib.sha256(data).hexdigest()


def read_bytes(path: Path, limit: int = -1) -> bytes:
    """The content of a log, or its first `limit` bytes. Raises InputError as `windows_of`."""
    return next(windows_of(path, limit, LOG_BYTES if limit < 0 else TLOG_BYTES))


def windows_of(path: Path, size: int = WINDOW_BYTES, most: int = LOG_BYTES) -> Iterator[bytes]:
    """The content of a log piece by piece, in order. Raises InputError if it cannot be read, is empty or too large."""
    try:
        with open_regular(path, most) as file:
            window = file.read(size)
            if not window:
                raise InputError(f"{path}: the file is empty; record the flight again")
            while window:
                yield window
                window = file.read(size)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); check the path") from error
