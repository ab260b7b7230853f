"""The drawing of an airframe as SVG, from its rotor layout; and the colours of all figures. Text in, text out.

The vehicle is seen from above with its nose up. A rotor has its number, its sense of rotation, and a fill and a label
from the caller. The SVG holds no style attribute and no script: a page may restyle it by its classes and ids, and a
strict Content-Security-Policy lets it pass. What has no fill of its own is drawn in `currentColor`.
"""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from xml.sax.saxutils import escape, quoteattr

from mavdiag.airframe.layout import Place, RotorLayout
from mavdiag.printable import printable

__all__ = ["Colour", "RotorMark", "airframe_svg", "rotor_places", "text_colour", "where"]

SIZE = 240.0  # of the viewBox
REACH = 76.0  # from its centre to the outermost rotor's centre
RADIUS_MOST = 38.0  # of a rotor, so that all of it stays within the viewBox
SHARE = 0.44  # of the distance between two rotors that a radius takes: neighbours do not touch
APART = 0.75  # how far rotors of one place are drawn apart, of the vehicle's reach (our choice)
BODY = 19.0  # radius of the body
LABEL_FROM = 20.0  # radius of a rotor from which on its label fits into it; else it stands below


class Colour(StrEnum):
    """The palette of Okabe and Ito (Color Universal Design, 2008), which the colour-blind can tell apart, by meaning.

    Two names for one colour are the same colour on purpose: they are not drawn in one figure.
    """

    REFERENCE = "#000000"  # what was commanded
    MEASURED = "#0072B2"  # blue
    SIMULATED = "#E69F00"  # orange: the model's output
    RESIDUAL = "#56B4E9"  # sky blue
    LIMIT = "#CC79A7"  # reddish purple: margin, FML, thresholds
    HEALTHY = "#009E73"  # bluish green
    SUSPECTED = "#F0E442"  # yellow
    FAULT = "#D55E00"  # vermilion
    NOT_JUDGED = "#999999"  # the grey that goes with the palette


@dataclass(frozen=True, slots=True)
class RotorMark:
    """What is shown of one rotor.

    fill: a colour as #RRGGBB; None for none.
    label: a short text in the disc, such as "+11 %".
    kind: a further class of its group, such as "suspected"; letters, digits and hyphens.
    """

    fill: str | None = None
    label: str = ""
    kind: str = ""


def rotor_places(layout: RotorLayout) -> tuple[Place, ...]:
    """Where the rotors are, in the units in which the outermost one is 1 from the centre.

    A layout knows lengths only up to one scale for each axis, so an airframe that is longer than wide is drawn square.
    Rotors that share a place, as on coaxial arms, are set apart along the circle.

    >>> from mavdiag.airframe.layout import layout_named
    >>> [(round(one.x_m, 2), round(one.y_m, 2), one.spin) for one in rotor_places(layout_named("x"))][:2]
    [(0.71, 0.71, 'ccw'), (-0.71, -0.71, 'ccw')]
    """
    points = [(pitch, -roll) for roll, pitch, _ in layout.signs]
    reach = max(math.hypot(*point) for point in points)
    points = [(round(x / reach, 6), round(y / reach, 6)) for x, y in points]
    total, seen, places = Counter(points), Counter[tuple[float, float]](), []
    for (x, y), (_, _, yaw) in zip(points, layout.signs, strict=True):
        along = APART * (seen[x, y] - 0.5 * (total[x, y] - 1))
        seen[x, y] += 1
        far = math.hypot(x, y) or 1.0
        across_x, across_y = (-y / far, x / far) if (x, y) != (0.0, 0.0) else (0.0, 1.0)
        places.append(Place(x + along * across_x, y + along * across_y, "ccw" if yaw > 0 else "cw"))
    return tuple(places)


def where(place: Place) -> str:
    """A rotor's place in words.

    >>> where(Place(0.7, -0.7, "cw")), where(Place(1.0, 0.0, "ccw")), where(Place(0.0, 0.0, "cw"))
    ('front left', 'front', 'centre')
    """
    length = math.hypot(place.x_m, place.y_m)
    along = "front" if place.x_m > 0.2 * length else "rear" if place.x_m < -0.2 * length else ""
    across = "right" if place.y_m > 0.2 * length else "left" if place.y_m < -0.2 * length else ""
    return f"{along} {across}".strip() or "centre"


