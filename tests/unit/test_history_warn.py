"""When a trend is warned of, and when not; stretches; what is drawn."""

import json

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


def test_a_pipe_gets_a_sentence_a_statistic_and_no_drawing() -> None:
    found = overview_of("one", records(worn(140, 1.0, 1).tolist()), ())
    lines = lines_of(found)
    assert [line.text.split(":")[0].strip() for line in lines[:3]] == ["one", "unbalance", "fsd roll"]
    assert "reaches the threshold soon, warned of since flight" in lines[1].text
    assert [line.loud for line in lines[:3]] == [False, True, False]
    assert all(ord(sign) < 0x2500 for line in lines for sign in line.text)
    assert [one.series.name for one in found.warned] == ["unbalance"]
    assert found.rotor_growth[3] == pytest.approx(0.013, abs=1e-9)
