"""Files (edge): text is read whole and written atomically, and only to regular files."""

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from mavdiag.errors import BaselineError, InputError, UsageError

if TYPE_CHECKING:
    from mavdiag.baseline import Baseline

__all__ = ["check_output", "load_baseline", "read_text", "save_baseline", "write_atomically"]


def read_text(path: Path) -> str:
    """The text of a file. Raises InputError, naming it, if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder; name a file") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read (not UTF-8 text)") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


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


def write_atomically(path: Path, text: str) -> None:
    """Write a text file by way of a temporary one beside it. Raises UsageError if that fails."""
    check_output(path)
    temporary: Path | None = None
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        temporary = Path(name)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        raise UsageError(f"{path}: cannot be written ({error.strerror or error}); name another file") from error


def load_baseline(path: Path) -> "Baseline":
    """Read and validate a baseline. Raises BaselineError: what is wrong with the file, in one line."""
    from mavdiag.baseline import parse

    try:
        return parse(read_text(path))
    except BaselineError as error:
        raise BaselineError(f"{path}: {error}") from error
    except InputError as error:
        raise BaselineError(f"{error}; make a baseline with `mavdiag identify`") from error


def save_baseline(path: Path, baseline: "Baseline") -> None:
    """Write a baseline; the old file stays whole until the new one is. Raises UsageError if it cannot be written."""
    from mavdiag.baseline import dump

    write_atomically(path, dump(baseline))
