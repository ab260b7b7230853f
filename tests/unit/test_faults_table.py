"""The fault table against the thesis's tables, and its codes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.errors import UsageError
from sitl_plant.physics.faults import FAULTS, parse_fault

# T Table 3.2: removed masses [g] and distances [mm] as its own sums write them, and the printed result [g mm].
PRINTED = {
    "F1/SV1": ([(0.035, 40)], 1.400),
    "F1/SV2": ([(0.085, 60)], 5.100),
    "F1/SV3": ([(0.048, 65), (0.048, 50)], 5.520),
    "F2/SV1": ([(0.004, 55)], 0.220),
    "F2/SV2": ([(0.025, 40), (0.025, 70)], 2.750),
    "F2/SV3": ([(0.018, 70), (0.018, 55), (0.018, 40)], 2.640),
    "F3/SV1": ([(0.058, 65)], 3.770),
    "F3/SV2": ([(0.034, 65), (0.034, 50)], 3.910),
    "F3/SV3": ([(0.033, 65), (0.033, 50), (0.033, 35)], 4.950),
}


@pytest.mark.parametrize("code", PRINTED)
def test_unbalance_is_what_the_thesis_prints(code: str) -> None:
    parts, printed = PRINTED[code]
    assert parse_fault(code).propeller.printed_g_mm == pytest.approx(printed)
    if code != "F2/SV3":  # the slip: its sum gives 2.970
        assert sum(mass * distance for mass, distance in parts) == pytest.approx(printed, abs=1e-9)
    else:
        assert sum(mass * distance for mass, distance in parts) == pytest.approx(2.970)


def test_all_nine_faults_exceed_the_balance_limit() -> None:
    """T 3.2.2: every fault is beyond the 0.18 g mm of G 6.3."""
    assert len(FAULTS) == 9
    assert [fault.code for fault in FAULTS] == list(PRINTED)
    assert all(fault.propeller.printed_g_mm > 0.18 for fault in FAULTS)


def test_phenomenology_scales_only_the_fitted_terms() -> None:
    fault = parse_fault("F2/SV3")
    full, half, none = fault.damage(1.0), fault.damage(0.5), fault.damage(0.0)
    assert (none.fluctuation_rms, none.thrust_lag_s) == (0.0, 0.0)
    assert half.fluctuation_rms == pytest.approx(full.fluctuation_rms / 2)
    assert half.thrust_lag_s == pytest.approx(full.thrust_lag_s / 2)
    for damage in (full, half, none):
        assert damage.unbalance_g_mm == 2.64
        assert damage.thrust_factor == pytest.approx(0.988)
        assert damage.drag_factor == pytest.approx(1.03)
    for wrong in (-0.1, 1.1, float("nan")):
        with pytest.raises(UsageError, match="phenomenology"):
            fault.damage(wrong)


@pytest.mark.parametrize("code", ["F2/SV2", "f2/sv2", " F2-SV2 ", "F2\\SV2", "F2SV2"])
def test_codes_are_read_in_the_ways_people_write_them(code: str) -> None:
    assert parse_fault(code).code == "F2/SV2"


@given(st.text(max_size=12))
def test_other_text_is_refused_in_one_line(text: str) -> None:
    message = "F2/SV2"
    try:
        assert parse_fault(text) in FAULTS
    except UsageError as error:
        message = str(error)
    assert "F2/SV2" in message
    assert "\n" not in message
