"""Which logs a list of arguments names (edge): files, folders with all that is below them, and patterns."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from mavdiag.errors import InputError
from mavdiag.logs import is_log

IsLog = Callable[[Path], bool]


@dataclass(frozen=True, slots=True)
class Named:
    """A log to read. trouble: why it or a folder cannot be read, as a sentence; empty if nothing is known yet."""

    path: Path
    trouble: str = ""


@dataclass(frozen=True, slots=True)
class Found:
    """What arguments name.

    logs: in the order of the arguments, within a folder by name.
    skipped: files of folders and patterns that are no flight logs.
    """

    logs: tuple[Named, ...]
    skipped: int = 0

    @property
    def skipped_sentence(self) -> str:
        """That files were left out; empty if none was."""
        plural = "s" if self.skipped > 1 else ""
        return f"{self.skipped} file{plural} skipped that are no flight logs" if self.skipped else ""

    def paths(self) -> tuple[Path, ...]:
        """The logs themselves, where one that cannot be read is an error. Raises InputError for the first of them."""
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
        if argument.is_dir():
            found = list(_below(argument, set(), is_log))
        elif any(sign in str(argument) for sign in "*?[") and not _exists(argument):
            found = list(_matching(argument, is_log))
        else:
            found = [Named(argument)]
        taken = [log for log in found if log is not None]
        skipped += len(found) - len(taken)
        logs += taken or [Named(argument, "no log there; name files, a folder, or a pattern like 'flights/*.tlog'")]
    return Found(tuple(logs), skipped)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # too long, or with a zero byte; reading it says so
        return False


def _matching(pattern: Path, is_log: IsLog) -> Iterator[Named | None]:
    try:
        matches = sorted(Path(pattern.anchor).glob(str(pattern.relative_to(pattern.anchor))))
    except (OSError, ValueError) as error:
        yield Named(pattern, f"no pattern to look for files by ({error})")
        return
    for path in matches:
        yield from _below(path, set(), is_log)


def _below(path: Path, seen: set[tuple[int, int]], is_log: IsLog) -> Iterator[Named | None]:
    """The logs that a file or folder is or has, by name; None for a file that is none. seen: folders so far.

    A file that cannot be read may be a log.
    """
    if not path.is_dir():
        try:
            yield Named(path) if path.is_file() and path.stat().st_size and is_log(path) else None
        except (InputError, OSError):
            yield Named(path)
        return
    try:
        about = path.stat()
        if (about.st_dev, about.st_ino) in seen:
            return
        seen.add((about.st_dev, about.st_ino))
        inside = sorted(entry for entry in path.iterdir() if not entry.name.startswith("."))
    except OSError as error:
        yield Named(path, f"the folder cannot be read ({error.strerror or error})")
        return
    for entry in inside:
        yield from _below(entry, seen, is_log)
