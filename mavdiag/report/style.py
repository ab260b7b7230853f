"""How every figure looks, and how it becomes SVG that can stand in a page.

The colours are those of `mavdiag.drawing`, which people who are blind to a colour tell apart. None stands alone: each
line has a stroke of its own as well, so a figure can be read in grey. Text stays text. matplotlib is imported when the
first figure is drawn. figures.mplstyle has sizes and fonts, captions.toml what a figure is called and shows.
"""

import io
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from mavdiag.drawing import Colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FOLDER = Path(__file__).parent
WIDTH_IN = 7.6
FEW_DECADES = 100.0
PX_PER_PT = 4 / 3
NO_LABEL = "_nolegend_"  # how matplotlib calls a line that no legend has
LONG_PATH = 2000  # characters of a line of data, whose points are too near to each other to need hundredths
FONTS = "DejaVu Sans, Verdana, Arial, sans-serif"  # as in figures.mplstyle, where matplotlib says it at each text
SVG = "http://www.w3.org/2000/svg"
XLINK = "http://www.w3.org/1999/xlink"


@dataclass(frozen=True, slots=True)
class Line:
    """One way to draw a line: colour, stroke and width."""

    color: str
    stroke: str
    width: float = 1.1

    def draw(self, axes: "Axes", x: Any, y: Any, label: str = NO_LABEL, marker: str = "") -> None:
        """Onto axes."""
        style: Any = {"color": self.color, "linestyle": self.stroke, "linewidth": self.width}
        axes.plot(x, y, label=label, marker=marker or None, **style)

    def across(self, axes: "Axes", level: float, label: str = NO_LABEL) -> None:
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


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure of a page, or why there is none.

    key: its anchor in a page, letters and hyphens; its words stand under it in captions.toml.
    note: what the caption says of this flight.
    svg: the drawing; empty if there is none, and then not_drawn says why.
    """

    key: str
    note: str = ""
    svg: str = ""
    not_drawn: str = ""

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


@cache
def captions() -> Mapping[str, Mapping[str, str]]:
    """Title, caption and the thesis's number of each figure, by its key."""
    return tomllib.loads((FOLDER / "captions.toml").read_text(encoding="utf-8"))


def pictured(
    key: str, words: str, plot: Callable[["Figure"], None], height_in: float = 2.6, *, note: str = ""
) -> Picture:
    """The picture of what `plot` puts on an empty figure. words: what is in it, for those who cannot see it."""
    return Picture(key, note, drawn(captions()[key]["title"], words, plot, height_in))


def missing(key: str, why: str) -> Picture:
    """A picture that is not drawn, and the reason as a phrase."""
    return Picture(key, not_drawn=why)


def drawn(title: str, description: str, plot: Callable[["Figure"], None], height_in: float = 2.6) -> str:
    """The SVG of what `plot` puts on an empty figure. The same values give the same bytes."""
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with mpl.rc_context(fname=FOLDER / "figures.mplstyle"):
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        FigureCanvasSVG(figure)
        plot(figure)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    return _cleaned(out.getvalue(), title, description)


def panels(figure: "Figure", rows: int) -> list["Axes"]:
    """Axes one above the other, with one axis of vehicle time."""
    found = list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])
    found[-1].set_xlabel("vehicle time [s]")
    return found


def plain_log(axes: "Axes") -> None:
    """A logarithmic ordinate with plain numbers: at its decades, or at 1, 2 and 5 where it has few."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0,) if high > FEW_DECADES * low else (1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def shaded(axes: "Axes", start: float, stop: float) -> None:
    """A stretch of time marked as above a limit: hatched, so that it shows in grey."""
    axes.axvspan(start, stop, facecolor="none", edgecolor=Colour.FAULT, hatch="////", linewidth=0.0, alpha=0.7)


def legend_above(axes: "Axes", columns: int = 4, named: Mapping[str, Any] | None = None) -> None:
    """A legend above the axes, where it hides nothing. named: what it names, by label; None for what is in the axes."""
    what = axes.get_legend_handles_labels() if named is None else (list(named.values()), list(named))
    place: Any = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0)}
    axes.legend(*what, **place, ncols=columns, borderaxespad=0.1, handlelength=2.6)


def embedded(svg: str, prefix: str) -> str:
    """The same drawing with a prefix to every id, so that several can stand in one page."""
    svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{prefix}-", svg)
    return re.sub(r'aria-labelledby="(\S+) (\S+)"', rf'aria-labelledby="{prefix}-\1 {prefix}-\2"', svg)


def _cleaned(text: str, title: str, description: str) -> str:
    """What matplotlib wrote, smaller, without what a page cannot have twice, and with words for who cannot see it."""
    root = ElementTree.fromstring(text)
    referred = set(re.findall(r'(?:url\(|href=")#([^)"]+)', text))
    for node in root.iter():
        node.tag = node.tag.partition("}")[2]
        if (target := node.attrib.pop(f"{{{XLINK}}}href", None)) is not None:
            node.set("href", target)
        if node.get("id") not in referred:
            node.attrib.pop("id", None)
        _shorten(node)
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in ("metadata", "style"):
                parent.remove(child)
    width, height = (float(x) for x in root.attrib["viewBox"].split()[2:])
    for name in ("width", "height", "version"):
        root.attrib.pop(name, None)
    said = {"width": f"{PX_PER_PT * width:.0f}", "height": f"{PX_PER_PT * height:.0f}", "xmlns": SVG, "role": "img"}
    stroke = {"stroke-linejoin": "round", "font-family": FONTS, "aria-labelledby": "title desc"}
    root.attrib.update({**said, **stroke})
    for place, (name, words) in enumerate((("title", title), ("desc", description))):
        node = ElementTree.Element(name, {"id": name})
        node.text = words
        root.insert(place, node)
    return re.sub(r">\s+<", "><", ElementTree.tostring(root, encoding="unicode")).strip() + "\n"


def _shorten(node: ElementTree.Element) -> None:
    """Fewer digits than anybody can see, and the font's name once, at the root."""
    if (path := node.get("d")) is not None:
        places = 1 if len(path) > LONG_PATH else 2
        path = re.sub(r"-?\d+\.\d+", lambda found: f"{float(found[0]):.{places}f}".rstrip("0").rstrip("."), path)
        node.set("d", re.sub(r"\s*([A-Za-z])\s*", r"\1", path.strip()))
    if (style := node.get("style")) is not None:
        node.set("style", re.sub(r"font-family: [^;]*;? ?", "", style).replace(": ", ":").replace("; ", ";"))
    if node.get("transform", "").startswith("rotate(-0 "):
        del node.attrib["transform"]
    for name in ("x", "y"):
        if "." in (value := node.get(name, "")):
            node.set(name, f"{float(value):.2f}".rstrip("0").rstrip("."))
