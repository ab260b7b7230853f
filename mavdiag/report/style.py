"""How every figure looks, how long lines are made short, and how a figure becomes SVG that can stand in a page.

The colours are those of `mavdiag.report.drawing`; each line has a stroke of its own as well: it can be read in grey.
figures.mplstyle has sizes and fonts, captions.toml what a figure is called and shows.
"""

import io
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, wraps
from html import escape
from pathlib import Path
from typing import Any, ParamSpec, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from mavdiag.report.drawing import Colour
from mavdiag.telemetry import FloatArray, IntArray

FOLDER = Path(__file__).parent
WIDTH_IN = 7.6
PX_PER_PT = 4 / 3
NO_LABEL = "_nolegend_"  # how matplotlib calls a line that no legend has
LONG_PATH = 2000  # characters of a line of data, whose points are too near to each other to need hundredths
FONTS = "DejaVu Sans, Verdana, Arial, sans-serif"  # as in figures.mplstyle, where matplotlib says it at each text
SVG = "http://www.w3.org/2000/svg"
COLUMNS = 480  # of a figure across the page (our choice)
BREAK = 3.0  # a step of more than so many usual ones is a gap in the data (our choice)

P = ParamSpec("P")
Drawn: TypeAlias = tuple[Figure, str, str]  # the figure, its words for those who cannot see it, and its note


@dataclass(frozen=True, slots=True)
class Line:
    """One way to draw a line: colour, stroke and width."""

    color: str
    stroke: str
    width: float = 1.1

    def draw(self, axes: Axes, x: Any, y: Any, label: str = NO_LABEL, marker: str | None = None) -> None:
        """Onto axes."""
        axes.plot(x, y, label=label, marker=marker, color=self.color, linestyle=self.stroke, linewidth=self.width)

    def across(self, axes: Axes, level: float, label: str = NO_LABEL) -> None:
        """A level, across the axes."""
        axes.axhline(level, label=label, color=self.color, linestyle=self.stroke, linewidth=self.width)


COMMANDED = Line(Colour.REFERENCE, ":", 1.1)
MEASURED = Line(Colour.MEASURED, "-", 1.1)
SIMULATED = Line(Colour.SIMULATED, "--", 1.6)
LIMIT = Line(Colour.FAULT, "--", 1.2)

#: Lines of equal rank, in order: each differs from the others in grey too.
LINES = (
    Line(Colour.MEASURED, "-", 1.2),
    Line(Colour.SIMULATED, "--", 1.5),
    Line(Colour.HEALTHY, "-.", 1.2),
    Line(Colour.REFERENCE, ":", 1.4),
    Line(Colour.LIMIT, "-", 2.2),
    Line(Colour.RESIDUAL, "--", 2.2),
    Line(Colour.NOT_JUDGED, "-.", 2.2),
    Line(Colour.MEASURED, ":", 2.4),
)


