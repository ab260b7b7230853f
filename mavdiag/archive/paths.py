"""Which logs a list of arguments names (edge): files, folders with all that is below them, and patterns.

And whether a file may be written beside them.
"""

import glob
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mavdiag import storage
from mavdiag.errors import InputError, UsageError
from mavdiag.logs import is_log

IsLog = Callable[[Path], bool]
AS_BASELINE, AS_TLOG = rb'\{\s*"schema": "mavdiag.baseline/', rb".{8}[\xfd\xfe]"  # how such files begin
NOTHING = "no log there; name files, a folder, or a pattern like 'flights/*.tlog'"


@dataclass(frozen=True, slots=True)
class Named:
    """A log to read. trouble: why it or a folder cannot be read, as a sentence; empty if nothing is known yet."""

    path: Path
    trouble: str = ""


@dataclass(frozen=True, slots=True)
class Found:
    """The logs that arguments name, in their order, within a folder by name. skipped: files that are no flight logs."""

    logs: tuple[Named, ...]
    skipped: int = 0

    def paths(self) -> tuple[Path, ...]:
        """The logs themselves. Raises InputError for the first that cannot be read."""
        for log in self.logs:
            if log.trouble:
                raise InputError(f"{log.path}: {log.trouble}")
        return tuple(log.path for log in self.logs)


def logs_named(arguments: Iterable[str | Path], is_log: IsLog = is_log) -> Found:
    """The logs that arguments name. Nothing is raised: what is wrong with an argument is in its `Named.trouble`.

    A file is taken as it is. Of a folder, and of what a pattern like "flights/**/*.tlog" matches, all flight logs are
    taken by their content; hidden files and folders are not looked at, and a folder that is reached twice within one
    argument (by symbolic links) is looked at once. is_log: whether a file that was not named itself is one.
    """
    logs: list[Named] = []
    skipped = 0
    for argument in map(Path, arguments):
        found: list[Named | None] = [Named(argument)]
        try:
            if argument.is_dir():
                found = list(_below(argument, set(), is_log))
            elif any(sign in str(argument) for sign in "*?[") and not argument.exists():
                matches = set(map(Path, glob.glob(str(argument), recursive=True)))  # noqa: PTH207  # without hidden ones
                shown = sorted(path for path in matches if matches.isdisjoint(path.parents))  # of a folder all is taken
                found = [log for path in shown for log in _below(path, set(), is_log)]
        except OSError as error:  # a name that is too long, another user's folder
            found = [Named(argument, f"cannot be looked for ({error.strerror or error})")]
        taken = [log for log in found if log is not None]
        skipped += len(found) - len(taken)
        logs += taken or [Named(argument, NOTHING)]
    return Found(tuple(logs), skipped)


def _below(path: Path, seen: set[tuple[int, int]], is_log: IsLog) -> Iterator[Named | None]:
    """The logs that a file or folder is or has, by name; None for a file that is none. An unreadable one may be."""
    try:
        if not path.is_dir():
            yield Named(path) if path.is_file() and path.stat().st_size and is_log(path) else None
            return
        about = path.stat()
        if (about.st_dev, about.st_ino) in seen:
            return
        seen.add((about.st_dev, about.st_ino))
        inside = sorted(entry for entry in path.iterdir() if not entry.name.startswith("."))
    except InputError:
        yield Named(path)
        return
    except OSError as error:
        yield Named(path, f"cannot be read ({error.strerror or error})")
        return
    for entry in inside:
        yield from _below(entry, seen, is_log)


def check_output(path: Path, *others: Path | None, kind: bytes | None = None) -> None:
    """Raise UsageError unless a file can be written here and nothing is lost by it.

    others: what else the command reads or writes; None for what was not given. kind: how a file of the kind that is
    written begins, a regular expression: a flight log, a baseline or a history is replaced by its own kind alone.
    """
    storage.check_writable(path)
    storage.check_apart(path, *others)
    own = storage.begins(path, b"(?!)" if kind is None else kind)  # or it is empty or absent
    if not own and (storage.begins(path, AS_BASELINE + rb"|SQLite format 3\0") or is_log(path)):
        raise UsageError(f"{path}: holds a flight log, a baseline or a history, which would be lost; name another file")


def apart(paths: Sequence[str]) -> list[str]:
    """The paths without the folder that all of them share.

    >>> apart(["a/b/1.bin", "a/c/1.bin"]), apart(["a/b/1.bin"])
    (['b/1.bin', 'c/1.bin'], ['1.bin'])
    """
    folders = [path.split("/")[:-1] for path in paths]
    alike = (len(set(parts)) == 1 for parts in zip(*folders, strict=False))
    shared = sum(1 for _ in itertools.takewhile(bool, alike))
    return ["/".join(path.split("/")[shared:]) for path in paths]
