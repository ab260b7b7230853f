"""The picture of one vehicle in a terminal: headline, strips, monitors as bars, events, link.

`View` says what is shown, `picture` lays it out within the width of the terminal. Nothing is read or judged here.
"""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from rich.bar import Bar
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from mavdiag.link.messages import Severity
from mavdiag.printable import printable
from mavdiag.terminal.strips import Curve, Frame, strip

__all__ = ["Level", "Line", "StripView", "View", "line_of", "picture"]

MARGIN = 13  # characters left of a strip, for its scale
FRAME = 4  # characters of the panel's border and padding
NARROWEST = 40
NAME_WIDTH = 16
FIGURES_WIDTH = 30
EVENTS = 8
LEAST_EVENTS = 6  # lines of them that stay where there is little room (our choice)


@dataclass(frozen=True, slots=True)
class StripView:
    """A strip and its caption. curves: as in `strips`; low, high: of the scale, in `unit`; rows: of characters."""

    name: str
    unit: str
    curves: tuple[Curve, ...]
    low: float
    high: float
    rows: int = 4


@dataclass(frozen=True, slots=True)
class Level:
    """A monitor against its threshold. reason: why it does not judge; empty if it does."""

    name: str
    value: float
    threshold: float
    unit: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Line:
    """Something that happened. t_s: vehicle's clock [s]."""

    t_s: float
    severity: Severity
    text: str


@dataclass(frozen=True, slots=True)
class View:
    """All that is shown.

    title: of the frame. headline, alert: the finding in one sentence, and whether it is a fault.
    from_s, to_s: the time that the strips span [s].
    events: in order of time; the last ones are shown.
    foot: about the link.
    """

    title: str
    headline: str
    alert: bool
    from_s: float
    to_s: float
    strips: tuple[StripView, ...] = ()
    levels: tuple[Level, ...] = ()
    events: tuple[Line, ...] = ()
    foot: str = ""


def picture(view: View, width: int, height: int | None = None) -> Panel:
    """The picture, `width` characters wide and at most `height` lines high; None for any height.

    Where there is little room the newest events stay, then the monitors, then the strips.
    """
    inner = max(width - FRAME, NARROWEST)
    style = "bold red" if view.alert else "bold green"
    parts: list[RenderableType] = [*_lines("", view.headline, style, inner)]
    foot = [Text(printable(view.foot), style="dim", no_wrap=True, overflow="ellipsis")] if view.foot else []
    strips, levels, events = _fitted(view, inner, None if height is None else height - 2 - len(parts) - len(foot))
    for one in strips:
        parts += _strip(one, view, inner)
    if levels:
        parts.append(_levels(levels, inner))
    return Panel(Group(*parts, *events, *foot), title=Text(printable(view.title)), width=inner + FRAME)


def line_of(one: Line) -> Text:
    """An event as one line, however long."""
    return Text(_when(one) + printable(one.text), style=_style(one), no_wrap=True)


def _fitted(view: View, width: int, room: int | None) -> tuple[Sequence[StripView], Sequence[Level], list[Text]]:
    """The strips, levels and lines of events that so many lines have room for; None for all."""
    told = [_lines(_when(one), one.text, _style(one), width) for one in view.events[-EVENTS:]]
    if room is None:
        return view.strips, view.levels, [line for lines in told for line in lines]
    events: list[Text] = []
    most = max(room - len(view.levels) - sum(one.rows for one in view.strips), min(room, LEAST_EVENTS))
    for lines in reversed(told):
        if events and len(events) + len(lines) > most:
            break
        events = [*lines, *events]
    levels = view.levels[: max(room - len(events), 0)]
    left, strips = room - len(events) - len(levels), list[StripView]()
    for one in view.strips:
        left -= one.rows
        if left >= 0:
            strips.append(one)
    return strips, levels, events


def _when(one: Line) -> str:
    return f"{one.t_s:8.2f} s  {one.severity.name:<8} "


def _style(one: Line) -> str:
    return "bold red" if one.severity <= Severity.CRITICAL else "yellow" if one.severity <= Severity.WARNING else ""


def _lines(head: str, text: str, style: str, width: int) -> list[Text]:
    """A text of any length as lines of the width, the later ones indented as far as the head goes."""
    parts = textwrap.wrap(printable(text), max(width - len(head), 1)) or [""]
    lines = [
        Text((head if not number else " " * len(head)) + part, style=style, no_wrap=True)
        for number, part in enumerate(parts)
    ]
    for line in lines:
        line.truncate(width, overflow="ellipsis")  # of characters that are two cells wide
    return lines


def _strip(one: StripView, view: View, width: int) -> list[Text]:
    frame = Frame(view.from_s, view.to_s, one.low, one.high, width - MARGIN, one.rows)
    lines = strip(one.curves, frame)
    scale = [""] * one.rows
    scale[0], scale[-1] = f"{one.high:+.2g}", f"{one.low:+.2g}"
    names = [part for part in (one.name, one.unit) if part]
    for row, words in zip(range(1, one.rows - 1), names, strict=False):
        scale[row] = words
    return [
        Text(f"{words:>{MARGIN - 1}.{MARGIN - 1}} ", no_wrap=True, style="dim").append_text(line)
        for words, line in zip(scale, lines, strict=True)
    ]


def _levels(levels: Sequence[Level], width: int) -> Table:
    """One row for each monitor; the middle of a bar is the threshold."""
    table = Table.grid(padding=(0, 1))
    room = max(width - NAME_WIDTH - FIGURES_WIDTH - 2, 6)
    for one in levels:
        name = Text(f"{one.name:<{NAME_WIDTH}.{NAME_WIDTH}}", no_wrap=True)
        if one.reason:
            words = Text(f"not judged: {printable(one.reason)}", style="dim", no_wrap=True)
            words.truncate(room + FIGURES_WIDTH + 1, overflow="ellipsis")
            grid = Table.grid()
            grid.add_row(words)
            table.add_row(name, grid)
            continue
        above = one.value > one.threshold
        bar = Bar(2 * one.threshold or 1.0, 0, max(one.value, 0.0), width=room, color="red" if above else "green")
        figures = Text(f"{one.value:8.3g} of {one.threshold:.3g} {one.unit}", no_wrap=True)
        figures.truncate(FIGURES_WIDTH, overflow="ellipsis")
        row = Table.grid(padding=(0, 1))
        row.add_row(bar, figures)
        table.add_row(name, row)
    return table
