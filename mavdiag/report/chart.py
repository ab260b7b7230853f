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
from html import escape
from pathlib import Path
from textwrap import wrap
from typing import ParamSpec

import numpy as np

from mavdiag.rows.windows import spans
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

FOLDER = Path(__file__).parent
SVG = "http://www.w3.org/2000/svg"
COLUMNS = 1500  # of a line across the page (our choice)
BREAK = 3.0  # a step of more than so many usual ones is a gap in the data (our choice)
UNITS, HIGH = 4000, 1000
ROW, GAP = 17, 10  # of a line of text, and between two panels [px]
LETTER, BOLD, ACROSS = (
    6.6,
    7.4,
    320,
)  # width of a letter, of a bold one, and of a row of a legend, which a phone must hold [px]
TICKS_X, TICKS_Y = 5, 4  # at most (our choice)
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
    """Panels above each other with one x axis. words: for those who cannot see it. note: of the caption.

    x: its range. ticks: of x, None for round numbers. kind: "zoom" if the script may replace it, "follow" if it moves
    with the others of its flight, "still" if x is no time.
    """

    panels: Sequence[Panel]
    x: tuple[float, float]
    words: str
    note: str = ""
    x_label: str = "time of the flight [s]"
    ticks: Sequence[tuple[float, str]] | None = None
    kind: str = "zoom"


