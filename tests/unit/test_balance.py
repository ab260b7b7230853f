"""ISO 1940-1 against its own definition, the thesis's worked example, and its tables recomputed."""

import math

import pytest

from mavdiag.airframe.balance import (
    Grade,
    Piece,
    assess_unbalance,
    grade_named,
    permissible_specific_um,
    permissible_unbalance_g_mm,
    resultant_unbalance_g_mm,
    unbalance_force_n,
)
from mavdiag.airframe.propellers import (
    PROPELLERS,
    DamagedPropeller,
    FaultType,
    propeller,
)
from mavdiag.errors import UsageError

ROTOR_G, SPEED_RPM = 30.0, 10_000.0  # T 3.2.2
HEALTHY_MASS_G = 7.198  # T Table 3.2, two of three; the third weighs 7.197 g
WEIGHING_ERROR_G = 0.0005  # T 3.2.2: half of the last digit of the scales


def test_the_worked_example_of_the_thesis() -> None:
    assert permissible_specific_um(Grade.G6_3, SPEED_RPM) == pytest.approx(6.0, abs=0.05)
    assert permissible_unbalance_g_mm(Grade.G6_3, SPEED_RPM, ROTOR_G) == pytest.approx(0.18, abs=0.001)


def test_the_constant_is_9549_and_not_9594() -> None:
    assert round(permissible_specific_um(Grade.G1, 1.0)) == 9549


@pytest.mark.parametrize("grade", Grade)
def test_both_forms_of_the_permissible_unbalance_agree(grade: Grade) -> None:
    omega = 2 * math.pi * 7_300 / 60
    expected_kg_m = grade.mm_s * 1e-3 * 0.042 / omega  # T Eq 3.2 in SI
    assert permissible_unbalance_g_mm(grade, 7_300, 42.0) == pytest.approx(expected_kg_m * 1e6, rel=1e-12)


def test_the_grades_of_the_standard() -> None:
    assert [grade.mm_s for grade in Grade] == [4000, 1600, 630, 250, 100, 40, 16, 6.3, 2.5, 1, 0.4]
    assert [grade_named(str(grade).lower()) for grade in Grade] == list(Grade)


@pytest.mark.parametrize("text", ["", "G", "G7", "best", "-6.3", "nan"])
def test_an_unknown_grade_is_refused_with_the_choice(text: str) -> None:
    with pytest.raises(UsageError, match=r"G4000, .* G0\.4"):
        grade_named(text)


def test_a_report_says_what_was_asked_and_what_is_met() -> None:
    report = assess_unbalance(Piece(0.085, 60.0).unbalance_g_mm, rotor_mass_g=ROTOR_G, speed_rpm=SPEED_RPM)
    assert not report.within
    assert (report.grade, report.met) == (Grade.G6_3, Grade.G250)
    assert report.ratio == pytest.approx(5.1 / 0.18048, rel=1e-4)
    assert report.specific_um == pytest.approx(170.0)
    assert report.level_mm_s == pytest.approx(178.02, abs=0.01)
    assert report.force_n == pytest.approx(0.085e-3 * 0.060 * (SPEED_RPM * math.pi / 30) ** 2)
    assert report.sentence == "5.1 g mm exceeds G6.3: 28.26 x the permissible 0.18 g mm, meets G250"


def test_the_limit_itself_is_within() -> None:
    limit = permissible_unbalance_g_mm(Grade.G2_5, 6_000, 17.0)
    report = assess_unbalance(limit, rotor_mass_g=17.0, speed_rpm=6_000, grade=Grade.G2_5)
    assert report.within
    assert report.met is Grade.G2_5
    assert "within G2.5" in report.sentence


def test_no_unbalance_meets_the_finest_grade_and_a_huge_one_none() -> None:
    assert assess_unbalance(0.0, rotor_mass_g=1.0, speed_rpm=1.0).met is Grade.G0_4
    huge = assess_unbalance(1e6, rotor_mass_g=30.0, speed_rpm=SPEED_RPM)
    assert huge.met is None
    assert huge.sentence.endswith("beyond G4000")


@pytest.mark.parametrize("bad", [-1.0, math.nan, math.inf])
def test_nonsense_is_refused_by_name(bad: float) -> None:
    with pytest.raises(UsageError, match="mass must be"):
        Piece(bad, 1.0)
    with pytest.raises(UsageError, match="radius must be"):
        Piece(1.0, bad)
    with pytest.raises(UsageError, match="unbalance must be"):
        unbalance_force_n(bad, SPEED_RPM)
    with pytest.raises(UsageError, match="rotor mass must be"):
        permissible_unbalance_g_mm(Grade.G1, SPEED_RPM, bad)
    with pytest.raises(UsageError, match="speed must be"):
        permissible_specific_um(Grade.G1, bad)


def test_zero_speed_zero_rotor_and_absurd_numbers_are_refused() -> None:
    for speed_rpm in (0.0, 2e6):
        with pytest.raises(UsageError, match="speed"):
            assess_unbalance(1.0, rotor_mass_g=30.0, speed_rpm=speed_rpm)
    with pytest.raises(UsageError, match="rotor mass"):
        assess_unbalance(1.0, rotor_mass_g=0.0, speed_rpm=1.0)
    with pytest.raises(UsageError, match="units"):
        assess_unbalance(1e300, rotor_mass_g=1e-300, speed_rpm=1.0)
    with pytest.raises(UsageError, match="angle"):
        Piece(1.0, 1.0, math.inf)


@pytest.mark.parametrize("found", PROPELLERS, ids=[row.code for row in PROPELLERS])
def test_table_3_2_recomputed(found: DamagedPropeller) -> None:
    assert found.mass_g + found.lost_g == pytest.approx(HEALTHY_MASS_G, abs=1e-9)
    # The split masses are rounded to a milligram.
    assert len(found.radii_mm) * found.each_g == pytest.approx(found.lost_g, abs=0.00101)
    if found.code == "F2/SV3":
        assert (round(found.unbalance_g_mm, 3), found.printed_g_mm) == (2.970, 2.640)
    else:
        assert found.unbalance_g_mm == pytest.approx(found.printed_g_mm, abs=1e-9)


def test_every_fault_exceeds_g6_3_but_the_small_crack_only_just() -> None:
    ratios = {
        row.code: assess_unbalance(row.unbalance_g_mm, rotor_mass_g=ROTOR_G, speed_rpm=SPEED_RPM).ratio
        for row in PROPELLERS
    }
    assert min(ratios.values()) == ratios["F2/SV1"] == pytest.approx(1.22, abs=0.01)
    smallest = propeller(FaultType.CRACK, 1)
    permissible = permissible_unbalance_g_mm(Grade.G6_3, SPEED_RPM, ROTOR_G)
    error = 2 * WEIGHING_ERROR_G * smallest.radii_mm[0]  # of two weighings
    assert smallest.unbalance_g_mm - error < permissible  # T Eq 3.6 cannot be sure of it


def test_a_row_that_is_not_there_is_refused() -> None:
    with pytest.raises(UsageError, match="severity"):
        propeller(FaultType.CRACK, 4)


def test_pieces_on_opposite_sides_cancel() -> None:
    assert resultant_unbalance_g_mm([]) == 0.0
    triangle = [Piece(0.1, 50.0, angle) for angle in (10.0, 130.0, 250.0)]
    assert resultant_unbalance_g_mm(triangle) == pytest.approx(0.0, abs=1e-12)
    right_angle = [Piece(0.3, 10.0, 0.0), Piece(0.4, 10.0, 90.0)]
    assert resultant_unbalance_g_mm(right_angle) == pytest.approx(5.0)
