"""The drawing of an airframe: the right rotors at the right places, well-formed, and no text can break out of it."""

import math
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.airframe.layout import LAYOUTS, Place, RotorLayout, layout_at, layout_named
from mavdiag.report.drawing import SIZE, RotorMark, airframe_svg

SVG = "{http://www.w3.org/2000/svg}"
COAXIAL = layout_at("y6", [Place(x, y, spin) for x, y in ((1, 1), (1, -1), (-1, 0)) for spin in ("cw", "ccw")])


def discs(svg: str) -> dict[int, tuple[float, float, float]]:
    """Centre and radius of each rotor, by its number."""
    found = {}
    for group in ElementTree.fromstring(svg).iter(f"{SVG}g"):
        if "data-rotor" in group.attrib:
            disc = disc_of(group)
            place = float(disc["cx"]), float(disc["cy"]), float(disc["r"])
            found[int(group.attrib["data-rotor"])] = place
    return found


def disc_of(group: ElementTree.Element) -> dict[str, str]:
    disc = group.find(f"{SVG}circle")
    assert disc is not None
    return disc.attrib


@pytest.mark.parametrize("layout", [*LAYOUTS.values(), COAXIAL], ids=lambda layout: layout.name)
def test_every_rotor_is_within_the_picture_and_touches_no_other_one(layout: RotorLayout) -> None:
    found = discs(airframe_svg(layout))
    assert sorted(found) == list(range(1, layout.rotors + 1))
    for number, (x, y, radius) in found.items():
        assert radius > 8
        assert all(radius <= at <= SIZE - radius for at in (x, y))
        assert all(math.dist((x, y), one[:2]) > 2 * radius for other, one in found.items() if other != number)


def test_the_rotors_are_where_the_vehicle_has_them_and_turn_as_it_says() -> None:
    """T Eq 2.2-2.4: 1 rear right, 2 front right, 3 rear left, 4 front left; the nose is up. ArduPilot's quad X."""
    found = discs(airframe_svg(layout_named("qdrone2")))
    sides = {number: (y < SIZE / 2, x > SIZE / 2) for number, (x, y, _) in found.items()}
    assert sides == {1: (False, True), 2: (True, True), 3: (False, False), 4: (True, False)}
    text = airframe_svg(layout_named("x"))
    assert "rotor 1 front right, turns counter-clockwise" in text
    assert "rotor 3 front left, turns clockwise" in text


@given(st.text(), st.text())
def test_no_text_breaks_out(title: str, label: str) -> None:
    layout = layout_named("x")
    hostile = RotorMark(label=f"{label}</text><script>1</script>", kind='"><script>')
    text = airframe_svg(layout, {1: hostile}, title=f"<{title}")
    root = ElementTree.fromstring(text)
    assert {one.tag.removeprefix(SVG) for one in root.iter()} == {
        one.tag.removeprefix(SVG) for one in ElementTree.fromstring(airframe_svg(layout)).iter()
    }
    assert "style=" not in airframe_svg(layout)
