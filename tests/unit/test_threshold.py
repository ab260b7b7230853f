"""Thresholds: known values, guards, refusals, folds that never see what they score."""

import itertools
import math

import numpy as np
import pytest
from made_rows import example_context
from made_thresholds import calibrated, held_out_scores

from mavdiag.errors import IdentificationError, UsageError
from mavdiag.monitors.vibration_level import VibrationLevel, VibrationLevelSpec
from mavdiag.rows.front import Rows
from mavdiag.testing import example_rows
from mavdiag.thresholds.heldout import Flights, Scores, score
from mavdiag.thresholds.rule import DEGREES, USUAL, Prior, Threshold, threshold_of


def shaken(level: float, seconds: float = 30.0, segment: int = 0, seed: int = 1) -> list[Rows]:
    n = round(seconds * 100)
    vibration = np.random.default_rng(seed).normal([0.0, 0.0, level], 0.1, (n, 3))
    return [example_rows(n, 0.01, segment=segment, vibration=np.abs(vibration))]


def whole(maxima: list[float], flights: list[int] | None = None) -> Scores:
    """Blocks of 10 s, of one flight or of these."""
    return Scores(np.array(maxima), np.full(len(maxima), 10.0), np.array(flights or [0] * len(maxima)))


def known(maxima: list[float], flights: list[int], sessions: list[int], prior: Prior = USUAL) -> Threshold:
    return threshold_of(whole(maxima, flights), sessions=sessions, budget_per_hour=0.36, prior=prior)


def test_the_components_of_variance_are_those_of_a_balanced_design() -> None:
    """By hand: two sessions of two flights of two blocks each."""
    prior = Prior(0.3, 0.2, 0.1, shares=False)
    found = known([1.0, 3.0, 2.0, 4.0, 7.0, 9.0, 8.0, 10.0], [0, 0, 1, 1, 2, 2, 3, 3], [0, 0, 1, 1], prior)
    block = (DEGREES * 0.1**2 + 4 * 2.0) / (DEGREES + 4)  # each flight's blocks differ by 2 from each other
    flight = (DEGREES * 0.2**2 + 2 * 0.5) / (DEGREES + 2)  # flight means 2, 3 and 8, 9
    session = (DEGREES * 0.3**2 + max(18.0 - flight / 2, 0.0)) / (DEGREES + 1)  # session means 2.5 and 8.5
    assert found.mean == pytest.approx(5.5)
    assert found.block_scale == pytest.approx(math.sqrt(6 * block) / math.pi)
    assert found.flight_sd == pytest.approx(math.sqrt(flight))
    assert found.session_sd == pytest.approx(math.sqrt(session))
    assert (found.blocks, found.flights, found.sessions) == (8, 4, 2)
    assert found.demonstrated_per_hour == pytest.approx(3.0 * 45, rel=0.01)  # 3/T for T = 80 s


def test_with_one_flight_the_prior_stands_and_with_many_the_data() -> None:
    prior = Prior(1.0, 0.5, 0.1, shares=False)
    one = known([5.0], [0], [0], prior)
    assert (one.session_sd, one.flight_sd) == pytest.approx((1.0, 0.5))
    rng = np.random.default_rng(7)
    levels = 5.0 + 0.1 * rng.standard_normal(300)  # of 300 sessions of 1 flight: sd 0.1 where 1.0 was believed
    many = known(np.repeat(levels, 2).tolist(), np.repeat(np.arange(300), 2).tolist(), list(range(300)), prior)
    assert many.session_sd < 0.2
    assert many.value < one.value


def test_shares_are_of_the_mean_and_no_threshold_is_below_the_least() -> None:
    assert known([4.0], [0], [0], Prior(session=0.5)).session_sd == pytest.approx(2.0)
    assert known([0.01, 0.01], [0, 0], [0], Prior(least=2.0)).value == 2.0


def test_a_flight_of_the_same_session_has_a_lower_threshold() -> None:
    found = known([1.0, 1.1, 0.9, 1.0], [0, 1, 2, 3], [0, 0, 0, 0], Prior(session=0.5))
    assert found.within(same_session=True) < found.within(same_session=False) == found.value
    assert "from 4 flights in 1 session" in found.statement()


@pytest.mark.parametrize("budget", [0.0, -1.0, math.nan, math.inf])
def test_a_budget_must_be_positive(budget: float) -> None:
    with pytest.raises(UsageError, match="budget"):
        threshold_of(whole([1.0]), sessions=[0], budget_per_hour=budget)


@pytest.mark.parametrize("maxima", [[], [math.nan], [math.inf, 1.0]])
def test_broken_scores_are_refused(maxima: list[float]) -> None:
    with pytest.raises(IdentificationError, match="finite"):
        threshold_of(whole(maxima), sessions=[0])


@pytest.mark.parametrize(
    ("seconds", "blocks"),
    [(6.0, 1), (10.0, 1), (14.0, 1), (16.0, 2), (20.0, 2), (33.0, 3)],  # a remainder counts from half a block on
)
def test_b5_blocks_are_of_judged_time(seconds: float, blocks: int) -> None:
    """B5: the warm-up counted as judged time."""
    warm_up_s = 4.99
    found = score(VibrationLevel(VibrationLevelSpec(healthy=0.3)), shaken(0.3, warm_up_s + seconds))
    assert len(found.maxima) == blocks
    assert found.judged_s == pytest.approx(seconds)


def test_b4_blocks_do_not_depend_on_chunks_and_run_through_segments() -> None:
    """B4: each chunk made a block of its own, most of them zero."""
    monitor = VibrationLevel(VibrationLevelSpec(healthy=0.3))
    (one,), (other,) = shaken(0.3, 21.0, 0, 1), shaken(0.3, 19.0, 1, 2)
    expected = score(monitor, [one, other])
    assert len(expected.maxima) == 3  # 16.01 and 14.01 s are judged
    assert expected.judged_s == pytest.approx(30.02)
    rng = np.random.default_rng(3)
    for _ in range(5):
        chunks = []
        for rows in (one, other):
            edges = [0, *sorted(rng.integers(0, len(rows.block), 20).tolist()), len(rows.block)]
            chunks += [rows.part(a, b) for a, b in itertools.pairwise(edges) if b > a]
        found = score(monitor, chunks)
        np.testing.assert_allclose(found.maxima, expected.maxima, rtol=1e-12)
        np.testing.assert_allclose(found.spans_s, expected.spans_s)
    assert found.maxima.min() > 0.3


def test_a_flight_is_scored_by_a_fit_that_did_not_see_it() -> None:
    seen: list[list[int]] = []

    def fitted(rest: Flights) -> list[VibrationLevel]:
        seen.append(sorted({rows.block.segment for flight in rest for rows in flight}))
        return [VibrationLevel(VibrationLevelSpec(healthy=0.0))]

    scores = held_out_scores([shaken(0.3, seconds=35.0, segment=i) for i in range(3)], fitted)
    assert seen == [[1, 2], [0, 2], [0, 1]]
    assert len(scores[None].maxima) == 9


def test_too_short_a_flight_says_so() -> None:
    with pytest.raises(IdentificationError, match="fly longer"):
        calibrated(VibrationLevel, [shaken(0.3, seconds=4.0)], example_context())
