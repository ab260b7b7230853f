"""The trend of a statistic over flights, its error, when it is warned of, stretches, and what is drawn."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_history import DAY_NS, START_NS, record, records, series

from mavdiag.history.show import (
    FLIGHT_COLUMNS,
    TREND_COLUMNS,
    flight_rows,
    lines_of,
    overview_json,
    trend_rows,
)
from mavdiag.history.trend import MEMORY, Sessions, Trend, changes_of, sessions_of, trend_of
from mavdiag.history.warn import (
    WATCHED,
    Mark,
    MarkKind,
    Outlook,
    overview_of,
    review,
    series_of,
    stretches_of,
    warned_at,
)
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


def worn(flights: int, power: float, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.asarray(0.4 + 0.6 * (np.arange(1, flights + 1) / flights) ** power + 0.03 * rng.standard_normal(flights))


@pytest.mark.parametrize("power", [0.8, 1.0, 2.0])
@pytest.mark.parametrize("seed", range(3))
def test_wear_is_warned_of_5_to_40_flights_before_its_threshold(power: float, seed: int) -> None:
    found = warned_at(series(worn(150, power, seed)))
    assert found is not None
    assert 5 <= 150 - found <= 40


def test_a_warning_stands_while_the_level_does_and_ends_when_it_falls_back() -> None:
    slow = np.concatenate((worn(150, 1.0, 1)[:140], np.full(10, 0.93)))
    found = review(series(slow))
    assert found.outlook is Outlook.WARNING
    assert found.warned_at is not None
    assert found.warned_at < 140
    assert review(series(np.concatenate((slow, np.full(60, 0.4))))).outlook is Outlook.STEADY
    assert review(series(np.concatenate((slow, np.full(40, 1.1))))).outlook is Outlook.REACHED


def test_marks_and_other_baselines_begin_a_stretch() -> None:
    flights = (*records([0.5] * 10), *(record(number, baseline="sha256:new") for number in range(11, 16)))
    marks = (
        Mark("one", START_NS + 4 * DAY_NS + 1, MarkKind.NEW_PROPELLERS),
        Mark("one", START_NS + 90 * DAY_NS, MarkKind.REPAIR),
    )
    found = [(one.first, one.began, len(one.flights)) for one in stretches_of(flights, marks)]
    assert found == [(1, "", 4), (5, "new propellers", 6), (11, "new baseline", 5), (16, "repair", 0)]
    assert stretches_of((), marks) == ()


def test_a_series_has_the_monitors_of_propellers_the_sessions_and_the_highest_threshold() -> None:
    times = [START_NS, START_NS + DAY_NS // 48, START_NS + DAY_NS, 0, 0]
    (stretch,) = stretches_of([record(n, 0.5 if n != 2 else None, t_ns=t) for n, t in enumerate(times)], ())
    found = series_of(stretch)
    assert [one.name for one in found] == ["fsd roll", "fsd pitch", "unbalance"]
    assert "control_loss" not in WATCHED
    assert found[2].session.tolist() == [0, 0, 1, 2, 3]
    assert np.isnan(found[2].share[2])
    assert (found[0].share[0], found[2].share[0]) == (0.5, 0.5)


@given(st.lists(st.floats(0.0, 5.0) | st.none(), min_size=1, max_size=60), st.integers(1, 150), st.booleans())
def test_a_drawing_keeps_to_the_width_of_the_terminal(peaks: list[float | None], width: int, marked: bool) -> None:
    marks = (Mark("one", START_NS + 5 * DAY_NS + 1, MarkKind.NEW_PROPELLERS),) if marked else ()
    found = overview_of("one", records(peaks), marks)
    drawn = [line.text for line in lines_of(found, width) if line.text.startswith("    ")]
    assert len(drawn) == sum(one.trend is not None for one in found.found)
    assert all(len(text) <= max(width, 5) for text in drawn)
    json.dumps(overview_json(found), allow_nan=False)
    assert all(set(TREND_COLUMNS) <= set(row) for row in trend_rows(found))
    assert all(set(row) <= set(FLIGHT_COLUMNS) for one in found.flights for row in flight_rows(1, one))
