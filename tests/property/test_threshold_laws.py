"""Laws of the threshold, and the alarm rate that it really gives on data whose tail is known."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, norm, poisson

from mavdiag.telemetry import FloatArray
from mavdiag.thresholds.guard import Guard
from mavdiag.thresholds.heldout import Scores
from mavdiag.thresholds.rule import ThresholdRule, poisson_upper, threshold_of

maxima = st.lists(st.floats(0.01, 100.0), min_size=1, max_size=60).map(np.array)
budgets = st.floats(1e-4, 100.0)
NO_GUARD = Guard()


def whole(x: FloatArray) -> Scores:
    """Blocks of 10 s."""
    return Scores(x, np.full(len(x), 10.0))


def level(x: FloatArray, budget: float, guard: Guard = NO_GUARD, rule: ThresholdRule = ThresholdRule.GUMBEL) -> float:
    return threshold_of(whole(x), flights=3, budget_per_hour=budget, guard=guard, rule=rule).value


@given(x=maxima, budget=budgets, scale=st.floats(0.01, 100.0), rule=st.sampled_from(list(ThresholdRule)))
def test_another_unit_gives_the_same_alarms(x: FloatArray, budget: float, scale: float, rule: ThresholdRule) -> None:
    guard = Guard(few_sessions=0.5, above_mean=0.3, least=0.1)
    scaled = Guard(few_sessions=0.5 * scale, above_mean=0.3 * scale, least=0.1 * scale)
    assert level(x * scale, budget, scaled, rule) == pytest.approx(scale * level(x, budget, guard, rule), rel=1e-9)


@given(x=maxima, budget=budgets, factor=st.floats(1.01, 100.0))
def test_a_smaller_budget_gives_a_higher_threshold(x: FloatArray, budget: float, factor: float) -> None:
    assert level(x, budget / factor) > level(x, budget)


@given(x=maxima, budget=budgets)
def test_a_guard_only_ever_raises(x: FloatArray, budget: float) -> None:
    assert level(x, budget, Guard(few_sessions=1.0, above_mean=1.0, least=1.0)) >= level(x, budget)


@given(x=maxima, budget=st.floats(1e-4, 0.3))
def test_the_healthy_flights_themselves_stay_below_the_maximum_rule(x: FloatArray, budget: float) -> None:
    found = threshold_of(whole(x), flights=3, budget_per_hour=budget, rule=ThresholdRule.MAXIMUM)
    assert found.exceeding == 0
    assert found.value == pytest.approx(x.max(), rel=1e-12)  # the mean of equal maxima is rounded


@given(events=st.integers(0, 5000))
def test_the_poisson_limit_agrees_with_chi_square(events: int) -> None:
    assert poisson_upper(events) == pytest.approx(float(chi2.ppf(0.95, 2 * events + 2)) / 2, rel=1e-6)
    assert float(poisson.cdf(events, poisson_upper(events))) == pytest.approx(0.05, abs=1e-6)


PER_BLOCK = 1000  # independent statistics in a block of 10 s
BUDGET = 3.6  # alarms an hour: one block in 100
RATE = 0.01


def achieved(tail: str, blocks: int, seed: int) -> float:
    """Alarms per block of a threshold from `blocks` healthy blocks, over the rate asked for; exactly, by the tail."""
    rng = np.random.default_rng(seed)
    x = rng.exponential(size=(blocks, PER_BLOCK)) if tail == "exponential" else rng.normal(size=(blocks, PER_BLOCK))
    value = threshold_of(
        whole(x.max(axis=1)), flights=blocks, budget_per_hour=BUDGET, guard=Guard(scale_share=0.0)
    ).value
    beyond = math.exp(-value) if tail == "exponential" else float(norm.sf(value))
    return -math.expm1(PER_BLOCK * math.log1p(-beyond)) / RATE


@pytest.mark.parametrize(
    ("tail", "blocks", "low", "high", "worst"),
    [
        ("exponential", 20, 0.5, 2.0, 15.0),  # the Gumbel law's own tail
        ("exponential", 200, 0.7, 1.5, 3.0),
        ("gaussian", 20, 0.2, 1.5, 10.0),  # a lighter one: a little on the safe side
        ("gaussian", 200, 0.3, 1.2, 2.0),
    ],
)
def test_the_alarm_rate_is_the_one_asked_for(tail: str, blocks: int, low: float, high: float, worst: float) -> None:
    ratios = np.array([achieved(tail, blocks, seed) for seed in range(200)])
    assert low < np.median(ratios) < high, f"{tail}, {blocks} blocks, seeds 0..199: median {np.median(ratios):.2f}"
    assert np.quantile(ratios, 0.95) < worst, f"{tail}, {blocks} blocks: 95 % {np.quantile(ratios, 0.95):.2f}"


@pytest.mark.parametrize("blocks", [20, 100])
def test_the_stated_standard_error_is_the_scatter_that_is_seen(blocks: int) -> None:
    found = []
    for seed in range(400):
        x = np.random.default_rng(seed).gumbel(5.0, 1.0, blocks)
        found.append(threshold_of(whole(x), flights=blocks, budget_per_hour=0.36))
    scatter = float(np.std([one.value for one in found]))
    assert float(np.median([one.standard_error for one in found])) == pytest.approx(scatter, rel=0.2)
    true = 5.0 - math.log(0.001)
    covered = np.mean([one.value + 1.645 * one.standard_error > true for one in found])
    assert 0.85 < covered <= 1.0, f"seeds 0..399: {covered}"


@pytest.mark.parametrize("flights", [3, 9])
def test_the_maximum_rule_has_its_price(flights: int) -> None:
    rng = np.random.default_rng(11)
    healthy = rng.exponential(size=(4000, flights))
    beaten = [
        level(x, 1.0, rule=ThresholdRule.MAXIMUM) < new
        for x, new in zip(healthy, rng.exponential(size=4000), strict=True)
    ]
    assert np.mean(beaten) == pytest.approx(1 / (flights + 1), abs=0.03)
