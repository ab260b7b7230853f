"""Files (edge): only regular files of a bounded size are read, and files are written atomically."""

import os
import stat
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from mavdiag.errors import InputError, UsageError

__all__ = ["TOML_BYTES", "check_output", "open_regular", "parse_toml", "read_text", "read_toml", "write_atomically"]

TOML_BYTES = 32 << 10  # the longest of ours has 7 kB; tomllib takes seconds for a larger one's worst (our choice)
TEXT_BYTES = 8 << 20  # baselines have some hundred kilobytes (our choice)


@contextmanager
def open_regular(path: Path, most_bytes: int) -> Iterator[BinaryIO]:
    """A file to read, which is a regular one and has at most so many bytes: no device without end, no pipe to wait for.

    Raises InputError, naming it, if it is no such file or cannot be opened.
    """
    try:
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder; name a file") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    with file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise InputError(f"{path}: is not a regular file; name a file")
        if found.st_size > most_bytes:
            size = f"{found.st_size // 1024:,} KiB, and {most_bytes // 1024:,} KiB is the most that is read"
            raise InputError(f"{path}: is too large ({size})")
        yield file


def read_text(path: Path, most_bytes: int = TEXT_BYTES) -> str:
    """The text of a file. Raises InputError, naming it, if it cannot be read."""
    try:
        with open_regular(path, most_bytes) as file:
            return file.read(os.fstat(file.fileno()).st_size).decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read (not UTF-8 text)") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file. Raises InputError, naming it, if it cannot be used."""
    return parse_toml(read_text(path, TOML_BYTES), str(path))


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """The content of a TOML text. name: of the file. Raises InputError, naming it, if it cannot be used."""
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise InputError(f"{name}: not TOML: nested too deep") from error
    except ValueError as error:  # a number of thousands of digits is one too
        raise InputError(f"{name}: not TOML: {error}") from error


def check_output(path: Path) -> None:
    """Raise UsageError unless a file can be written at this path: new, or a regular file that may be replaced.

    Writing replaces a file by a new one, which would turn a device or a link into a plain file.
    """
    if path.is_symlink() or (path.exists() and not path.is_file()):
        kind = "a symbolic link" if path.is_symlink() else "a folder" if path.is_dir() else "not a regular file"
        raise UsageError(f"{path}: is {kind}; name a file to write")
    if not path.parent.is_dir():
        raise UsageError(f"{path}: cannot be written, there is no folder {path.parent}; make it, or name another file")
    if not os.access(path.parent, os.W_OK):
        raise UsageError(f"{path}: cannot be written (no permission); name a folder you can write to")


def write_atomically(path: Path, content: str | bytes, *, durable: bool = True) -> None:
    """Write a file by way of a temporary one beside it; a text as UTF-8. Raises UsageError if that fails.

    durable: wait until the disk has it; without, a loss of power may leave an empty file.
    """
    check_output(path)
    temporary: Path | None = None
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        temporary = Path(name)
        with os.fdopen(handle, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            if durable:
                os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        raise UsageError(f"{path}: cannot be written ({error.strerror or error}); name another file") from error
