"""Charts as SVG that need no script, and lines that are thinned while a flight is judged.

A chart is as wide as its place and has no viewBox, so texts keep their size at every width; what is drawn stands in
inner elements that are stretched to it, `UNITS` across and `HIGH` high. Colours and strokes are classes of chart.css.
page.js reads the points of such a path back, so that a figure holds its data once.
"""

import math
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, wraps
from pathlib import Path
from textwrap import wrap
from typing import Any, ParamSpec

import numpy as np
from jinja2 import Environment, Template

from mavdiag.printable import printable
from mavdiag.rows.windows import spans
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

FOLDER = Path(__file__).parent
COLUMNS = 1500  # of a line across the page (our choice)
BREAK = 3.0  # a step of more than so many usual ones is a gap in the data (our choice)
UNITS, HIGH = 4000, 1000
ROW, GAP = 17, 10  # of a line of text, and between two panels [px]
LETTER, BOLD, ACROSS = 6.6, 7.4, 320  # width of a letter, of a bold one, of a row of a legend on a phone [px]
TICKS_X, TICKS_Y = 5, 4  # at most (our choice)
EDGE = 46.0  # left of a panel, where those without ticks have their labels [px]
HOLDS = 40  # height that a label of the y axis takes [px]

P = ParamSpec("P")


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """One line of a panel. y: nan leaves a gap. look: a class of chart.css. shape: line, area, bars or dots."""

    x: FloatArray
    y: FloatArray
    label: str = ""
    look: str = "measured"
    shape: str = "line"


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One pair of axes. label: what y is, with its unit. y: its range, None where the lines tell it.

    levels, marks: lines across, at a y, and upright, at an x, each with its label. bands: from one x to another one,
    with a look. healthy: what the statistic of healthy flights stays below. ticks: False for a panel without a scale.
    """

    label: str
    lines: Sequence[Line] = ()
    levels: Sequence[tuple[float, str]] = ()
    marks: Sequence[tuple[float, str]] = ()
    bands: Sequence[tuple[float, float, str]] = ()
    healthy: float | None = None
    y: tuple[float | None, float | None] = (None, None)
    height: int = 120
    ticks: bool = True
    log: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """Panels above each other with one x axis. note: what the caption says of this one.

    x: its range. ticks: of x, None for round numbers. kind: "zoom" if the script may replace it, "follow" if it moves
    with the others of its flight, "still" if x is no time.
    """

    panels: Sequence[Panel]
    x: tuple[float, float]
    note: str = ""
    x_label: str = "time of the flight [s]"
    ticks: Sequence[tuple[float, str]] | None = None
    kind: str = "zoom"


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure of a page, or why there is none. key: its anchor. thesis: number of the thesis's figure like it."""

    key: str
    title: str  # what it shows
    caption: str = ""  # what to see in it
    thesis: str = ""
    svg: str = ""
    not_drawn: str = ""  # why there is no drawing, as a phrase


class NotDrawn(Exception):  # noqa: N818  # no error: the reason, a phrase, stands in the page
    """Why a picture is not drawn."""


def picture(key: str) -> Callable[[Callable[P, Chart]], Callable[P, Picture]]:
    """Make a picture of the chart that a function gives, or of why it raises `NotDrawn`."""

    def decorate(draw: Callable[P, Chart]) -> Callable[P, Picture]:
        @wraps(draw)
        def made(*args: P.args, **kwargs: P.kwargs) -> Picture:
            try:
                return drawn(key, draw(*args, **kwargs))
            except NotDrawn as reason:
                return Picture(key, _captions()[key]["title"], not_drawn=str(reason))

        return made

    return decorate


def drawn(key: str, chart: Chart, name: str = "") -> Picture:
    """The picture of a chart. key: of its words in captions.toml. name: what its title is about, and of its anchor."""
    words = _captions()[key]
    title, caption = words["title"].format(name=name), f"{words['caption']} {chart.note}".strip()
    key = f"{key}:{re.sub(r'[^A-Za-z0-9_-]', '_', name.split(':')[0])}" if name else key
    return Picture(key, title, caption, words.get("thesis", ""), svg_of(chart, title))


@cache
def _captions() -> Mapping[str, Mapping[str, str]]:
    found: Mapping[str, Mapping[str, str]] = tomllib.loads((FOLDER / "captions.toml").read_text(encoding="utf-8"))
    return found


