"""Files that grow while the daemon runs, up to a size (edge): appended to, rotated, written through to the disk.

Nothing here stops the daemon: what cannot be written is counted and reported once, and the next entry is tried again.
A pipe whose reader is slow loses entries; it is never waited for. A file has one writer: it is locked.
"""

import contextlib
import errno
import fcntl
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from mavdiag.errors import UsageError

MB = 1_000_000
_REASONS = {errno.ENXIO: "nobody reads this pipe", errno.EWOULDBLOCK: "another program writes it"}


def older(path: Path, number: int) -> Path:
    """The name of an old file; the kind stays at the end.

    >>> older(Path("flight.tlog"), 2).name
    'flight.2.tlog'
    """
    return path.with_suffix(f".{number}{path.suffix}")


def check_appendable(path: Path, option: str) -> None:
    """Raise UsageError, naming the option, unless a file at this path can be appended to or made. It is not opened."""
    place = path if path.exists() else path.parent
    if path.is_dir() or not place.exists():
        raise UsageError(_refused(path, option, "is a folder" if path.is_dir() else f"there is no folder {place}"))
    if not os.access(place, os.W_OK):
        raise UsageError(_refused(path, option, "no permission"))


def _refused(path: Path, option: str, reason: str) -> str:
    return f"{path}: cannot be written ({reason}); choose another {option} file"


class Appender:
    """A file that is appended to, each entry written whole at once.

    option: the command-line option that names it. warn: called once when writing begins to fail, and once when it works
    again. limit_mb: size that it does not exceed; None for no limit. keep: how many old ones stay.
    Raises UsageError if the file cannot be opened.
    """

    def __init__(
        self, path: Path, option: str, warn: Callable[[str], None], limit_mb: float | None = None, keep: int = 0
    ) -> None:
        self._path, self._name, self._warn = path, f"{option.removeprefix('--')} {path}", warn
        self._limit_bytes, self._keep = None if limit_mb is None else round(limit_mb * MB), keep
        try:
            self._file = self._open()
        except OSError as error:
            reason = _REASONS.get(error.errno or 0, error.strerror or str(error))
            raise UsageError(_refused(path, option, reason)) from error
        self._torn = False  # the last entry was written only in part
        self._failing = 0  # entries in a row that could not be written
        self.lost = 0  # entries that could not be written, so far

    def append(self, data: bytes, after_torn: bytes = b"", entries: int = 1) -> None:
        """Append an entry, or several, or count them as lost. after_torn: what goes before if the last one was torn."""
        data = (after_torn if self._torn else b"") + data
        limit = self._limit_bytes
        try:
            if limit is not None and self._regular and self._size > 0 and self._size + len(data) > limit:
                self._rotate()
            written = self._file.write(data) or 0  # None from a pipe that is full
        except OSError as error:
            self._failed(error.strerror or str(error), entries)
            return
        self._size += written
        if written < len(data):
            self._torn = self._torn or written > 0
            self._failed("not all of it fitted", entries)
            return
        if self._failing:
            self._warn(f"{self._name}: writing again; {self._failing} entries were lost")
        self._torn, self._failing = False, 0

    def sync(self) -> None:
        """Write through to the disk; what that cannot do counts as a lost entry. A pipe or device is left alone."""
        if self._regular:
            try:
                os.fsync(self._file.fileno())
            except OSError as error:
                self._failed(error.strerror or str(error))

    def close(self) -> None:
        """Write through and close the file."""
        self.sync()
        with contextlib.suppress(OSError):
            self._file.close()

    def _open(self) -> BinaryIO:
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC
        file = os.fdopen(os.open(self._path, flags, 0o666), "ab", buffering=0)
        status = os.fstat(file.fileno())
        regular = stat.S_ISREG(status.st_mode)
        if regular:
            try:
                _lock(file)
            except OSError:
                file.close()
                raise
            _sync_folder(self._path.parent)
        self._regular, self._size = regular, status.st_size
        return file

    def _rotate(self) -> None:
        """Number the old files one higher and begin a new one. Raises OSError; the present file is kept then."""
        if self._path.exists():  # it is gone if the last attempt failed half-way
            for number in range(self._keep - 1, 0, -1):
                if older(self._path, number).exists():
                    older(self._path, number).replace(older(self._path, number + 1))
            if self._keep:
                self._path.replace(older(self._path, 1))
            else:
                self._path.unlink()
        new = self._open()
        self._file.close()
        self._file, self._torn = new, False

    def _failed(self, reason: str, entries: int = 1) -> None:
        if not self._failing:
            self._warn(f"{self._name}: cannot be written ({reason}); watching goes on without it")
        self._failing += entries
        self.lost += entries


def _lock(file: BinaryIO) -> None:
    """Keep other writers away, where the file system can do that. Raises BlockingIOError if there is one."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:  # the file system has no locks
        return


def _sync_folder(folder: Path) -> None:
    """Let a new name survive a power cut, where the file system can do that."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
