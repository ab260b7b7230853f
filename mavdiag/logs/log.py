"""What every log reader returns, and the two helpers that all of them need."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from mavdiag.errors import InputError
from mavdiag.telemetry import Telemetry

__all__ = ["Log", "read_bytes", "sha256_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """One vehicle's flight as a file tells it.

    name: what to call it in a report (the file's name). sha256: of the whole file, hexadecimal.
    profile: the link profile that its signals follow, a key of `mavdiag.link.profiles.PROFILES`, or the reader's own
    name for a kind of log that is no link.
    started_ns: wall-clock time of the first record, unix epoch [ns]; 0 if the file does not say.
    """

    name: str
    sha256: str
    profile: str
    telemetry: Telemetry
    started_ns: int


def sha256_of(data: bytes) -> str:
    """The SHA-256 of a file's content, hexadecimal: how a baseline names the flights it was fitted to."""
    return hashlib.sha256(data).hexdigest()


def read_bytes(path: Path, limit: int = -1) -> bytes:
    """The content of a log, or its first `limit` bytes. Raises InputError if it cannot be read or is empty."""
    try:
        with path.open("rb") as file:
            data = file.read(limit)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); check the path") from error
    if not data:
        raise InputError(f"{path}: the file is empty; record the flight again")
    return data
