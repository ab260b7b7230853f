"""Laws of the threshold, and the alarm rate that it really gives on data whose tail is known."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, poisson

from mavdiag.telemetry import FloatArray
from mavdiag.thresholds.heldout import Scores
from mavdiag.thresholds.rule import (
    DEGREES,
    FLIGHTS_PER_SUSPICION,
    USUAL,
    Prior,
    Threshold,
    ThresholdRule,
    poisson_upper,
    threshold_of,
)

maxima = st.lists(st.floats(0.01, 100.0), min_size=1, max_size=60).map(np.array)
budgets = st.floats(1e-4, 100.0)


def level(x: FloatArray, budget: float, prior: Prior = USUAL, rule: ThresholdRule = ThresholdRule.GUMBEL) -> Threshold:
    """Of blocks of 10 s, three of a flight and two flights of a session."""
    flights = np.arange(len(x)) // 3
    sessions = [flight // 2 for flight in range(int(flights[-1]) + 1)]
    scores = Scores(x, np.full(len(x), 10.0), flights)
    return threshold_of(scores, sessions=sessions, budget_per_hour=budget, prior=prior, rule=rule)


@given(x=maxima, budget=budgets, scale=st.floats(0.01, 100.0), rule=st.sampled_from(list(ThresholdRule)))
def test_another_unit_gives_the_same_alarms(x: FloatArray, budget: float, scale: float, rule: ThresholdRule) -> None:
    prior = Prior(0.5, 0.3, 0.2, shares=False, least=0.1)
    scaled = Prior(0.5 * scale, 0.3 * scale, 0.2 * scale, shares=False, least=0.1 * scale)
    assert level(x * scale, budget, scaled, rule).value == pytest.approx(
        scale * level(x, budget, prior, rule).value, rel=1e-9
    )


@given(x=maxima, budget=budgets, factor=st.floats(1.01, 100.0))
def test_a_smaller_budget_gives_a_higher_threshold(x: FloatArray, budget: float, factor: float) -> None:
    assert level(x, budget / factor).value >= level(x, budget).value


@given(x=maxima, budget=budgets, more=st.floats(1.0, 10.0))
def test_a_wider_prior_never_lowers_it(x: FloatArray, budget: float, more: float) -> None:
    wider = Prior(0.2 * more, 0.1 * more, 0.1)
    assert level(x, min(budget, 0.5), wider).value >= level(x, min(budget, 0.5)).value * (1 - 1e-12)


@given(x=maxima, budget=st.floats(1e-4, 0.3))
def test_the_healthy_flights_themselves_stay_below_the_maximum_rule(x: FloatArray, budget: float) -> None:
    found = level(x, budget, rule=ThresholdRule.MAXIMUM)
    assert found.exceeding == 0
    assert found.value == pytest.approx(x.max(), rel=1e-12)  # the mean of equal maxima is rounded


@given(events=st.integers(0, 5000))
def test_the_poisson_limit_agrees_with_chi_square(events: int) -> None:
    assert poisson_upper(events) == pytest.approx(float(chi2.ppf(0.95, 2 * events + 2)) / 2, rel=1e-6)
    assert float(poisson.cdf(events, poisson_upper(events))) == pytest.approx(0.05, abs=1e-6)


FLIGHT_BLOCKS = 4  # of 10 s
BUDGETS = (0.05, 0.01)  # alarms per hour


def broken(flights: int, sessions: int, rng: np.random.Generator) -> tuple[float, ...]:
    """Of one airframe the share of hours with an alarm, by budget, and of flights suspected where one in 50 may be.

    Each hour is a session of its own that it was not taught in. Its components are drawn as the prior says that they
    differ between airframes.
    """
    prior = Prior(0.013, 0.004, 0.001, shares=False)
    session, flight, block = (
        sd * math.sqrt(DEGREES / rng.chisquare(DEGREES)) for sd in (prior.session, prior.flight, prior.block)
    )
    beta = block * math.sqrt(6) / math.pi
    whose = np.arange(flights) % sessions
    offsets = rng.normal(0, session, sessions)[whose] + rng.normal(0, flight, flights)
    numbers = np.repeat(np.arange(flights), FLIGHT_BLOCKS)
    x = 0.03 + offsets[numbers] + rng.gumbel(-np.euler_gamma * beta, beta, len(numbers))
    scores = Scores(x, np.full(len(x), 10.0), numbers)
    found = [threshold_of(scores, sessions=whose.tolist(), budget_per_hour=one, prior=prior) for one in BUDGETS]
    hours, flown = 100, 90
    each = rng.normal(0, flight, (hours, flown)) + rng.gumbel(
        -np.euler_gamma * beta + beta * math.log(FLIGHT_BLOCKS), beta, (hours, flown)
    )
    session_of = 0.03 + rng.normal(0, session, hours)
    alarms = [float(np.mean(session_of + each.max(axis=1) > one.value)) for one in found]
    return *alarms, float(np.mean(session_of[:, None] + each > found[0].suspected[0] * found[0].value))


@pytest.mark.parametrize("sessions", [1, 3])
@pytest.mark.parametrize("flights", [3, 5, 10, 30])
def test_new_airframes_alarm_and_are_suspected_as_often_as_promised(flights: int, sessions: int) -> None:
    """Taught by a few flights and judged in other sessions: the mean over airframes is the promise, or less."""
    rng = np.random.default_rng([flights, sessions])
    shares = np.array([broken(flights, sessions, rng) for _ in range(400)]).T
    for rates, promise in zip(shares, (*BUDGETS, 1 / FLIGHTS_PER_SUSPICION), strict=True):
        assert np.mean(rates) < 1.5 * promise, f"seed [{flights}, {sessions}]: {np.mean(rates):.4f}"
        assert np.mean(rates) > promise / 2, f"no bluntness is kept in store: {np.mean(rates):.4f}"
        assert np.median(rates) <= promise


@pytest.mark.parametrize("sessions", [1, 3])
def test_airframes_of_the_other_class_are_known_by_their_flights(sessions: int) -> None:
    """Ten quiet flights have thresholds of quiet airframes; ten of the first class have those of the first alone."""
    one, other = Prior(0.15, 0.1, 0.08), Prior(0.038, 0.026, 0.013)
    both = Prior(0.15, 0.1, 0.08, other=(0.038, 0.026, 0.013))
    rng, whose, numbers = np.random.default_rng([17, sessions]), np.arange(10) % sessions, np.repeat(np.arange(10), 3)
    for prior in (one, other):
        ratios = []
        for _ in range(60):
            session, flight, block = (
                sd * math.sqrt(DEGREES / rng.chisquare(DEGREES)) for sd in (prior.session, prior.flight, prior.block)
            )
            offsets = rng.normal(0, session, sessions)[whose] + rng.normal(0, flight, 10)
            x = 1.0 + offsets[numbers] + rng.gumbel(0, block * math.sqrt(6) / math.pi, 30)
            scores = Scores(x, np.full(30, 10.0), numbers)
            found, alone = (threshold_of(scores, sessions=whose.tolist(), prior=each) for each in (both, prior))
            ratios.append(found.value / alone.value)
        assert np.median(ratios) == pytest.approx(1.0, abs=0.02)
        assert np.quantile(ratios, 0.1) > 0.9


@pytest.mark.parametrize("flights", [3, 9])
def test_the_maximum_rule_has_its_price(flights: int) -> None:
    rng = np.random.default_rng(11)
    healthy = rng.exponential(size=(4000, flights))
    beaten = [
        level(x, 1.0, rule=ThresholdRule.MAXIMUM).value < new
        for x, new in zip(healthy, rng.exponential(size=4000), strict=True)
    ]
    assert np.mean(beaten) == pytest.approx(1 / (flights + 1), abs=0.03)
