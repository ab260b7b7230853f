"""Progress on a terminal (edge): on stderr, and nothing where stderr is no terminal."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

__all__ = ["each", "working"]

T = TypeVar("T")


def each(items: Sequence[T], text: str) -> Iterator[T]:
    """The items one by one, with a bar that shows how many are left."""
    if not sys.stderr.isatty() or len(items) < 2:
        yield from items
        return
    from rich.console import Console
    from rich.progress import track

    yield from track(items, text, console=Console(stderr=True), transient=True)


@contextmanager
def working(text: str) -> Iterator[None]:
    """A spinner while the block runs."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(text):
        yield
