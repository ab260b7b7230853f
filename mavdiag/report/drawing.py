"""The drawing of an airframe as SVG, seen from above with its nose up. Black, but for what a page colours by classes.

The SVG holds no style attribute and no script: a page may restyle it by its classes and ids, and a strict
Content-Security-Policy lets it pass. Its elements are in drawing.svg, a template.
"""

import math
from collections.abc import Mapping

from mavdiag.airframe.layout import Place, RotorLayout
from mavdiag.report.chart import template

SIZE = 240.0  # of the viewBox
REACH = 76.0  # from its centre to the outermost rotor's centre
RADIUS_MOST = 38.0  # of a rotor, so that all of it stays within the viewBox
SHARE = 0.44  # of the distance between two rotors that a radius takes: neighbours do not touch
APART = 0.75  # how far rotors of one place are drawn apart, of the vehicle's reach (our choice)
BODY = 19.0  # radius of the body
LABEL_FROM = 20.0  # radius of a rotor from which on its label fits into it; else it stands below


def rotor_places(layout: RotorLayout) -> tuple[Place, ...]:
    """Where the rotors are, the outermost one 1 from the centre; those of one place are set apart along the circle."""
    reach, places = max(math.hypot(roll, pitch) for roll, pitch, _ in layout.signs), dict[int, Place]()
    for arm in layout.arms:
        for number, rotor in enumerate(arm.members):
            roll, pitch, yaw = layout.signs[rotor - 1]
            x, y, far = pitch / reach, -roll / reach, math.hypot(roll, pitch) / reach
            across_x, across_y = (-y / far, x / far) if far > 0 else (0.0, 1.0)
            along = APART * (number - 0.5 * (len(arm.members) - 1))
            places[rotor] = Place(x + along * across_x, y + along * across_y, "ccw" if yaw > 0 else "cw")
    return tuple(places[rotor] for rotor in sorted(places))


def where(place: Place) -> str:
    """A rotor's place in words.

    >>> where(Place(0.7, -0.7, "cw")), where(Place(0.0, 0.0, "cw"))
    ('front left', 'centre')
    """
    length = math.hypot(place.x_m, place.y_m)
    along = "front" if place.x_m > 0.2 * length else "rear" if place.x_m < -0.2 * length else ""
    across = "right" if place.y_m > 0.2 * length else "left" if place.y_m < -0.2 * length else ""
    return f"{along} {across}".strip() or "centre"


def airframe_svg(layout: RotorLayout, marks: Mapping[int, tuple[str, str]] | None = None, *, title: str = "") -> str:
    """Draw an `<svg>` element that can stand in a page or in a file; `airframe-rotor-3` is the group of rotor 3.

    marks: by a rotor's number from 1 a short text in its disc, and a further class of its group. title: its accessible
    name; without it, the layout's name.
    """
    places, marks, middle = rotor_places(layout), marks or {}, SIZE / 2
    points = [(middle + REACH * place.y_m, middle - REACH * place.x_m) for place in places]
    gaps = [SHARE * math.dist(a, b) for i, a in enumerate(points) for b in points[:i]]
    radius = min([RADIUS_MOST, *gaps])  # the largest with which none touches another one
    inside, height = radius >= LABEL_FROM, min(20.0, 0.8 * radius)
    rotors = []
    for number, ((x, y), place) in enumerate(zip(points, places, strict=True), start=1):
        label, kind = marks.get(number, ("", ""))
        share = max(0.0, 1.0 - radius / max(radius, math.dist((x, y), (middle, middle))))  # of the arm, to the rim
        rotors.append(
            {
                "number": number,
                "x": round(x, 1),
                "y": round(y, 1),
                "arm": (round(middle + share * (x - middle), 1), round(middle + share * (y - middle), 1)),
                "spin": place.spin,
                "label": label,
                "kind": kind,
                "number_y": round(y + 0.36 * height - (0.3 * height if label and inside else 0.0), 1),
                "label_y": round(y + 0.75 * height if inside else y + radius + 10.0, 1),
            }
        )
    words = (f"{where(one)}, turns {'' if one.spin == 'cw' else 'counter-'}clockwise" for one in places)
    return template("drawing.svg").render(
        size=f"{SIZE:g}",
        middle=middle,
        body=BODY,
        title=title or f"airframe {layout.name}",
        words="; ".join(f"rotor {number} {text}" for number, text in enumerate(words, start=1)),
        rotors=rotors,
        radius=round(radius, 1),
        reach=round(0.84 * radius, 1),
        inside=inside,
        height=round(height, 1),
        label_height=round(min(11.0, 0.34 * radius) if inside else 9.0, 1),
    )
