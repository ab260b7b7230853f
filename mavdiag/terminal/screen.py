"""A picture that is drawn again and again on a terminal, and one line an event on anything else (edge)."""

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

from rich.console import Console, RenderableType
from rich.live import Live

from mavdiag.terminal.view import Line, line_of

__all__ = ["Screen"]

PER_S = 10


class Screen:
    """Live on a terminal; on anything else one line an event; silent if `quiet`."""

    def __init__(self, *, quiet: bool = False, console: Console | None = None) -> None:
        self._console = console or Console()
        self._quiet = quiet
        live = self._console.is_terminal and not quiet
        self._live = Live(console=self._console, auto_refresh=False) if live else None
        self._size = self._console.size
        self._until = 0.0

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, draw: Callable[[int, int], RenderableType], fresh: Sequence[Line], *, last: bool = False) -> None:
        """Bring it up to date, at most ten times a second.

        draw: gives the picture for a width and a height; it is called only where there is a terminal.
        fresh: what happened since the last call; it is printed where there is no terminal.
        last: draw in any case.
        """
        if self._quiet:
            return
        if self._live is None:
            for one in fresh:
                self._console.print(line_of(one), soft_wrap=True, highlight=False)
            return
        now = self._console.get_time()
        if last or now >= self._until:
            self._until = now + 1 / PER_S
            if self._console.size != self._size:
                self._begin_anew()
            self._live.update(draw(self._size.width, self._size.height - 1), refresh=True)

    def _begin_anew(self) -> None:
        """After a change of the terminal's size: what was drawn for the old one would stay in part."""
        if self._live is not None:
            self._live.stop()
            self._console.clear()
            self._size = self._console.size
            self._live = Live(console=self._console, auto_refresh=False)
            self._live.start()
