"""Progress (edge), on stderr only: a bar or a spinner on a terminal, elsewhere a plain line now and then."""

import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Timer
from typing import TypeVar

from mavdiag.commandline import say

__all__ = ["Shown", "each", "followed", "shown", "sizes_of", "told", "working"]

T = TypeVar("T")
FIRST_LINE_S, LINE_S = 10.0, 30.0  # a log file of a nightly run is not filled with lines (our choice)
SLOW_S = 2.0  # without a word is long for who waits (our choice)
BAR = 24  # characters
REDRAW_S = 0.1


def told(done: int, total: int, share: float, elapsed_s: float) -> str:
    """How far it is, how fast, and how long it takes still.

    done, total: items. share: of all work, 0..1. elapsed_s: so far [s].

    >>> told(30, 120, 0.25, 60.0)
    '30 of 120, 0.5 a second, 3 min 0 s left'
    """
    words = f"{done} of {total}"
    if done == 0 or elapsed_s <= 0 or share <= 0:
        return words
    left_s = round(elapsed_s * (1.0 - share) / share)
    hours, minutes = divmod(left_s // 60, 60)
    left = f"{hours} h {minutes} min" if hours else f"{minutes} min {left_s % 60} s" if minutes else f"{left_s} s"
    return f"{words}, {done / elapsed_s:.2g} a second, {left} left"


class Shown:
    """Progress through some items.

    text: what is done with them. sizes: how much work each is, in any unit. quiet: no lines where no terminal is.
    """

    def __init__(self, text: str, sizes: Sequence[float], quiet: bool) -> None:
        self._text, self._total, self._work = text, len(sizes), sum(sizes) or 1.0
        self._done, self._finished = 0, 0.0
        self._started = self._drawn = self._shown = time.monotonic()
        self._terminal = sys.stderr.isatty()
        self._next_s = float("inf") if quiet or self._terminal else FIRST_LINE_S
        self._terminal &= len(sizes) > 1  # nothing to count
        self._mixed = self._terminal and sys.stdout.isatty()
        if self._terminal:
            self._draw(self._started)

    def add(self, size: float) -> None:
        """One more item is done; size: its own, of `sizes`."""
        self._done += 1
        self._finished += size
        now = time.monotonic()
        if self._terminal and (now - self._drawn >= REDRAW_S or self._done == 1):
            self._drawn = now
            self._draw(now)
        elif now - self._started >= self._next_s and self._done < self._total:
            self._next_s = now - self._started + LINE_S
            say(f"{self._text}: {self._words(now)}", err=True)

    @contextmanager
    def cleared(self) -> Iterator[None]:
        """Take the bar away while lines are printed on the same terminal."""
        if self._mixed:
            self._erase()
        yield
        now = time.monotonic()
        if self._mixed and now - self._shown >= REDRAW_S:
            self._shown = now
            self._draw(now)

    def end(self) -> None:
        """Take the bar away for good."""
        if self._terminal:
            self._erase()

    def _words(self, now: float) -> str:
        return told(self._done, self._total, self._finished / self._work, now - self._started)

    def _draw(self, now: float) -> None:
        """One line, never longer than the terminal: whatever is printed afterwards begins where it stood."""
        from rich.console import Console
        from rich.text import Text

        console = Console(stderr=True)
        mark = "━" if console.encoding.startswith("utf") else "#"
        full = min(BAR, int(BAR * self._finished / self._work))
        bar = Text.assemble((mark * full, "bar.complete"), (mark * (BAR - full), "bar.back"))
        line = Text.assemble(f"{self._text} ", bar, f" {self._words(now)}")
        line.truncate(max(1, console.width - 1))
        self._erase()
        console.print(line, end="", soft_wrap=True)

    def _erase(self) -> None:
        sys.stderr.write("\r\x1b[2K")
        sys.stderr.flush()


@contextmanager
def shown(text: str, sizes: Sequence[float], *, quiet: bool = False) -> Iterator[Shown]:
    """Progress that goes away with the block."""
    progress = Shown(text, sizes, quiet)
    try:
        yield progress
    finally:
        progress.end()


def sizes_of(paths: Sequence[Path]) -> tuple[float, ...]:
    """The sizes of files, as how much work they are [bytes]; 1 for what cannot be looked at."""
    return tuple(_size(path) for path in paths)


def _size(path: Path) -> float:
    try:
        return float(path.stat().st_size) or 1.0
    except (OSError, ValueError):
        return 1.0


def each(items: Sequence[T], text: str, sizes: Sequence[float] | None = None) -> Iterator[T]:
    """The items one by one, with progress if there are several. sizes: how much work each is; None if alike."""
    if len(items) < 2:
        yield from items
        return
    work = tuple(1.0 for _ in items) if sizes is None else sizes
    with shown(text, work) as progress:
        for item, size in zip(items, work, strict=True):
            yield item
            progress.add(size)


@contextmanager
def working(text: str) -> Iterator[None]:
    """A spinner while the block runs; where no terminal is, a line if it takes more than SLOW_S."""
    if not sys.stderr.isatty():
        line = Timer(SLOW_S, say, (text,), {"err": True})
        line.daemon = True
        line.start()
        try:
            yield
        finally:
            line.cancel()
            line.join()
        return
    from rich.console import Console

    with Console(stderr=True).status(text):
        yield


@contextmanager
def followed(items: Iterable[T], text: str) -> Iterator[Iterator[T]]:
    """The items, to be taken one by one; a spinner from the last one on, until the block ends."""
    with ExitStack() as shown:

        def taken() -> Iterator[T]:
            yield from items
            shown.enter_context(working(text))

        yield taken()
