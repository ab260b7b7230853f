"""Any cut of the rows gives exactly the same bins of conditions, and the same limits by them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from made_conditions import made_block, measured, rows_of, spoilt

from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import IntArray
from mavdiag.thresholds.envelope import Covered, Dependence, Envelope, Outside

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


def judged(envelope: Envelope, rows: list[Rows]) -> tuple[list[IntArray], dict[Condition, Outside]]:
    """What the envelope makes of a statistic of ones at each row and at each rate, and what it does not judge."""
    state, parts, denied = envelope.start(), [], dict[Condition, Outside]()
    for one in rows:
        state = envelope.step(state, one)
        for number, t_ns in enumerate((one.block.t_ns, one.rates.t_ns)):
            ones = np.ones(len(t_ns))
            told = Statistic(t_ns, one.block.dt_s, ones, ones > 0, ones, ones, np.empty((0, 0)))
            found, outside = envelope.apply(number, told, state)
            parts.append((number, found.t_ns, found.value, found.valid))
            for condition, beside in outside.items():
                denied[condition] = denied[condition].plus(beside) if condition in denied else beside
    joined = [np.concatenate([p[i] for p in parts if p[0] == number]) for number in (0, 1) for i in (1, 2, 3)]
    return joined, denied


@settings(max_examples=60)
@given(seed=st.integers(0, 50), edges=cuts, dt_s=st.sampled_from(PERIODS_S), memory_s=st.sampled_from([0.5, 1.0, 5.0]))
def test_any_cut_gives_the_same_limits(seed: int, edges: list[int], dt_s: float, memory_s: float) -> None:
    """The factor near the envelope, what is outside, and for how long."""
    slots = tuple(Dependence(frozenset(conditions), memory_s) for conditions in (Condition, [Condition.YAW_RATE]))
    envelope, block = Envelope(NARROW, slots, 2 * dt_s), made_block(N, dt_s, seed)
    expected, found = judged(envelope, rows_of(block)), judged(envelope, rows_of(block, edges))
    for one, other in zip(found[0], expected[0], strict=True):
        np.testing.assert_array_equal(one, other)
    assert found[1].keys() == expected[1].keys()
    for condition, outside in expected[1].items():
        np.testing.assert_allclose(found[1][condition].span_s, outside.span_s)
        assert (found[1][condition].value, found[1][condition].excess) == (outside.value, outside.excess)
    assert expected[1], "some of it must be outside"