def text_colour(fill: str | None) -> str:
    """Black or white, whichever is read better on a fill (WCAG 2.2, relative luminance); currentColor on none.

    >>> text_colour(Colour.SUSPECTED), text_colour(Colour.MEASURED), text_colour(None)
    ('#000000', '#FFFFFF', 'currentColor')
    """
    if fill is None:
        return "currentColor"
    parts = [int(fill[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
    red, green, blue = (one / 12.92 if one <= 0.04045 else ((one + 0.055) / 1.055) ** 2.4 for one in parts)
    luminance = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    return "#000000" if (luminance + 0.05) / 0.05 >= 1.05 / (luminance + 0.05) else "#FFFFFF"


def airframe_svg(
    layout: RotorLayout, marks: Mapping[int, RotorMark] | None = None, *, title: str = "", prefix: str = "airframe"
) -> str:
    """The drawing as an `<svg>` element that can stand in a page or in a file.

    marks: what is shown of a rotor, by its number from 1; rotors without one are plain.
    title: its accessible name; without it, the layout's name.
    prefix: of all ids: `PREFIX-rotor-3` is the group of rotor 3. Another one for each drawing of a page.
    Classes: `airframe`; `body`, `arm`, `forward`; `rotor` with `data-rotor` and the mark's kind, in it `rotor-disc`,
    `rotor-spin`, `rotor-number`, `rotor-label`.
    """
    places, marks = rotor_places(layout), marks or {}
    points = [(SIZE / 2 + REACH * place.y_m, SIZE / 2 - REACH * place.x_m) for place in places]
    radius = _radius(points)
    named = f"{prefix}-title"
    words = "; ".join(f"rotor {i} {where(one)}, {_turning(one)}" for i, one in enumerate(places, start=1))
    discs = (
        _rotor(number, point, radius, place, marks.get(number, RotorMark()), prefix)
        for number, (point, place) in enumerate(zip(points, places, strict=True), start=1)
    )
    return "\n".join(
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" class="airframe" viewBox="0 0 {SIZE:g} {SIZE:g}" role="img" '
            f"aria-labelledby={quoteattr(named)} color={quoteattr(Colour.REFERENCE)} "
            'font-family="system-ui, sans-serif">',
            f"<title id={quoteattr(named)}>{_text(title or f'airframe {layout.name}')}</title>",
            f"<desc>{_text(words)}</desc>",
            '<g class="arms" stroke="currentColor" stroke-width="4" stroke-linecap="round" opacity="0.45">',
            *(f'<line class="arm" {_line(point, radius)}/>' for point in points),
            "</g>",
            *_body(),
            *discs,
            "</svg>",
        )
    )


def _radius(points: list[tuple[float, float]]) -> float:
    """Of all rotors: the largest with which none touches another one or the body's middle."""
    gaps = [math.dist(a, b) for i, a in enumerate(points) for b in points[:i]]
    return min([RADIUS_MOST, *(SHARE * gap for gap in gaps)])


def _turning(place: Place) -> str:
    return "turns clockwise" if place.spin == "cw" else "turns counter-clockwise"


def _text(text: str) -> str:
    return escape(printable(text))


def _line(to: tuple[float, float], radius: float) -> str:
    """An arm, from the centre to the rim of its rotor."""
    middle = SIZE / 2
    share = max(0.0, 1.0 - radius / max(radius, math.dist(to, (middle, middle))))
    x, y = middle + share * (to[0] - middle), middle + share * (to[1] - middle)
    return f'x1="{middle:g}" y1="{middle:g}" x2="{x:.1f}" y2="{y:.1f}"'


def _body() -> tuple[str, ...]:
    middle, nose = SIZE / 2, SIZE / 2 - BODY - 4.0
    return (
        f'<circle class="body" cx="{middle:g}" cy="{middle:g}" r="{BODY:g}" fill="currentColor" opacity="0.3"/>',
        f'<path class="forward" d="M{middle:g} {nose - 14:g}l8 13h-16z" fill="currentColor"/>',
    )


def _rotor(number: int, point: tuple[float, float], radius: float, place: Place, mark: RotorMark, prefix: str) -> str:
    """The group of one rotor."""
    (x, y), ink = point, text_colour(mark.fill)
    inside = radius >= LABEL_FROM
    height = min(20.0, 0.8 * radius)
    number_y = y + 0.36 * height - (0.3 * height if mark.label and inside else 0.0)
    label_y = y + 0.75 * height if inside else y + radius + 10.0
    label = (
        f'<text class="rotor-label" x="{x:.1f}" y="{label_y:.1f}" text-anchor="middle" '
        f'font-size="{min(11.0, 0.34 * radius) if inside else 9:.1f}" '
        f'fill="{ink if inside else "currentColor"}">{_text(mark.label)}</text>'
    )
    classes = f"rotor {mark.kind}".strip()
    return "".join(
        (
            f'<g id={quoteattr(f"{prefix}-rotor-{number}")} class={quoteattr(classes)} data-rotor="{number}">',
            f'<circle class="rotor-disc" cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" '
            f'fill={quoteattr(mark.fill or "none")} stroke="currentColor" stroke-width="1.5"/>',
            _spin(point, 0.84 * radius, place, ink),
            f'<text class="rotor-number" x="{x:.1f}" y="{number_y:.1f}" text-anchor="middle" '
            f'font-size="{height:.1f}" font-weight="600" fill="{ink}">{number}</text>',
            label,
            "</g>",
        )
    )


def _spin(centre: tuple[float, float], radius: float, place: Place, ink: str) -> str:
    """An arc with an arrow head that shows the sense of rotation, seen from above; an SVG angle grows clockwise."""
    turn = 1.0 if place.spin == "cw" else -1.0
    start, end = math.radians(-90.0 - 50.0 * turn), math.radians(-90.0 + 50.0 * turn)
    (cx, cy), head = centre, 0.24 * radius
    x0, y0 = cx + radius * math.cos(start), cy + radius * math.sin(start)
    x1, y1 = cx + radius * math.cos(end), cy + radius * math.sin(end)
    along = end + turn * math.pi / 2
    wings = [
        (x1 + head * math.cos(along + math.pi + one), y1 + head * math.sin(along + math.pi + one))
        for one in (0.55, -0.55)
    ]
    return (
        f'<path class="rotor-spin" d="M{x0:.1f} {y0:.1f}A{radius:.1f} {radius:.1f} 0 0 {int(turn > 0)} {x1:.1f} '
        f'{y1:.1f}M{wings[0][0]:.1f} {wings[0][1]:.1f}L{x1:.1f} {y1:.1f}L{wings[1][0]:.1f} {wings[1][1]:.1f}" '
        f'fill="none" stroke="{ink}" stroke-width="1.8" stroke-linecap="round"/>'
    )