class Thinned:
    """A line as the lowest and the highest value of each column of pixels: the eye sees the same, however long it is.

    span: of the picture [s]. What lies outside of it is left out.
    """

    def __init__(self, span: tuple[float, float], columns: int) -> None:
        (self.begin, self.end), self.step = span, (span[1] - span[0] or 1.0) / columns
        self.low, self.high, self.first, self.last = np.full((4, columns), np.nan)
        self.total, self.count = np.zeros((2, columns))

    def add(self, t: FloatArray, y: FloatArray) -> None:
        """Take further values. t: (n,) not falling. y: (n,), nan where it is unknown."""
        known = np.isfinite(y) & (t >= self.begin) & (t <= self.end)
        t, y = t[known], y[known]
        if not len(t):
            return
        column, first = columns_of(t, self.begin, self.step, len(self.low))
        at, last = column[first], np.append(first[1:], len(t)) - 1
        self.low[at] = np.fmin(self.low[at], np.fmin.reduceat(y, first))
        self.high[at] = np.fmax(self.high[at], np.fmax.reduceat(y, first))
        self.first[at] = np.where(self.count[at] > 0, self.first[at], y[first])
        self.last[at] = y[last]
        self.total[at] += np.add.reduceat(y, first)
        self.count[at] += np.append(first[1:], len(t)) - first

    def mean(self, since: float | None = None) -> float:
        """Mean of all values, or of those in columns that begin later; nan without any."""
        use = self.begin + self.step * np.arange(len(self.low)) >= (-math.inf if since is None else since)
        return float(self.total[use].sum() / self.count[use].sum()) if self.count[use].any() else math.nan

    def line(self, label: str = "", look: str = "measured", factor: float = 1.0) -> Line:
        """Both ends of each column, in the order in which the values went."""
        column = np.flatnonzero(self.count)
        low, high = factor * self.low[column], factor * self.high[column]
        falls = self.last[column] < self.first[column]
        y = np.stack((np.where(falls, high, low), np.where(falls, low, high)), axis=1)
        x = np.asarray(self.begin + self.step * (column[:, None] + np.array([0.25, 0.75])), dtype=np.float64)
        x[low == high, 0] += 0.25 * self.step
        keep = np.stack((np.full(len(low), True), low != high), axis=1)  # one point is enough where both are one
        return Line(*_with_gaps(column, x, y, keep), label, look)

    def area(self, look: str, least: float = -math.inf) -> Line:
        """The highest values, where they are above the least."""
        column = np.flatnonzero((self.count > 0) & (np.nan_to_num(self.high) > least))
        x = np.asarray(self.begin + self.step * (column[:, None] + 0.5), dtype=np.float64)
        y = self.high[column][:, None]
        return Line(*_with_gaps(column, x, y, y > -math.inf, np.flatnonzero(self.count)), look=look, shape="area")


def columns_of(t: FloatArray, begin: float, step: float, columns: int) -> tuple[IntArray, IntArray]:
    """The column of each time, (n,), and the first place of each run in one column. n > 0."""
    column = np.clip((t - begin) / step, 0, columns - 1).astype(np.int64)
    return column, np.flatnonzero(np.diff(column, prepend=-1))


