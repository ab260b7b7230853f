"""The picture of one vehicle in a terminal: headline, strips, monitors as bars, events, link.

`View` says what is shown, `picture` lays it out. Strips are curves in dots of Braille characters. A column of dots
stands for a span of time and shows all values in it: a spike of one sample is not lost.
"""

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from rich.bar import Bar
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from mavdiag.decision.diagnosis import Change, Stage
from mavdiag.link.messages import Severity
from mavdiag.printable import printable
from mavdiag.telemetry import Axis, BoolArray, FloatArray
from mavdiag.terminal.ground_station import FIGURES, GroundStation, Line, LiveJudge
from mavdiag.traces import RateTrace, rate_traces
from mavdiag.units import NS_PER_S

MARGIN = 13  # characters left of a strip, for its scale
FRAME = 4  # characters of the panel's border and padding
NARROWEST = 40
NAME_WIDTH = 16
FIGURES_WIDTH = 30
EVENTS = 8
LEAST_EVENTS = 6  # lines of them that stay where there is little room (our choice)
STRIP_ROWS = 4
POINTS_PER_S = 100.0  # of a strip, at most: more would not be seen
LEAST_RATE = 0.1  # of the scale of rates [rad/s]
OF_MARGIN = 3.0  # least scale of a residual, in margins
ACROSS, DOWN = 2, 4  # dots of one character of the Braille block
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])  # of each dot, by row and column
# Of the headline; a stage outweighs those before it.
STYLES = {Stage.QUIET: "bold green", Stage.NOT_JUDGED: "bold", Stage.SUSPECTED: "bold yellow"}
STYLES |= dict.fromkeys((Stage.FAULT, Stage.INSPECT), "bold red")
SEVERITY: Mapping[str, Severity] = {Stage.FAULT: Severity.CRITICAL, Stage.SUSPECTED: Severity.WARNING}


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One line. t_s, values: (n,), in order of time; NaN breaks it. style: of rich. dotted: every other column.
    name: for the legend, where it has one."""

    t_s: FloatArray
    values: FloatArray
    style: str
    dotted: bool = False
    name: str = ""


@dataclass(frozen=True, slots=True)
class StripView:
    """A strip of rates and its caption. low, high: of the scale [rad/s]; what is beyond stands at its edge."""

    name: str
    curves: tuple[Curve, ...]
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Level:
    """A monitor against its threshold. reason: why it does not judge; empty if it does."""

    name: str
    value: float
    threshold: float
    unit: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class View:
    """All that is shown."""

    title: str = ""  # of the frame
    headline: str = ""  # the finding in one sentence
    stage: Stage = Stage.NOT_JUDGED  # what it finds
    from_s: float = 0.0  # the time that the strips span
    to_s: float = 1.0
    strips: tuple[StripView, ...] = ()
    levels: tuple[Level, ...] = ()
    events: tuple[Line, ...] = ()  # in order of time; the last ones are shown
    foot: str = ""  # about the link


def picture(view: View, width: int, height: int | None = None) -> Panel:
    """The picture; where `height` leaves little room the alerts stay, the newest events, the monitors, the strips."""
    inner = max(width - FRAME, NARROWEST)
    head = _wrapped("", view.headline, STYLES[view.stage], inner)
    named = {curve.name: curve.style for shown in view.strips for curve in shown.curves if curve.name}
    legend = [(f"{name}  ", style) for name, style in named.items()]
    about = Text.assemble(*legend, (printable(view.foot), "dim"), no_wrap=True, overflow="ellipsis")
    foot = [about] if about else []
    room = math.inf if height is None else height - 2 - len(head) - len(foot)
    most = max(room - len(view.levels) - STRIP_ROWS * len(view.strips), min(room, LEAST_EVENTS))
    events = _events(view.events, inner, most, room)
    levels = view.levels[: int(min(max(room - len(events), 0), len(view.levels)))]
    left, parts = room - len(events) - len(levels), list[RenderableType](head)
    for shown in view.strips:
        left -= STRIP_ROWS
        parts += _strip(shown, view, inner) if left >= 0 else ()
    parts += [_levels(levels, inner)] if levels else []
    return Panel(Group(*parts, *events, *foot), title=Text(printable(view.title)), width=inner + FRAME)


def _events(told: Sequence[Line], width: int, most: float, room: float) -> list[Text]:
    """The newest alerts, as far as there is room, and with them the newest other events up to `most` lines."""
    chosen, used = dict[int, list[Text]](), 0
    for index in sorted(range(len(told)), key=lambda n: (not told[n].alert, -n))[:EVENTS]:
        line = told[index]
        lines = _wrapped(line.head, line.text, line.style, width)
        if used and used + len(lines) > (room if line.alert else most):
            break
        chosen[index], used = lines, used + len(lines)
    return [text for index in sorted(chosen) for text in chosen[index]]


def line_for(news: Line | Change, text_from: str = "", change_from: str = "") -> Line:
    """A text of a detector, or a change of a decision, as a line. text_from, change_from: say whose they are."""
    if isinstance(news, Line):
        return replace(news, text=f"{text_from}{news.text}")
    words = str(news).partition(" s ")[2]
    return Line(news.t_ns / NS_PER_S, SEVERITY.get(news.stage, Severity.INFO), f"{change_from}{words}")


def levels_of(judge: LiveJudge) -> tuple[Level, ...]:
    """Every monitor against its threshold; of one on two axes both."""
    found = []
    for slot, value, reason in judge.values:
        name = f"{slot.monitor.label} {slot.monitor.axis or ''}".rstrip()
        found.append(Level(name, value, slot.threshold, slot.monitor.unit, reason))
    return tuple(found)


def figure_levels(station: GroundStation) -> tuple[Level, ...]:
    """The thesis rule by the figures that a detector sends: residual against margin, FSD against FML."""
    figures = station.figures
    if len(figures) < len(FIGURES) or not all(map(math.isfinite, figures.values())):
        return ()
    residual, margin, fsd_s, fml_s = (figures[name] for name in FIGURES)
    return Level("|residual|", abs(residual), margin, "rad/s"), Level("FSD", fsd_s, fml_s, "s")


def rate_strips(judge: LiveJudge, axis: Axis) -> tuple[StripView, ...]:
    """Of an axis with a model: measured and simulated rate (T Fig 5.6), and the residual with its margin (5.7)."""
    traces = rate_traces(judge.chain, judge.pieces)
    return tuple(s for one in traces if one.axis is axis and len(one.t_ns) for s in _strips_of(one))


def _strips_of(trace: RateTrace) -> tuple[StripView, StripView]:
    """No more rows than a strip can show: every n-th is kept, for what is filtered over 0.1 s has nothing between."""
    period_s = float(np.median(np.diff(trace.t_ns))) / NS_PER_S if len(trace.t_ns) > 1 else 1.0
    thin = slice(None, None, max(1, int(1 / (POINTS_PER_S * period_s))) if period_s > 0 else 1)
    t_s, margin = trace.t_ns[thin] / NS_PER_S, trace.margin_rad_s
    measured, simulated = trace.measured[thin], trace.simulated[thin]
    residual = np.where(trace.judged, trace.residual, np.nan)[thin]
    limits = (Curve(t_s, np.full(len(t_s), level), "red", dotted=True, name="margin") for level in (-margin, margin))
    reach = max(LEAST_RATE, _highest(measured), _highest(simulated))
    far = max(OF_MARGIN * margin, _highest(residual))
    rates = (Curve(t_s, simulated, "cyan", name="simulated"), Curve(t_s, measured, "bright_white", name="measured"))
    beside = (*limits, Curve(t_s, residual, "yellow", name="residual"))
    rate = StripView(f"{trace.axis} rate", rates, -reach, reach)
    return rate, StripView("residual", beside, -far, far)


def _highest(values: FloatArray) -> float:
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def _wrapped(head: str, text: str, style: str, width: int) -> list[Text]:
    """A text of any length as lines of the width, the later ones indented as far as the head goes."""
    parts = textwrap.wrap(printable(text), max(width - len(head), 1)) or [""]
    heads = [head, *[" " * len(head)] * (len(parts) - 1)]
    return [_cut(before + part, width, style) for before, part in zip(heads, parts, strict=True)]


def _strip(shown: StripView, view: View, width: int) -> list[Text]:
    lines = strip(shown, view.from_s, view.to_s, width - MARGIN, STRIP_ROWS)
    scale = (f"{shown.high:+.2g}", shown.name, "rad/s", f"{shown.low:+.2g}")
    heads = (Text(f"{words:>{MARGIN - 1}.{MARGIN - 1}} ", no_wrap=True, style="dim") for words in scale)
    return [head.append_text(line) for head, line in zip(heads, lines, strict=True)]


def strip(shown: StripView, from_s: float, to_s: float, width: int, rows: int) -> list[Text]:
    """The lines of a strip, highest values first. Of several curves in a character the last has its colour.

    >>> flat = Curve(np.array([0.0, 1.0]), np.array([0.0, 0.0]), "")
    >>> [line.plain for line in strip(StripView("", (flat,), -1.0, 1.0), 0.0, 2.0, 2, 1)]
    ['⠤⠄']
    """
    bits = np.zeros((rows, width), dtype=np.int64)
    styles = np.full(bits.shape, -1)
    for number, curve in enumerate(shown.curves):
        at = np.floor((curve.t_s - from_s) / (to_s - from_s) * width * ACROSS)
        share = (shown.high - curve.values) / (shown.high - shown.low)
        dots = _dots(at, share, width * ACROSS, rows * DOWN, step=2 if curve.dotted else 1)
        own = (dots.reshape(rows, DOWN, width, ACROSS) * _BITS[:, None]).sum(axis=(1, 3))
        bits |= own
        styles[own > 0] = number
    return [
        Text.assemble(*((chr(0x2800 + b), shown.curves[s].style) if b else " " for b, s in zip(*row, strict=True)))
        for row in zip(bits.tolist(), styles.tolist(), strict=True)
    ]


def _dots(at: FloatArray, share: FloatArray, columns: int, rows: int, step: int) -> BoolArray:
    points = np.stack((at, np.clip(share, 0.0, 1.0) * (rows - 1)))
    legs = np.diff(points, axis=1)
    counts = np.ceil(np.abs(legs).max(axis=0, initial=0.0))
    counts = np.where(np.isfinite(counts), np.maximum(counts, 1), 0).astype(np.int64)
    along = (np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)) / np.repeat(counts, counts)
    line = np.hstack((points, np.repeat(points[:, :-1], counts, axis=1) + along * np.repeat(legs, counts, axis=1)))
    line = line[:, (line[0] >= 0) & (line[0] < columns) & np.isfinite(line[1])]
    dots = np.zeros((rows, columns), dtype=np.bool_)
    dots[np.round(line[1]).astype(np.int64), line[0].astype(np.int64)] = True
    dots[:, np.arange(columns) % step != 0] = False
    return dots


def _levels(levels: Sequence[Level], width: int) -> Table:
    """One row for each monitor; the middle of a bar is the threshold."""
    table = Table.grid(padding=(0, 1))
    room = max(width - NAME_WIDTH - FIGURES_WIDTH - 2, 6)
    for level in levels:
        row = Table.grid(padding=(0, 1))
        if level.reason:
            row.add_row(_cut(f"not judged: {printable(level.reason)}", room + FIGURES_WIDTH + 1, "dim"))
        else:
            colour = "red" if level.value > level.threshold else "green"
            length = level.value if level.value > 0.0 else 0.0  # none for NaN, which a link may bring
            bar = Bar(2 * level.threshold or 1.0, 0, length, width=room, color=colour)
            row.add_row(bar, _cut(f"{level.value:8.3g} of {level.threshold:.3g} {level.unit}", FIGURES_WIDTH))
        table.add_row(Text(f"{level.name:<{NAME_WIDTH}.{NAME_WIDTH}}", no_wrap=True), row)
    return table


def _cut(words: str, width: int, style: str = "") -> Text:
    text = Text(words, style=style, no_wrap=True)
    text.truncate(width, overflow="ellipsis")  # characters may be two cells wide
    return text
