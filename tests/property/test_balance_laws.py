"""Laws of the balance quality grades and of the sum of unbalances."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.airframe.balance import Grade, Piece, assess_unbalance, resultant_unbalance_g_mm

sizes = st.floats(1e-3, 1e3)
speeds = st.floats(100.0, 1e5)
pieces = st.lists(st.builds(Piece, st.floats(0, 10), st.floats(0, 100), st.floats(-360, 360)), max_size=6)


@given(unbalance=st.floats(0, 1e4), rotor=sizes, speed=speeds, grade=st.sampled_from(Grade))
def test_within_means_that_the_grade_met_is_at_least_as_fine(
    unbalance: float, rotor: float, speed: float, grade: Grade
) -> None:
    report = assess_unbalance(unbalance, rotor_mass_g=rotor, speed_rpm=speed, grade=grade)
    assert report.within == (report.met is not None and report.met.mm_s <= grade.mm_s)
    assert report.ratio == pytest.approx(report.unbalance_g_mm / report.permissible_g_mm, rel=1e-9)
    assert report.ratio == pytest.approx(report.specific_um / report.permissible_um, rel=1e-9)


@given(unbalance=st.floats(1e-3, 1e3), rotor=sizes, speed=st.floats(100.0, 4e4))
def test_a_faster_rotor_never_meets_a_finer_grade(unbalance: float, rotor: float, speed: float) -> None:
    slow = assess_unbalance(unbalance, rotor_mass_g=rotor, speed_rpm=speed).met
    fast = assess_unbalance(unbalance, rotor_mass_g=rotor, speed_rpm=2 * speed).met
    assert fast is None or (slow is not None and slow.mm_s <= fast.mm_s)


@given(some=pieces, turn=st.floats(-360, 360))
def test_turning_the_whole_rotor_changes_nothing(some: list[Piece], turn: float) -> None:
    turned = [Piece(one.mass_g, one.radius_mm, one.angle_deg + turn) for one in some]
    total = sum(one.unbalance_g_mm for one in some)
    assert resultant_unbalance_g_mm(turned) == pytest.approx(resultant_unbalance_g_mm(some), abs=1e-9 * (1 + total))
    assert resultant_unbalance_g_mm(some) <= total * (1 + 1e-12)
