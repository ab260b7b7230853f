"""Evidence over flights against the normal law written out, and the promise of Ville's inequality on drawn flights."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from mavdiag.thresholds.evidence import RISES, STEPS, Flown, evidence_of
from mavdiag.thresholds.rule import DEGREES, Prior

PRIORS = (Prior(0.02, 0.01, shares=False), Prior(0.01, 0.005, shares=False))
COLUMNS = np.array([[-0.25, 0.25, 0.25, -0.25], [0.25, 0.25, -0.25, -0.25]])
DIFFUSE = 1.0  # variance of mu: a hundred standard deviations


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
    assert int(np.argmax(found.shares)) == 2
    assert found.since == 3


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


def test_many_flights_overflow_nothing() -> None:
    trims = np.zeros((400, 2))
    trims[10:] = 0.5 * COLUMNS[:, 0]
    found = evidence_of(flights(trims, 10), COLUMNS, PRIORS)
    assert np.isfinite(found.odds)
    assert found.odds > 1e100
    assert int(np.argmax(found.shares)) == 0


def test_without_new_flights_nothing_is_said() -> None:
    with pytest.raises(UsageError, match="needs some that taught"):
        evidence_of(flights(np.zeros((3, 2)), 3), COLUMNS, PRIORS)


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