@cache
def captions() -> Mapping[str, Mapping[str, str]]:
    """Title, caption and the thesis's number of each figure, by its key."""
    return tomllib.loads((FOLDER / "captions.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure of a page, or why there is none."""

    key: str  # its anchor in a page; its words stand under it, or under what precedes ":", in captions.toml
    note: str = ""  # what the caption says of this flight
    svg: str = ""
    not_drawn: str = ""  # why there is no drawing, as a phrase
    name: str = ""  # what its title is about, where the key does not tell

    @property
    def title(self) -> str:
        """What it shows."""
        return captions()[self.key.split(":")[0]]["title"].format(name=self.name)

    @property
    def caption(self) -> str:
        """What to see in it."""
        return f"{captions()[self.key.split(':')[0]]['caption']} {self.note}".strip()

    @property
    def thesis(self) -> str:
        """Number of the thesis's figure like it; empty if it has none."""
        return captions()[self.key.split(":")[0]].get("thesis", "")


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
                return Picture(key, not_drawn=str(reason))

        return made

    return decorate


def drawn(key: str, chart: Chart, name: str = "") -> Picture:
    """The picture of a chart. name: what its title is about."""
    found = Picture(key, chart.note, name=name)
    return Picture(key, chart.note, svg_of(chart, found.title), name=name)


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
    ([0.0, 10.0, 20.0, 30.0, 40.0], [-0.1, 0.0, 0.1])
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
    places = [(100 * (at - low) / (high - low), text) for at, text in ticks]
    parts, top = list[str](), 0
    for panel in chart.panels:
        parts += _legend(panel, top)
        top += ROW * len(_rows(panel)) + 4
        parts += _axes(panel, places, top)
        parts.append(_plot(panel, chart.x, top))
        top += panel.height + GAP
    parts += [
        f'<text class="x" x="{at:.4g}%" y="{top + 6}" data-at="{at / 100:.5g}">{text}</text>' for at, text in places
    ]
    parts.append(f'<text class="x name" x="50%" y="{top + 24}">{escape(chart.x_label)}</text>')
    head = f'<svg xmlns="{SVG}" class="chart" width="100%" height="{top + 32}" role="img" aria-labelledby="title desc"'
    told = f'<title id="title">{escape(title)}</title><desc id="desc">{escape(chart.words)}</desc>'
    return f'{head} data-kind="{chart.kind}" data-name="{escape(chart.x_label)}">{told}{"".join(parts)}</svg>\n'


def standing_alone(svg: str, width: int = 760) -> str:
    """The drawing as a file of its own."""
    height = int(re.findall(r'height="(\d+)"', svg)[0]) + 16
    style = (FOLDER / "chart.css").read_text(encoding="utf-8")
    ground = '<rect width="100%" height="100%" class="ground"/>'
    inner = svg.strip().replace('width="100%"', f'x="64" y="8" width="{width - 84}" overflow="visible"', 1)
    head = f'<svg xmlns="{SVG}" width="{width}" height="{height}" viewBox="0 0 {width} {height}">'
    return f"{head}<style>{style}</style>{ground}{inner}</svg>\n"


def embedded(svg: str, prefix: str) -> str:
    """The same drawing with a prefix to every id, so that several can stand in one page."""
    svg = re.sub(r'(\bid=")', rf"\g<1>{prefix}-", svg)
    return re.sub(r'aria-labelledby="(\S+) (\S+)"', rf'aria-labelledby="{prefix}-\1 {prefix}-\2"', svg)


def _rows(panel: Panel) -> list[list[tuple[str, str]]]:
    """The label of a panel and what its legend names, as classes and text, row by row."""
    named = [(f"{line.shape} {line.look}", line.label) for line in panel.lines if line.label]
    named += [("line limit", label) for _, label in panel.levels if label]
    named += [("area healthy", "usual in health")] if panel.healthy else []
    rows = [[("", text)] for text in wrap(panel.label, int(ACROSS / LETTER))]
    left = ACROSS - BOLD * len(rows[-1][0][1])
    for what, label in named:
        width = 34 + LETTER * len(label)
        if width > left:
            rows.append([])
            left = ACROSS
        rows[-1].append((what, label))
        left -= width
    return rows


def _legend(panel: Panel, top: int) -> Iterator[str]:
    for number, row in enumerate(_rows(panel)):
        x, y = 0.0, top + ROW * number + 12
        for what, label in row:
            if what:
                swatch = "M{0} {1}h18" if "dots" not in what else "M{0} {1}h0"
                swatch = swatch if "area" not in what else "M{0} {2}h18v9h-18z"
                yield f'<path class="{what}" d="{swatch.format(round(x + 4), y - 4, y - 9)}"/>'
                x += 26
            bold = panel.ticks and not what
            yield f'<text class="{"name" if bold else "of"}" x="{x:.0f}" y="{y}">{escape(label)}</text>'
            x += (BOLD if bold else LETTER) * len(label) + 10


def _axes(panel: Panel, places: Sequence[tuple[float, str]], top: int) -> Iterator[str]:
    yield f'<rect class="frame" y="{top}" width="100%" height="{panel.height}"/>'
    low, high = y_range(panel)
    if panel.ticks:
        ticks = ticks_of(low, high, min(TICKS_Y, panel.height // HOLDS + 1))
        for at in [at for at in ticks if at == round(at)] if panel.log else ticks:
            y, text = top + panel.height * (high - at) / (high - low), f"{10**at:g}" if panel.log else f"{at:g}"
            yield f'<line class="grid" x2="100%" y1="{y:.1f}" y2="{y:.1f}"/>'
            yield f'<text class="y" x="-6" y="{y + 4:.1f}">{text}</text>'
    for at, _ in places:
        yield f'<line class="grid" x1="{at:.4g}%" x2="{at:.4g}%" y1="{top}" y2="{top + panel.height}"/>'


def y_range(panel: Panel) -> tuple[float, float]:
    """The range of the y axis: what is told, or what the lines and levels need."""
    if not panel.ticks and None not in panel.y:
        return panel.y  # type: ignore[return-value]
    values = [_y(panel, line.y) for line in panel.lines]
    values.append(np.array([level for level, _ in panel.levels] + [panel.healthy or 0.0] * (panel.healthy is not None)))
    known = np.concatenate([value[np.isfinite(value)] for value in values])
    least, most = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    room = 0.05 * (most - least or abs(most) or 1.0)
    low, high = panel.y
    return least - room if low is None else low, most + room if high is None else high


def _y(panel: Panel, y: FloatArray) -> FloatArray:
    return np.log10(np.maximum(y, 1e-12)) if panel.log else y


def _plot(panel: Panel, x: tuple[float, float], top: int) -> str:
    (x0, x1), (y0, y1) = x, y_range(panel)

    def across(values: FloatArray | float) -> IntArray:
        return np.rint(UNITS * (np.atleast_1d(values) - x0) / (x1 - x0)).astype(np.int64)

    def up(values: FloatArray | float) -> IntArray:
        return np.rint(HIGH * np.clip((y1 - np.atleast_1d(values)) / (y1 - y0), -1.0, 2.0)).astype(np.int64)

    parts = list[str]()
    for begin, end, look in panel.bands:
        at, to = across(np.array([begin, end])).tolist()
        parts.append(f'<rect class="band {look}" x="{at}" width="{max(to - at, UNITS // 300)}" height="{HIGH}"/>')
    if panel.healthy is not None:
        parts.append(f'<rect class="healthy" y="{up(panel.healthy)[0]}" width="{UNITS}" height="{HIGH}"/>')
    for line in panel.lines:
        known = np.isfinite(line.y)
        segments = [
            (across(line.x[first:stop]).tolist(), up(_y(panel, line.y[first:stop])).tolist())
            for first, stop in spans(known)
        ]
        path, label = _PATHS[line.shape](segments), escape(line.label)
        parts.append(f'<path class="{line.shape} {line.look}" data-label="{label}" d="{path}"/>')
    for level, label in panel.levels:
        parts.append(f'<path class="line limit" data-label="{escape(label)}" d="M0 {up(level)[0]}l{UNITS} 0"/>')
    parts += [f'<path class="mark" d="M{across(at)[0]} 0V{HIGH}"/>' for at, _ in panel.marks]
    told = f'data-x="{x0:.9g} {x1:.9g}" data-y="{y0:.6g} {y1:.6g}" data-label="{escape(panel.label)}"'
    box = f'y="{top}" width="100%" height="{panel.height}" viewBox="0 0 {UNITS} {HIGH}" preserveAspectRatio="none"'
    texts = [
        f'<text class="mark" x="{100 * (at - x0) / (x1 - x0):.4g}%" y="{top + 13}">{escape(label)}</text>'
        for at, label in panel.marks
    ]
    return f'<svg class="plot" {box} {told}>{"".join(parts)}</svg>{"".join(texts)}'


Segments = Sequence[tuple[list[int], list[int]]]


def _steps(x: list[int], y: list[int]) -> str:
    """From the first point to the others, each from the one before."""
    pairs = zip(x, x[1:], y, y[1:], strict=False)
    told = " ".join(f"{b - a} {d - c}" for a, b, c, d in pairs) or "0 0"
    return f"l{told}".replace(" -", "-")


#: Each shape as the commands of a path.
_PATHS: Mapping[str, Callable[[Segments], str]] = {
    "line": lambda parts: "".join(f"M{x[0]} {y[0]}{_steps(x, y)}" for x, y in parts),
    "area": lambda parts: "".join(f"M{x[0]} {HIGH}V{y[0]}{_steps(x, y)}V{HIGH}z" for x, y in parts),
    "bars": lambda parts: "".join(f"M{a} {HIGH}V{b}" for x, y in parts for a, b in zip(x, y, strict=True)),
    "dots": lambda parts: "".join(f"M{a} {b}h0" for x, y in parts for a, b in zip(x, y, strict=True)),
}
