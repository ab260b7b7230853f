"""Which logs a list of arguments names (edge): files, folders with all that is below them, and patterns."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from mavdiag.errors import InputError
from mavdiag.logs import is_log

__all__ = ["Found", "Named", "logs_named"]

PATTERN_SIGNS = "*?["


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
        if not self.skipped:
            return ""
        return f"{self.skipped} file{'s' if self.skipped > 1 else ''} skipped that are no flight logs"

    def paths(self) -> tuple[Path, ...]:
        """The logs themselves, where one that cannot be read is an error. Raises InputError for the first of them."""
        for one in self.logs:
            if one.trouble:
                raise InputError(f"{one.path}: {one.trouble}")
        return tuple(one.path for one in self.logs)


def logs_named(arguments: Iterable[str | Path], is_log: Callable[[Path], bool] = is_log) -> Found:
    """The logs that arguments name. Nothing is raised: what is wrong with an argument is in its `Named.trouble`.

    A file is taken as it is. Of a folder, and of what a pattern like "flights/**/*.tlog" matches, all flight logs are
    taken by their content; hidden files and folders are not looked at, and a folder that is reached twice within one
    argument (by symbolic links) is looked at once. is_log: whether a file that was not named itself is one.
    """
    logs: list[Named] = []
    skipped = 0
    for argument in arguments:
        path = Path(argument)
        if path.is_dir():
            found = list(_below(path, set(), is_log))
        elif not _exists(path) and any(sign in str(path) for sign in PATTERN_SIGNS):
            found = list(_matching(path, is_log))
        else:
            found = [Named(path)]
        taken = [one for one in found if one is not None]
        skipped += len(found) - len(taken)
        logs += taken or [Named(path, "no log there; name files, a folder, or a pattern like 'flights/*.tlog'")]
    return Found(tuple(logs), skipped)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # too long, or with a zero byte; reading it says so
        return False


def _matching(pattern: Path, is_log: Callable[[Path], bool]) -> Iterator[Named | None]:
    """What a pattern matches, by name; None for a file that is no log."""
    try:
        matches = sorted(Path(pattern.anchor).glob(str(pattern.relative_to(pattern.anchor))))
    except (OSError, ValueError) as error:
        yield Named(pattern, f"no pattern to look for files by ({error})")
        return
    for path in matches:
        if path.is_dir():
            yield from _below(path, set(), is_log)
        else:
            yield _file(path, is_log)


def _below(folder: Path, seen: set[tuple[int, int]], is_log: Callable[[Path], bool]) -> Iterator[Named | None]:
    """The logs below a folder, by name; None for a file that is no log. seen: device and number of folders so far."""
    try:
        about = folder.stat()
        if (about.st_dev, about.st_ino) in seen:
            return
        seen.add((about.st_dev, about.st_ino))
        inside = sorted(one for one in folder.iterdir() if not one.name.startswith("."))
    except OSError as error:
        yield Named(folder, f"the folder cannot be read ({error.strerror or error})")
        return
    for path in inside:
        if path.is_dir():
            yield from _below(path, seen, is_log)
        else:
            yield _file(path, is_log)


def _file(path: Path, is_log: Callable[[Path], bool]) -> Named | None:
    """A file that was not named itself: None if it is no log. One that cannot be read may be one."""
    try:
        if not path.is_file() or path.stat().st_size == 0:
            return None
        return Named(path) if is_log(path) else None
    except (InputError, OSError):
        return Named(path)
