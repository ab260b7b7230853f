"""The file with a signing key, and the time stamp that is kept beside it (edge: it reads and writes files).

A key file holds one line: 64 hexadecimal digits are the key itself; anything else is a passphrase, whose SHA-256 is the
key, as in MAVProxy (`signing setup PASSPHRASE`), Mission Planner and QGroundControl.
"""

import hashlib
import os
import re
from pathlib import Path

from mavdiag.errors import InputError, UsageError
from mavdiag.link.signing import STALE, Signing, stamp_at
from mavdiag.storage import open_regular, read_text, write_atomically

AHEAD = 9_000_000  # what is kept is so far ahead of the stamps in use [10 us]: 90 s, so that few writes do (our choice)
AGAIN = 3_000_000  # when less than this is left, it is written again [10 us]
TICKS_S = 100_000  # stamps in a second
REMEDY = "genuine streams are stale until then; if the clock is right now, start once with --reset-stamp"
RETRY_S = 10.0  # after a write that failed

FILE_BYTES = 4096  # of a key file, at most

_HEX = re.compile(rb"[0-9A-Fa-f]{64}")


def read_key(path: Path) -> bytes:
    """The key of a file, 32 bytes. Raises UsageError as `read_secret`."""
    line = read_secret(path, "signing key", "64 hexadecimal digits or a passphrase")
    return bytes.fromhex(line.decode()) if _HEX.fullmatch(line) else hashlib.sha256(line).digest()


def read_secret(path: Path, name: str, form: str) -> bytes:
    """The one line of a file that holds a secret. name, form: what it is called, and what it should hold.

    Raises UsageError unless it is a regular file of the user's own (or root's) that nobody else may read.
    """
    try:
        with open_regular(path, FILE_BYTES) as file:
            found = os.fstat(file.fileno())
            content = file.read(FILE_BYTES)
    except InputError as error:
        raise UsageError(f"{name} {error}") from error
    if found.st_uid not in (os.geteuid(), 0):
        raise UsageError(f"{path}: the {name} is another user's; copy it and `chmod 600` the copy")
    if found.st_mode & 0o077:
        raise UsageError(f"{path}: others may read the {name}; run `chmod 600 {path}`")
    line = content.removesuffix(b"\n").removesuffix(b"\r")
    if not line or b"\n" in line:
        raise UsageError(f"{path}: a {name} is one line: {form}")
    return line


class KeptSigning:
    """A `Signing` whose time stamp outlives the process. Call `step` regularly, and `close` at the end.

    What is kept in `path` is ahead of every stamp in use, so that a restart never uses one again. reset: begin with the
    wall clock. doubt: what is wrong with the stamp that was kept, and the remedy; empty if nothing is.
    Raises UsageError if it cannot be read or written.
    """

    def __init__(self, key: bytes, path: Path, unix_ns: int, *, reset: bool = False) -> None:
        self._path, self._retry_ns = path, 0
        kept, now = 0 if reset else _kept(path), stamp_at(unix_ns)
        ahead = f"{path}: the stamp is {(kept - now) // TICKS_S} s ahead of the clock: {REMEDY}"
        self.doubt = ahead if kept - now > AHEAD + STALE else ""
        self.signing = Signing(key, stamp=max(kept, now))
        self._reserve()

    def step(self, unix_ns: int) -> str | None:
        """Follow the wall clock [ns]; returns why the stamp cannot be kept, if it cannot."""
        self.signing.advance(unix_ns)
        if self.signing.stamp + AGAIN < self._reserved or unix_ns < self._retry_ns:
            return None
        try:
            self._reserve()
        except UsageError as error:
            self._retry_ns = unix_ns + round(RETRY_S * 1e9)
            return str(error)
        return None

    def close(self) -> None:
        """Keep the stamp as it is. Raises UsageError if that fails; what was kept before is safe as well."""
        write_atomically(self._path, f"{self.signing.stamp}\n")

    def _reserve(self) -> None:
        reserved = self.signing.stamp + AHEAD
        write_atomically(self._path, f"{reserved}\n")
        self._reserved = reserved


def open_signing(path: Path, user: str, unix_ns: int, *, reset: bool = False) -> KeptSigning:
    """The key of a file with the stamp kept beside it, in `<file>.<user>.stamp`. user: which program.

    unix_ns: the wall clock [ns]. reset: forget the stamp that is kept. Raises UsageError for one that cannot be used.
    """
    return KeptSigning(read_key(path), path.with_name(f"{path.name}.{user}.stamp"), unix_ns, reset=reset)


def _kept(path: Path) -> int:
    if not path.exists():
        return 0
    try:
        text = read_text(path).strip()
    except InputError as error:
        raise UsageError(str(error)) from error
    if not re.fullmatch(r"[0-9]{1,15}", text) or int(text) >= 1 << 48:
        raise UsageError(f"{path}: is no time stamp; remove it, and old frames can be replayed once")
    return int(text)
