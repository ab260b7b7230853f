"""Conditions of flight: each by its definition, on fast and slow links, with unknown signals and gaps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_conditions import Ones, column, made_block, measured, ones_judged, rows_of, slowly, spoilt

from mavdiag.rows.conditions import Condition
from mavdiag.testing import example_rows
from mavdiag.thresholds.envelope import Covered

RATES_HZ = (10, 12.5, 20, 33, 50, 100, 400, 1000)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("broken", [False, True])
def test_every_condition_is_what_its_definition_says(rate_hz: float, broken: bool) -> None:
    block = made_block(round(9 * rate_hz), 1 / rate_hz, seed=round(rate_hz))
    block = spoilt(block, seed=3) if broken else block
    found, (ends, expected) = measured(rows_of(block)), slowly(block)
    assert found.end_ns.tolist() == ends
    assert len(ends) > 70
    for condition in Condition:
        values = column(found, condition)
        np.testing.assert_allclose(values, expected[condition], rtol=1e-9, atol=1e-12, err_msg=condition)
        assert np.isfinite(values).any(), condition


def test_after_a_step_of_the_heading_the_gyro_tells_for_two_seconds() -> None:
    step = np.zeros((800, 3))
    step[405:, 2] = 1.5  # 15 rad/s in the bin that ends at 4.1 s
    block = example_rows(800, 0.01, setpoint=step, rate=np.tile([0.0, 0.0, -0.8], (800, 1))).block
    found = column(measured(rows_of(block)), Condition.YAW_RATE)
    np.testing.assert_allclose(found[40:60], 0.8)
    np.testing.assert_array_equal(found[60:], 0.0)
    np.testing.assert_array_equal(found[1:40], 0.0)


N = 900
PERIODS_S = (0.0025, 0.01, 0.02, 0.05, 0.1)
NARROW = tuple(
    Covered(condition, low, high)
    for condition, low, high in (
        (Condition.TILT, 0.0, 0.05),
        (Condition.THROTTLE, 0.49, 0.51),
        (Condition.COMMANDED_RATE, 0.0, 0.3),
        (Condition.YAW_RATE, 0.0, 0.2),
        (Condition.HEIGHT, 1.0, 2.0),
    )
)

cuts = st.lists(st.integers(1, N - 1), max_size=40)


@given(seed=st.integers(0, 50), edges=cuts, dt_s=st.sampled_from(PERIODS_S), broken=st.booleans())
def test_any_cut_gives_exactly_the_same_bins(seed: int, edges: list[int], dt_s: float, broken: bool) -> None:
    block = made_block(N, dt_s, seed)
    block = spoilt(block, seed) if broken else block
    expected, found = measured(rows_of(block)), measured(rows_of(block, edges))
    assert len(expected.end_ns) > 10
    np.testing.assert_array_equal(found.end_ns, expected.end_ns)
    np.testing.assert_array_equal(found.values, expected.values)


@settings(max_examples=60)
@given(seed=st.integers(0, 50), edges=cuts, dt_s=st.sampled_from(PERIODS_S), memory_s=st.sampled_from([0.5, 1.0, 5.0]))
def test_any_cut_gives_the_same_limits(seed: int, edges: list[int], dt_s: float, memory_s: float) -> None:
    """The factor near the envelope, what is outside, and for how long."""
    block = made_block(N, dt_s, seed)
    for conditions in (set(Condition), {Condition.YAW_RATE}):
        monitor = Ones(conditions, memory_s)
        (expected, outside), (found, other) = (ones_judged(NARROW, rows_of(block, cut), monitor) for cut in ([], edges))
        for name in ("t_ns", "value", "valid"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
        assert other == outside
    assert ones_judged(NARROW, rows_of(block), Ones(Condition, memory_s))[1], "some of it must be outside"
