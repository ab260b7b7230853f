"""Answers that were found before (edge): one small file for each content, baseline and set of options."""

import os
from dataclasses import dataclass
from pathlib import Path

from mavdiag.archive.job import Record, record_from, record_text
from mavdiag.errors import InputError, UsageError
from mavdiag.storage import read_text, write_atomically

RECORD_BYTES = 64 << 20  # of one answer; a flight of an hour with an alarm a second has 1 MB (our choice)


@dataclass(frozen=True, slots=True)
class Cache:
    """The answers to one question. folder: of their files, named by the log's mark (`archive.job`) and its digest."""

    folder: Path

    def marks(self) -> frozenset[str]:
        """The marks of all contents that have an answer: a log with another one is new."""
        try:
            return frozenset(path.name.partition("-")[0] for path in self.folder.iterdir())
        except OSError:
            return frozenset()

    def get(self, mark: str, digest: str) -> Record | None:
        """The answer for a content; None if there is none, or its file is damaged."""
        try:
            record = record_from(read_text(self._file(mark, digest), RECORD_BYTES))
        except InputError:
            return None
        return record if record.digest == digest else None

    def put(self, mark: str, record: Record) -> None:
        """Keep an answer at once. Raises UsageError if it cannot be written."""
        write_atomically(self._file(mark, record.digest), record_text(record), durable=False)

    def _file(self, mark: str, digest: str) -> Path:
        return self.folder / f"{mark}-{digest}.json"


def cache_folder() -> Path | None:
    """Where answers are kept unless told otherwise (XDG Base Directory Specification); None without a home."""
    told = os.environ.get("XDG_CACHE_HOME", "")
    try:  # a relative path is to be ignored, says the specification
        return (Path(told) if Path(told).is_absolute() else Path.home() / ".cache") / "mavdiag"
    except RuntimeError:
        return None


def open_cache(folder: Path, scope: str) -> Cache:
    """The answers of a scope below a folder, which is made. Raises UsageError if it cannot be used."""
    mine, why = folder / "scan" / scope, "cannot be written (no permission)"
    try:
        mine.mkdir(parents=True, exist_ok=True)
        if os.access(mine, os.W_OK | os.X_OK):
            return Cache(mine)
    except OSError as error:
        why = f"no folder to keep answers in ({error.strerror or error})"
    raise UsageError(f"{folder}: {why}; name another with --cache, or use --no-cache")