@cache
def captions() -> Mapping[str, Mapping[str, str]]:
    """Title, caption and the thesis's number of each figure, by its key."""
    return tomllib.loads((FOLDER / "captions.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure of a page, or why there is none."""

    key: str  # its anchor in a page; its words stand under it in captions.toml
    note: str = ""  # what the caption says of this flight
    svg: str = ""
    not_drawn: str = ""  # why there is no drawing, as a phrase

    @property
    def title(self) -> str:
        """What it shows."""
        return captions()[self.key]["title"]

    @property
    def caption(self) -> str:
        """What to see in it."""
        return f"{captions()[self.key]['caption']} {self.note}".strip()

    @property
    def thesis(self) -> str:
        """Number of the thesis's figure like it; empty if it has none."""
        return captions()[self.key].get("thesis", "")


class NotDrawn(Exception):  # noqa: N818  # no error: the reason, a phrase, stands in the page
    """Why a picture is not drawn."""


def picture(key: str) -> Callable[[Callable[P, Drawn]], Callable[P, Picture]]:
    """Make a picture of what a function draws, in the style of all pages; or of why it raises `NotDrawn`."""

    def decorate(draw: Callable[P, Drawn]) -> Callable[P, Picture]:
        @wraps(draw)
        def made(*args: P.args, **kwargs: P.kwargs) -> Picture:
            try:
                with mpl.rc_context(fname=FOLDER / "figures.mplstyle"):
                    figure, words, note = draw(*args, **kwargs)
                    return Picture(key, note, _svg(figure, captions()[key]["title"], words))
            except NotDrawn as reason:
                return Picture(key, not_drawn=str(reason))

        return made

    return decorate


def sheet(height_in: float) -> Figure:
    """An empty figure across the page."""
    return Figure(figsize=(WIDTH_IN, height_in), layout="constrained")


def panels(height_in: float, rows: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure with axes one above the other, and one axis of vehicle time."""
    figure = sheet(height_in)
    found = list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])
    found[-1].set_xlabel("vehicle time [s]")
    return figure, found


def legend_above(axes: Axes, columns: int = 4, named: Mapping[str, Any] | None = None) -> None:
    """A legend above the axes, where it hides nothing. named: what it names, by label; None for what is in the axes."""
    what = axes.get_legend_handles_labels() if named is None else (list(named.values()), list(named))
    place: Any = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0)}
    axes.legend(*what, **place, ncols=columns, borderaxespad=0.1, handlelength=2.6)


def envelope(
    t: FloatArray, y: FloatArray, columns: int = COLUMNS, *, filled: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Thin a line to the lowest and the highest value of each column of pixels: the eye sees the same.

    t: (n,) not falling. y: (n,); nan leaves a gap. filled: from below, so that the highest is enough.
    """
    if len(t) <= (1 if filled else 2) * columns:
        return _with_breaks(t, y)
    column, first = columns_of(t, columns)
    last, high = np.append(first[1:], len(t)) - 1, np.fmax.reduceat(y, first)
    times, values = t[first][:, None], high[:, None]
    if not filled:  # the order of both, so that slopes look as they are
        low, falling = np.fmin.reduceat(y, first), y[last] < y[first]
        times = np.stack((t[first], (t[first] + t[last]) / 2), axis=1)
        values = np.stack((np.where(falling, high, low), np.where(falling, low, high)), axis=1)
    empty = np.flatnonzero(np.diff(column[first]) > 1) + 1
    places = times.shape[1] * empty
    return np.insert(times.ravel(), places, times[empty - 1, -1]), np.insert(values.ravel(), places, np.nan)


def columns_of(t: FloatArray, columns: int) -> tuple[IntArray, IntArray]:
    """The column of each point, (n,), and the first point of each column that has any. t: (n,) not falling, n > 0."""
    span = float(t[-1] - t[0]) or 1.0
    column = np.minimum((t - t[0]) * (columns / span), columns - 1).astype(np.int64)
    return column, np.flatnonzero(np.diff(column, prepend=-1))


def _with_breaks(t: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The line with a nan in each gap, so that none is drawn across it. Times may repeat."""
    steps = np.diff(t)
    if len(t) < 3 or not (steps > 0).any():
        return t, y
    at = np.flatnonzero(steps > BREAK * float(np.median(steps[steps > 0]))) + 1
    return np.insert(t, at, t[at - 1]), np.insert(y, at, np.nan)


def embedded(svg: str, prefix: str) -> str:
    """The same drawing with a prefix to every id, so that several can stand in one page."""
    svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{prefix}-", svg)
    return re.sub(r'aria-labelledby="(\S+) (\S+)"', rf'aria-labelledby="{prefix}-\1 {prefix}-\2"', svg)


def _svg(figure: Figure, title: str, description: str) -> str:
    """A figure as SVG with words for those who cannot see it, without what a page need not have."""
    FigureCanvasSVG(figure)
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = out.getvalue()
    referred = set(re.findall(r'(?:url\(|href=")#([^)"]+)', text))
    width, height = (float(size) for size in re.findall(r'viewBox="0 0 (\S+) (\S+)"', text)[0])
    head = (
        f'<svg viewBox="0 0 {width:g} {height:g}" width="{PX_PER_PT * width:.0f}" height="{PX_PER_PT * height:.0f}" '
        f'xmlns="{SVG}" role="img" stroke-linejoin="round" font-family="{FONTS}" aria-labelledby="title desc">'
        f'<title id="title">{escape(title)}</title><desc id="desc">{escape(description)}</desc>'
    )
    text = re.sub(r"^.*?<svg[^>]*>", lambda _: head, text, flags=re.DOTALL)
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r' id="([^"]+)"', lambda at: at[0] if at[1] in {*referred, "title", "desc"} else "", text)
    text = re.sub(r' d="([^"]*)"', lambda at: f' d="{_shortened(at[1])}"', text)
    text = re.sub(r' ([xy])="(-?\d+\.\d+)"', lambda at: f' {at[1]}="{_fixed(at[2], 2)}"', text)
    text = re.sub(r"font-family: [^;\"]*;? ?", "", text)
    text = re.sub(r' style="([^"]*)"', lambda at: f' style="{at[1].replace(": ", ":").replace("; ", ";")}"', text)
    text = re.sub(r' transform="rotate\(-0 [^"]*"', "", text).replace("xlink:href", "href")
    return re.sub(r">\s+<", "><", text).strip() + "\n"


def _shortened(path: str) -> str:
    places = 1 if len(path) > LONG_PATH else 2
    path = re.sub(r"-?\d+\.\d+", lambda found: _fixed(found[0], places), path)
    return re.sub(r"\s*([A-Za-z])\s*", r"\1", path.strip())


def _fixed(number: str, places: int) -> str:
    return f"{float(number):.{places}f}".rstrip("0").rstrip(".")
