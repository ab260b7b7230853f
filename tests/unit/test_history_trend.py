"""The trend of a statistic over flights: against other ways to the same figures, and its statement of its own error."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.history.trend import MEMORY, Sessions, Trend, changes_of, sessions_of, trend_of
from mavdiag.telemetry import FloatArray

shares = st.lists(st.floats(0.0, 3.0) | st.just(math.nan), min_size=1, max_size=40)


def one_each(share: FloatArray) -> Sessions:
    n = len(share)
    return sessions_of(range(1, n + 1), range(n), share)


def forecast(trend: Trend, flights: float) -> tuple[float, float]:
    """Level so many flights from now, and its standard error."""
    variance = trend.level_variance + 2 * flights * trend.covariance + flights**2 * trend.slope_variance
    return trend.level + trend.slope * flights, math.sqrt(max(variance, 0.0))


def test_the_line_is_that_of_a_weighted_polynomial_fit() -> None:
    """`numpy.polyfit`, where no session is odd, so that Huber's weights are all 1."""
    x = np.arange(1.0, 61.0)
    y = 0.3 + 0.004 * x + 0.02 * np.sign(np.sin(x))
    found = trend_of(one_each(y), 60.0)
    slope, level = np.polyfit(x - 60.0, y, 1, w=np.sqrt(np.exp((x - 60.0) / MEMORY)))
    assert found is not None
    assert (found.level, found.slope) == pytest.approx((level, slope), rel=1e-9)


def test_the_stated_error_is_the_scatter_of_repetitions() -> None:
    """Sessions of one flight with normal errors, 300 times."""
    rng = np.random.default_rng(2)
    x = np.arange(1.0, 101.0)
    found = [trend_of(one_each(0.4 + 0.002 * x + 0.03 * rng.standard_normal(100)), 100.0) for _ in range(300)]
    trends = [one for one in found if one is not None]
    levels, slopes = np.array([one.level for one in trends]), np.array([one.slope for one in trends])
    assert np.median([math.sqrt(one.level_variance) for one in trends]) == pytest.approx(levels.std(), rel=0.3)
    assert np.median([math.sqrt(one.slope_variance) for one in trends]) == pytest.approx(slopes.std(), rel=0.3)
    ahead = [forecast(one, 20.0) for one in trends]
    within = [abs(value - (0.4 + 0.002 * 120)) < 1.645 * error for value, error in ahead]
    assert np.mean(within) > 0.8  # 0.9 for many sessions; the memory leaves some twenty
    assert levels.mean() == pytest.approx(0.6, abs=0.005)


@given(st.floats(0.3, 1.1), st.floats(1e-4, 0.05), st.floats(1e-6, 1e-3), st.floats(0.001, 0.9), st.floats(-0.9, 0.9))
def test_the_interval_of_the_remaining_flights_holds_what_cannot_be_told_from_the_threshold(
    level: float, slope: float, level_variance: float, relative: float, correlation: float
) -> None:
    """Fieller's inequality, asked directly over a grid of flights."""
    slope_variance = (relative * slope) ** 2
    covariance = correlation * math.sqrt(level_variance * slope_variance)
    trend = Trend(level, slope, level_variance, covariance, slope_variance, 0.05, 20)
    found = trend.remaining()
    assert found is not None
    assert found.low <= found.flights <= found.high
    for ahead in np.linspace(0.0, 2 * (1.0 + found.flights), 50).tolist():
        value, error = forecast(trend, ahead)
        inside = abs(1.0 - value) <= 1.645 * error
        near = min(abs(ahead - found.low), abs(ahead - found.high)) < 1e-6 * (1 + ahead)
        if level < 1.0 and not near:
            assert inside == (found.low <= ahead <= found.high)


@given(shares)
def test_no_series_is_too_odd_for_a_trend_and_its_changes(share: list[float]) -> None:
    sessions = one_each(np.array(share))
    trend = trend_of(sessions, float(len(share)))
    assert (trend is None) == (len(sessions) < 5)
    if trend is not None:
        assert math.isfinite(trend.level)
        assert trend.slope_variance > 0
    assert all(1 < one.number <= len(share) for one in changes_of(sessions))