def _with_gaps(
    column: IntArray, x: FloatArray, y: FloatArray, keep: BoolArray, usual: IntArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """The points that are kept, with a nan where columns are missing: more of them than usually, for a slow signal."""
    steps = np.diff(column if usual is None else usual)
    most = BREAK * float(np.median(steps)) if len(steps) else math.inf
    gaps = np.flatnonzero(np.diff(column) > most) + 1
    places = np.cumsum(keep.sum(axis=1))[gaps - 1]
    return np.insert(x[keep], places, x[gaps - 1, -1]), np.insert(y[keep], places, np.nan)


def ticks_of(low: float, high: float, most: int) -> list[float]:
    """Round numbers within a range: two or more, and at most so many and one where that is possible.

    >>> ticks_of(0.0, 41.0, 5), ticks_of(-0.13, 0.12, 4)
    ([0.0, 10.0, 20.0, 30.0, 40.0], [-0.1, -0.05, 0.0, 0.05, 0.1])
    """
    width = (high - low) / most
    power = 10.0 ** math.floor(math.log10(width))
    found = list[float]()
    for step in (power * factor for factor in (10, 5, 2, 1, 0.5)):
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        if len(found) < 2 or last - first <= most:
            found = [round(k * step, 12) + 0.0 for k in range(first, last + 1)]
    return found


def svg_of(chart: Chart, title: str) -> str:
    """The drawing, `PREFIX-title` and `PREFIX-desc` among its ids once it is `embedded`."""
    low, high = chart.x
    ticks = chart.ticks or [(at, f"{at:g}") for at in ticks_of(low, high, TICKS_X)]
    panels, top = list[dict[str, Any]](), 0
    for panel in chart.panels:
        panels.append(_shown(panel, chart.x, top))
        top = panels[-1]["top"] + panel.height + GAP
    told = {"range": f"{low:.9g} {high:.9g}", "ticks": [((at - low) / (high - low), text) for at, text in ticks]}
    sizes = {"height": top + 32, "units": UNITS, "high": HIGH}
    return template("chart.svg").render(chart=chart, title=title, panels=panels, **sizes, **told)


@cache
def template(name: str) -> Template:
    """A template of this folder, whose values are escaped."""
    made = Environment(autoescape=True, trim_blocks=True, finalize=lambda value: printable(str(value)))
    return made.from_string((FOLDER / name).read_text(encoding="utf-8"))


def embedded(svg: str, prefix: str) -> str:
    """The same drawing with a prefix to every id, so that several can stand in one page."""
    svg = re.sub(r'(\bid=")', rf"\g<1>{prefix}-", svg)
    return re.sub(r'aria-labelledby="(\S+) (\S+)"', rf'aria-labelledby="{prefix}-\1 {prefix}-\2"', svg)


def _shown(panel: Panel, across: tuple[float, float], top: int) -> dict[str, Any]:
    levels = (Line(np.array(across), np.full(2, level), label, "limit") for level, label in panel.levels)
    lines = [*panel.lines, *levels]
    low, high = _y_range(panel, lines)
    legend, wide, tall = list(_legend(panel, lines, top)), across[1] - across[0], high - low
    ticks = ticks_of(low, high, min(TICKS_Y, panel.height // HOLDS + 1)) if panel.ticks else []
    ticks = [at for at in ticks if at == round(at)] if panel.log else ticks

    def path(line: Line) -> str:
        right = np.rint(UNITS * (line.x - across[0]) / wide)
        down = np.rint(HIGH * np.clip((high - _y(panel, line.y)) / tall, -1.0, 2.0))
        parts = ([of[a:b].astype(int).tolist() for of in (right, down)] for a, b in spans(np.isfinite(line.y)))
        return "".join(_PATHS[line.shape](x, y) for x, y in parts)

    bands = ((look, UNITS * (a - across[0]) / wide, UNITS * (b - a) / wide) for a, b, look in panel.bands)
    return {
        "label": panel.label,
        "height": panel.height,
        "legend": legend,
        "top": max(y for _, _, y, _ in legend) + ROW - 8,
        "range": f"{low:.6g} {high:.6g}",
        "ticks": [((high - at) / tall, f"{10**at if panel.log else at:g}") for at in ticks],
        "bands": [(look, round(x), max(round(width), UNITS // 300)) for look, x, width in bands],
        "healthy": None if panel.healthy is None else round(HIGH * (high - panel.healthy) / tall),
        "paths": [(line, path(line)) for line in lines],
        "marks": [((at - across[0]) / wide, label) for at, label in panel.marks],
    }


def _legend(panel: Panel, lines: Sequence[Line], top: int) -> Iterator[tuple[str, int, int, str]]:
    """The label of a panel and what its lines are: class, place [px] and text of each, in rows that a phone holds."""
    first = wrap(panel.label, int((ACROSS if panel.ticks else ACROSS + EDGE) / LETTER))
    x, y = 0.0 if panel.ticks else -EDGE, top - ROW + 12
    for text in first:
        y += ROW
        yield "name" if panel.ticks else "of", round(x), y, text
    x += BOLD * len(first[-1]) + 10
    named = [(f"{line.shape} {line.look}", line.label) for line in lines if line.label]
    for what, label in [*named, *([("area healthy", "usual in health")] if panel.healthy else [])]:
        if x + 26 + LETTER * len(label) > ACROSS:
            x, y = 0.0, y + ROW
        yield what, round(x + 4), y, ""
        yield "of", round(x + 26), y, label
        x += 36 + LETTER * len(label)


def _y_range(panel: Panel, lines: Sequence[Line]) -> tuple[float, float]:
    values = np.concatenate([np.full(1, np.nan if panel.healthy is None else panel.healthy), *(one.y for one in lines)])
    known = _y(panel, values[np.isfinite(values)])
    least, most = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    room, (low, high) = 0.05 * (most - least or abs(most) or 1.0), panel.y
    return least - room if low is None else low, most + room if high is None else high


def _y(panel: Panel, y: FloatArray) -> FloatArray:
    return np.log10(np.maximum(y, 1e-12)) if panel.log else y


def _steps(x: list[int], y: list[int]) -> str:
    pairs = zip(x, x[1:], y, y[1:], strict=False)
    told = " ".join(f"{b - a} {d - c}" for a, b, c, d in pairs) or "0 0"
    return f"l{told}".replace(" -", "-")


#: Each shape as the commands of a path, of one stretch without a gap.
_PATHS: Mapping[str, Callable[[list[int], list[int]], str]] = {
    "line": lambda x, y: f"M{x[0]} {y[0]}{_steps(x, y)}",
    "area": lambda x, y: f"M{x[0]} {HIGH}V{y[0]}{_steps(x, y)}V{HIGH}z",
    "bars": lambda x, y: "".join(f"M{a} {HIGH}V{b}" for a, b in zip(x, y, strict=True)),
    "dots": lambda x, y: "".join(f"M{a} {b}h0" for a, b in zip(x, y, strict=True)),
}
