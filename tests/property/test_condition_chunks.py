"""Any cut of the rows gives exactly the same bins of conditions, and the same limits by them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from made_conditions import Ones, made_block, measured, ones_judged, rows_of, spoilt

from mavdiag.rows.conditions import Condition
from mavdiag.thresholds.envelope import Covered

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
