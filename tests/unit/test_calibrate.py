"""Margins and latencies from healthy flights, and the price of the maximum."""

import numpy as np
import pytest

from mavdiag.errors import InputError
from mavdiag.monitors.margin import (
    MarginRule,
    ResidualPiece,
    false_alarms_per_flight,
    latency_of,
    margin_of,
)
from mavdiag.telemetry import FloatArray


def piece(r: FloatArray) -> ResidualPiece:
    n = len(r)
    return ResidualPiece(np.arange(n, dtype=np.int64) * 10_000_000, r, np.ones(n, dtype=np.bool_), 0.01)


def coloured(rng: np.random.Generator, n: int) -> FloatArray:
    """A residual with memory, so that it has runs."""
    white = rng.standard_normal(n + 20)
    return np.convolve(white, np.ones(20) / 20, mode="valid")[:n]


def test_the_margin_is_hazen_s_90th_percentile_of_the_size() -> None:
    r = np.array([-3.0, 1.0, 2.0, -5.0, 4.0])
    assert margin_of([[piece(r)]]) == 5.0  # Hazen: p = (i - 0.5)/n, so 90 % of five values is the fifth
    assert margin_of([[piece(np.arange(1.0, 11.0))]]) == 9.5
    assert margin_of([[piece(r)]], MarginRule.MAXIMUM) == 5.0


def test_unjudged_rows_do_not_count() -> None:
    r = np.array([1.0, 99.0])
    hidden = ResidualPiece(np.arange(2, dtype=np.int64), r, np.array([True, False]), 0.01)
    assert margin_of([[hidden]], MarginRule.MAXIMUM) == 1.0


def test_no_judged_rows_is_an_error_that_says_so() -> None:
    with pytest.raises(InputError, match="no judged rows"):
        margin_of([[]])


def test_fml_is_the_longest_healthy_run() -> None:
    flights = [[piece(np.array([0, 2, 2, 0, 2.0]))], [piece(np.array([2, 2, 2.0])), piece(np.zeros(3))]]
    assert latency_of(flights, 1.0).tolist() == [0.02, 0.03]


@pytest.mark.parametrize("n", [3, 10])
def test_the_next_healthy_flight_beats_the_longest_of_n_with_probability_one_in_n_plus_one(n: int) -> None:
    seed, trials = 20 + n, 1500
    rng = np.random.default_rng(seed)
    beaten = 0
    for _ in range(trials):
        longest = latency_of([[piece(coloured(rng, 400))] for _ in range(n + 1)], 0.37)
        beaten += longest[-1] > longest[:-1].max()
    rate, expected = beaten / trials, false_alarms_per_flight(n)
    spread = np.sqrt(expected * (1 - expected) / trials)
    # Ties of equal length count for no alarm, so the rate may lie a little below.
    assert expected - 4 * spread - 0.03 < rate < expected + 4 * spread, f"seed {seed}: {rate} against {expected}"
