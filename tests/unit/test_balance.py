"""ISO 1940-1 against its own definition, its laws, the thesis's worked example, and its tables recomputed."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.airframe.balance import (
    Grade,
    assess_unbalance,
    grade_named,
    permissible_unbalance_g_mm,
    unbalance_g_mm,
)
from mavdiag.airframe.propellers import PROPELLERS, DamagedPropeller
from mavdiag.errors import UsageError

ROTOR_G, SPEED_RPM = 30.0, 10_000.0  # T 3.2.2
HEALTHY_MASS_G = 7.198  # T Table 3.2, two of three; the third weighs 7.197 g
SIZES = st.floats(1e-3, 1e3)


def test_the_worked_example_of_the_thesis() -> None:
    report = assess_unbalance(0.22, rotor_mass_g=ROTOR_G, speed_rpm=SPEED_RPM)
    assert report.permissible_um == pytest.approx(6.0, abs=0.05)
    assert permissible_unbalance_g_mm(Grade.G6_3, SPEED_RPM, ROTOR_G) == pytest.approx(0.18, abs=0.001)
    slow = assess_unbalance(1.0, rotor_mass_g=ROTOR_G, speed_rpm=1.0, grade=Grade.G1)
    assert round(slow.permissible_um) == 9549  # and not 9594


def test_the_grades_of_the_standard() -> None:
    assert [grade.mm_s for grade in Grade] == [4000, 1600, 630, 250, 100, 40, 16, 6.3, 2.5, 1, 0.4]
    assert [grade_named(str(grade).lower()) for grade in Grade] == list(Grade)
    for text in ("", "G", "G7", "best", "-6.3", "nan"):
        with pytest.raises(UsageError, match=r"G4000, .* G0\.4"):
            grade_named(text)


def test_a_report_says_what_was_asked_and_what_is_met() -> None:
    report = assess_unbalance(unbalance_g_mm(0.085, 60.0), rotor_mass_g=ROTOR_G, speed_rpm=SPEED_RPM)
    assert (report.within, report.grade, report.met) == (False, Grade.G6_3, Grade.G250)
    assert report.ratio == pytest.approx(5.1 / 0.18048, rel=1e-4)
    assert report.specific_um == pytest.approx(170.0)
    assert report.level_mm_s == pytest.approx(178.02, abs=0.01)
    assert report.force_n == pytest.approx(0.085e-3 * 0.060 * (SPEED_RPM * math.pi / 30) ** 2)
    assert report.sentence == "5.1 g mm exceeds G6.3: 28.26 x the permissible 0.18 g mm, meets G250"
    huge = assess_unbalance(1e6, rotor_mass_g=ROTOR_G, speed_rpm=SPEED_RPM)
    assert (huge.met, huge.sentence.endswith("beyond G4000")) == (None, True)
    assert assess_unbalance(0.0, rotor_mass_g=1.0, speed_rpm=1.0).met is Grade.G0_4


@given(unbalance=st.floats(0, 1e4), rotor=SIZES, speed=st.floats(100.0, 1e5), grade=st.sampled_from(Grade))
def test_laws(unbalance: float, rotor: float, speed: float, grade: Grade) -> None:
    report = assess_unbalance(unbalance, rotor_mass_g=rotor, speed_rpm=speed, grade=grade)
    assert report.within == (report.met is not None and report.met.mm_s <= grade.mm_s)
    assert report.ratio == pytest.approx(report.unbalance_g_mm / report.permissible_g_mm, rel=1e-9)
    assert report.ratio == pytest.approx(report.specific_um / report.permissible_um, rel=1e-9)
    assert report.permissible_g_mm == pytest.approx(1e3 * grade.mm_s * rotor / (2e3 * math.pi * speed / 60), rel=1e-12)
    faster = assess_unbalance(unbalance, rotor_mass_g=rotor, speed_rpm=2 * speed).met
    assert faster is None or (report.met is not None and report.met.mm_s <= faster.mm_s)
    assert assess_unbalance(report.permissible_g_mm, rotor_mass_g=rotor, speed_rpm=speed, grade=grade).within


@pytest.mark.parametrize("bad", [-1.0, math.nan, math.inf])
def test_nonsense_is_refused_by_name(bad: float) -> None:
    for call, words in (
        (lambda: unbalance_g_mm(bad, 1.0), "mass must be"),
        (lambda: unbalance_g_mm(1.0, bad), "radius must be"),
        (lambda: assess_unbalance(bad, rotor_mass_g=ROTOR_G, speed_rpm=SPEED_RPM), "unbalance must be"),
        (lambda: assess_unbalance(1.0, rotor_mass_g=bad, speed_rpm=1.0), "rotor mass must be"),
        (lambda: assess_unbalance(1.0, rotor_mass_g=30.0, speed_rpm=bad), "speed must be"),
        (lambda: assess_unbalance(1e300, rotor_mass_g=1e-300, speed_rpm=1.0), "units"),
    ):
        with pytest.raises(UsageError, match=words):
            call()


@pytest.mark.parametrize("found", PROPELLERS, ids=[row.code for row in PROPELLERS])
def test_table_3_2_recomputed(found: DamagedPropeller) -> None:
    assert found.mass_g + found.lost_g == pytest.approx(HEALTHY_MASS_G, abs=1e-9)
    # The split masses are rounded to a milligram.
    assert len(found.radii_mm) * found.each_g == pytest.approx(found.lost_g, abs=0.00101)
    if found.code == "F2/SV3":
        assert (round(found.unbalance_g_mm, 3), found.printed_g_mm) == (2.970, 2.640)
    else:
        assert found.unbalance_g_mm == pytest.approx(found.printed_g_mm, abs=1e-9)
