"""Thresholds: known values, refusals, folds, laws, and the alarm rate that they really give; evidence over flights."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_rows import calibrated, example_context, example_rows, held_out_scores
from scipy.stats import multivariate_normal

from mavdiag.errors import IdentificationError, UsageError
from mavdiag.monitors.vibration_level import VibrationLevel, VibrationLevelSpec
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray
from mavdiag.thresholds.evidence import RISES, STEPS, Flown, evidence_of
from mavdiag.thresholds.heldout import Flights, Scores, score
from mavdiag.thresholds.rule import DEGREES, FLIGHTS_PER_SUSPICION, USUAL, Prior, Threshold, ThresholdRule, threshold_of

maxima = st.lists(st.floats(0.01, 100.0), min_size=1, max_size=60).map(np.array)
budgets = st.floats(1e-4, 100.0)
FLIGHT_BLOCKS = 4  # of 10 s
BUDGETS = (0.05, 0.01)  # alarms per hour
TRIM, TAIL = Prior(0.013, 0.004, 0.001, shares=False), Prior(0.01, 0.01, 0.1, shares=False)
PRIORS = (Prior(0.02, 0.01, shares=False), Prior(0.01, 0.005, shares=False))
COLUMNS = np.array([[-0.25, 0.25, 0.25, -0.25], [0.25, 0.25, -0.25, -0.25]])
DIFFUSE = 1.0  # variance of mu: a hundred standard deviations


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
    block = (DEGREES * 0.1**2 + 4 * 2.0 / 2.2) / (DEGREES + 4 / 2.2)  # each flight's blocks differ by 2 from each other
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


def test_shares_are_of_the_mean_and_the_least_and_the_same_session_count() -> None:
    assert known([4.0], [0], [0], Prior(session=0.5)).session_sd == pytest.approx(2.0)
    assert known([0.01, 0.01], [0, 0], [0], Prior(least=2.0)).value == 2.0
    found = known([1.0, 1.1, 0.9, 1.0], [0, 1, 2, 3], [0, 0, 0, 0], Prior(session=0.5))
    assert found.within(same_session=True) < found.within(same_session=False) == found.value
    assert "from 4 flights in 1 session" in found.statement()
    calm = threshold_of(whole([0.0, 0.1]), sessions=[0], prior=Prior(least=2.0), rule=ThresholdRule.MAXIMUM)
    assert calm.value == 2.0  # less is nothing, whatever the rule
    unscored = threshold_of(whole([1.0, 2.0], [0, 2]), sessions=range(9), rule=ThresholdRule.MAXIMUM)
    assert (unscored.flights, unscored.sessions, unscored.false_alarms_per_flight) == (2, 2, 1 / 3)


def test_broken_scores_and_too_short_flights_are_refused() -> None:
    for maxima in ([], [math.nan], [math.inf, 1.0]):
        with pytest.raises(IdentificationError, match="finite"):
            threshold_of(whole(maxima), sessions=[0])
    with pytest.raises(IdentificationError, match="there must be some"):
        calibrated(VibrationLevel, [shaken(0.3, seconds=4.0)], example_context())


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
    assert (seen, len(scores[None].maxima)) == ([[1, 2], [0, 2], [0, 1]], 9)


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


@given(x=maxima, budget=budgets, factor=st.floats(1.01, 100.0), more=st.floats(1.0, 10.0))
def test_less_budget_or_a_wider_prior_never_lowers_it(x: FloatArray, budget: float, factor: float, more: float) -> None:
    assert level(x, budget / factor).value >= level(x, budget).value
    wider = Prior(0.2 * more, 0.1 * more, 0.1)
    assert level(x, min(budget, 0.5), wider).value >= level(x, min(budget, 0.5)).value * (1 - 1e-12)


@given(x=maxima, budget=st.floats(1e-4, 0.3))
def test_the_healthy_flights_themselves_stay_below_the_maximum_rule(x: FloatArray, budget: float) -> None:
    found = level(x, budget, rule=ThresholdRule.MAXIMUM)
    assert found.exceeding == 0
    assert found.value == pytest.approx(x.max(), rel=1e-12)  # the mean of equal maxima is rounded


def broken(flights: int, sessions: int, prior: Prior, rng: np.random.Generator) -> tuple[float, ...]:
    """Of an airframe drawn from the prior the share of hours with an alarm in the last session taught, of those in
    others, by budget, and of flights suspected where one in 50 may be."""
    session, flight, block = (
        sd * math.sqrt(DEGREES / rng.chisquare(DEGREES)) for sd in (prior.session, prior.flight, prior.block)
    )
    beta, whose = block * math.sqrt(6) / math.pi, np.arange(flights) % sessions
    taught = rng.normal(0, session, sessions)
    offsets, numbers = taught[whose] + rng.normal(0, flight, flights), np.repeat(np.arange(flights), FLIGHT_BLOCKS)
    x = 0.03 + offsets[numbers] + rng.gumbel(-np.euler_gamma * beta, beta, len(numbers))
    scores = Scores(x, np.full(len(x), 10.0), numbers)
    found = [threshold_of(scores, sessions=whose.tolist(), budget_per_hour=one, prior=prior) for one in BUDGETS]
    hours, flown = 100, 90
    each = rng.normal(0, flight, (hours, flown)) + rng.gumbel(
        -np.euler_gamma * beta + beta * math.log(FLIGHT_BLOCKS), beta, (hours, flown)
    )
    session_of = 0.03 + rng.normal(0, session, hours)
    alarms = [float(np.mean(session_of + each.max(axis=1) > one.value)) for one in found]
    here = float(np.mean(0.03 + taught[-1] + each.max(axis=1) > found[0].within(same_session=True)))
    return here, *alarms, float(np.mean(session_of[:, None] + each > found[0].suspected[0] * found[0].value))


@pytest.mark.parametrize(("flights", "sessions", "prior"), [(3, 1, TRIM), (10, 3, TRIM), (30, 1, TRIM), (5, 1, TAIL)])
def test_new_airframes_alarm_and_are_suspected_as_often_as_promised(flights: int, sessions: int, prior: Prior) -> None:
    """Taught by a few flights, judged in their session and in others: the promise holds in the mean over airframes."""
    rng = np.random.default_rng([flights, sessions])
    shares = np.array([broken(flights, sessions, prior, rng) for _ in range(120)]).T
    assert np.mean(shares[0]) < 1.5 * BUDGETS[0], f"seed [{flights}, {sessions}]: {np.mean(shares[0]):.4f}"
    for rates, promise in zip(shares[1:], (*BUDGETS, 1 / FLIGHTS_PER_SUSPICION), strict=True):
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
        for _ in range(20):
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


def flights(trims: FloatArray, learnt: int, sessions: list[int] | None = None, sets: list[int] | None = None) -> Flown:
    """Flights of a minute, each a session of its own and all of one set, unless told."""
    n = len(trims)
    return Flown(trims, np.array(sessions or range(n)), np.array(sets or [0] * n), np.full(n, 60.0), learnt)


def likelihood(told: Flown, prior: Prior) -> Callable[[FloatArray], float]:
    """ln m(y) of the docstring, by the density of the normal law for each pair of deviations."""
    u = np.minimum(1.0, told.spans_s / np.median(told.spans_s[: told.learnt]))
    same, other = told.sessions[:, None] == told.sessions, (told.propellers > 0).astype(float)
    laws = []
    for a, e in ((a, e) for a in STEPS for e in STEPS):
        belief = -DEGREES * (np.log(a * e) + 0.5 / a**2 + 0.5 / e**2)
        V = (a * prior.session) ** 2 * same + np.diag((e * prior.flight) ** 2 / u)
        V = V + prior.session**2 * np.outer(other, other) + DIFFUSE
        laws.append((belief, multivariate_normal(np.zeros(len(u)), V)))
    return lambda y: float(np.logaddexp.reduce([belief + law.logpdf(y) for belief, law in laws]))


def test_odds_are_the_mixture_of_likelihood_ratios() -> None:
    rng = np.random.default_rng(3)
    trims = rng.normal(0.0, 0.01, (7, 2))
    told = flights(trims, 4, [0, 0, 1, 1, 2, 2, 3], [0, 0, 0, 0, 1, 1, 1])
    told = Flown(told.trims, told.sessions, told.propellers, np.array([60.0, 90, 60, 60, 15, 60, 30]), 4)
    laws = [likelihood(told, PRIORS[d]) for d in range(2)]
    healthy = sum(laws[d](trims[:, d]) for d in range(2))
    odds, rotors = 1 / 4, np.zeros(4)
    for k in (1, 2, 3):
        from_k = np.arange(7) >= 4 + k - 1
        for j, r in ((j, r) for j in range(4) for r in RISES):
            shifted = trims - r * np.outer(from_k, COLUMNS[:, j])
            ratio = np.exp(sum(laws[d](shifted[:, d]) for d in range(2)) - healthy)
            rotors[j] += ratio / (k * (k + 1)) / 4 / len(RISES)
    found = evidence_of(told, COLUMNS, PRIORS)
    assert found.odds == pytest.approx(odds + rotors.sum(), rel=1e-3)
    assert found.shares == pytest.approx(tuple(rotors / rotors.sum()), rel=1e-3)


def test_a_rise_is_found_named_and_dated() -> None:
    rng = np.random.default_rng(4)
    trims = rng.normal(0.0, 0.003, (14, 2))
    trims[8:] += 0.15 * COLUMNS[:, 2]
    found = evidence_of(flights(trims, 5), COLUMNS, PRIORS)
    assert found.odds > 1000
    assert (int(np.argmax(found.shares)), found.since) == (2, 3)
    many = np.zeros((400, 2))  # overflow nothing
    many[10:] = 0.5 * COLUMNS[:, 0]
    found = evidence_of(flights(many, 10), COLUMNS, PRIORS)
    assert 1e100 < found.odds < np.inf
    assert int(np.argmax(found.shares)) == 0


def test_a_shift_of_everything_and_the_numbers_of_sessions_mean_nothing() -> None:
    trims = np.random.default_rng(5).normal(0.0, 0.01, (6, 2))
    plain = evidence_of(flights(trims, 3, [0, 0, 1, 2, 2, 3]), COLUMNS, PRIORS)
    moved = evidence_of(flights(trims + 0.3, 3, [5, 5, 4, 9, 9, 7]), COLUMNS, PRIORS)
    assert moved.odds == pytest.approx(plain.odds, rel=1e-6)


def test_flights_of_one_session_say_no_more_than_it_may_shift() -> None:
    trims = np.zeros((43, 2))
    trims[3:] = 0.08 * COLUMNS[:, 1]
    one = evidence_of(flights(trims, 3, [0, 1, 2, *[3] * 40]), COLUMNS, PRIORS).odds
    many = evidence_of(flights(trims, 3), COLUMNS, PRIORS).odds
    assert one < 10
    assert many > 1e6
    with pytest.raises(UsageError, match="needs some that taught"):
        evidence_of(flights(trims[:3], 3), COLUMNS, PRIORS)


def test_one_healthy_airframe_in_twenty_at_most_comes_above_twenty() -> None:
    rng, sessions = np.random.default_rng(6), [0, 0, 1, 2, 2, 3]
    odds = []
    for _ in range(200):
        trims = []
        for prior in PRIORS:
            a, e = (sd * np.sqrt(DEGREES / rng.chisquare(DEGREES)) for sd in (prior.session, prior.flight))
            trims.append(rng.normal(0.0, a, 4)[sessions] + rng.normal(0.0, e, 6))
        odds.append(evidence_of(flights(np.array(trims).T, 3, sessions), COLUMNS, PRIORS).odds)
    assert np.mean(np.array(odds) >= 20.0) <= 1 / 20
