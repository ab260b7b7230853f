"""Files (edge): baselines are read whole and written atomically."""

import os
import tempfile
from pathlib import Path

from mavdiag.baseline import Baseline, dump, parse
from mavdiag.errors import BaselineError, UsageError

__all__ = ["load_baseline", "save_baseline", "write_atomically"]


def load_baseline(path: Path) -> Baseline:
    """Read and validate a baseline. Raises BaselineError: what is wrong with the file, in one line."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise BaselineError(f"{path}: no such file; make a baseline with `mavdiag identify`") from error
    except (OSError, UnicodeDecodeError) as error:
        raise BaselineError(f"{path}: cannot be read as a baseline ({_reason(error)})") from error
    try:
        return parse(text)
    except BaselineError as error:
        raise BaselineError(f"{path}: {error}") from error


def save_baseline(path: Path, baseline: Baseline) -> None:
    """Write a baseline; the old file stays whole until the new one is. Raises UsageError if it cannot be written."""
    write_atomically(path, dump(baseline))


def write_atomically(path: Path, text: str) -> None:
    """Write a text file by way of a temporary one beside it. Raises UsageError if that fails."""
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written ({_reason(error)}); name a folder you can write to") from error
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except OSError as error:
        Path(temporary).unlink(missing_ok=True)
        raise UsageError(f"{path}: cannot be written ({_reason(error)}); is the disk full?") from error


def _reason(error: OSError | UnicodeDecodeError) -> str:
    return error.strerror or str(error) if isinstance(error, OSError) else "not UTF-8 text"
