"""Progress (edge), on stderr only: a bar or a spinner on a terminal, elsewhere a plain line now and then."""

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from threading import Timer
from typing import TYPE_CHECKING

from mavdiag.archive.paths import Named
from mavdiag.commandline import say

if TYPE_CHECKING:
    from rich.progress import Progress

FIRST_LINE_S, LINE_S = 10.0, 30.0  # a log file of a nightly run is not filled with lines (our choice)
SLOW_S = 2.0  # without a word is long for who waits (our choice)
BAR = 24  # characters


class Shown:
    """Progress through items; of a single one, that it goes on. text: what is done. sizes: how much work each is."""

    def __init__(self, text: str, sizes: Sequence[float], bar: "Progress | None", first_s: float) -> None:
        self._text, self._total, self._work = text, len(sizes), sum(sizes) or 1.0
        self._done, self._finished, self._started = 0, 0.0, time.monotonic()
        self._bar, self._next_s = bar, first_s
        if bar is not None:
            bar.add_task(text, total=self._work if self._total > 1 else None, words="")

    def add(self, size: float) -> None:
        """One more item is done; size: its own, of `sizes`."""
        self._done += 1
        self._finished += size
        elapsed_s = time.monotonic() - self._started
        words = f"{self._done} of {self._total}"
        if elapsed_s > 0 and self._finished > 0:
            left = timedelta(seconds=round(elapsed_s * max(self._work / self._finished - 1.0, 0.0)))
            words += f", {left} left"
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=self._finished, words=words)
        elif elapsed_s >= self._next_s and self._done < self._total:
            self._next_s = elapsed_s + LINE_S
            say(f"{self._text}: {words}", err=True)

    def say(self, *lines: str, err: bool = False) -> None:
        """Print lines, without the bar if they are for the same terminal."""
        if self._bar is None or not (err or sys.stdout.isatty()):
            return say(*lines, err=err)
        self._bar.stop()
        say(*lines, err=err)
        return self._bar.start()


@contextmanager
def shown(text: str, sizes: Sequence[float], *, quiet: bool = False) -> Iterator[Shown]:
    """Progress that goes away with the block. quiet: no lines where no terminal is."""
    if not sys.stderr.isatty() or not sizes:
        yield Shown(text, sizes, None, float("inf") if quiet else FIRST_LINE_S)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn
    from rich.table import Column

    words = TextColumn("{task.fields[words]}", table_column=Column(no_wrap=True))
    columns = (TextColumn("{task.description}"), BarColumn(BAR), words)
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False) as bar:
        yield Shown(text, sizes, bar, float("inf"))


def sizes_of(logs: Sequence[Named]) -> tuple[float, ...]:
    """The sizes of logs, as how much work they are [bytes]; 0 for what is no file: it tells no speed."""
    return tuple(0.0 if log.trouble or not log.path.is_file() else float(log.path.stat().st_size) for log in logs)


def each(logs: Sequence[Named], text: str) -> Iterator[Named]:
    """The logs one by one, with progress if there are several."""
    sizes = sizes_of(logs)
    with shown(text, sizes, quiet=len(logs) < 2) as progress:
        for log, size in zip(logs, sizes, strict=True):
            yield log
            progress.add(size)


@contextmanager
def working(text: str) -> Iterator[None]:
    """A spinner while the block runs; where no terminal is, a line if it takes more than SLOW_S."""
    if sys.stderr.isatty():
        from rich.console import Console

        with Console(stderr=True).status(text):
            yield
        return
    line = Timer(SLOW_S, say, (text,), {"err": True})
    line.daemon = True
    line.start()
    try:
        yield
    finally:
        line.cancel()
        line.join()
