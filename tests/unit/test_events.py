"""The events that a statistic above its threshold makes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_statistics import statistic

from mavdiag.decision.events import Event, EventSpec, EventState
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray

MS10 = 10_000_000


def found(values: FloatArray, first: int = 0) -> Statistic:
    return statistic(values, first_s=0.01 * first, dt_s=0.01)


def test_an_alarm_needs_strictly_more_than_the_threshold() -> None:
    _, seen = EventSpec("m", None, 1.0).step(EventState(), found(np.array([1.0, 1.0])))
    assert seen == ()


def test_values_that_are_not_valid_raise_nothing() -> None:
    hidden = replace(found(np.full(3, 9.0)), valid=np.zeros(3, dtype=np.bool_))
    _, seen = EventSpec("m", None, 1.0).step(EventState(), hidden)
    assert seen == ()


@pytest.mark.parametrize("size", [1, 2, 3, 10])
def test_one_event_spans_chunks_and_closes_after_the_clear_time(size: int) -> None:
    values = np.array([0, 2, 3, 0, 4, 0, 0, 0, 0, 5.0])
    spec, state, seen = EventSpec("m", None, 1.0, clear_s=0.03), EventState(), list[Event]()
    for i in range(0, 10, size):
        state, more = spec.step(state, found(values[i : i + size], first=i))
        seen += more
    assert [(e.start_ns, e.end_ns, e.statistic) for e in seen] == [
        (MS10, None, 2.0),
        (MS10, 4 * MS10, 4.0),
        (9 * MS10, None, 5.0),
    ]
    assert state.open == seen[-1]


def test_b3_the_end_of_a_flight_closes_an_event_at_its_last_value_above() -> None:
    """B3: an event lived through the landing and was closed by the next flight."""
    spec = EventSpec("m", None, 1.0, clear_s=2.0)
    state, _ = spec.step(EventState(), found(np.array([0, 2, 3, 0.0])))
    state, closed = spec.end(state)
    assert [(one.start_ns, one.end_ns) for one in closed] == [(MS10, 2 * MS10)]
    assert state == EventState()
    assert spec.step(state, found(np.zeros(5), first=9))[1] == ()
    assert spec.end(state)[1] == ()


@given(values=st.lists(st.floats(0, 3), min_size=1, max_size=50), clear=st.sampled_from([0.0, 0.02, 0.05]))
def test_every_value_above_the_threshold_lies_in_an_event(values: list[float], clear: float) -> None:
    x = np.array(values)
    state, seen = EventSpec("m", None, 1.0, clear).step(EventState(), found(x))
    last = () if state.open is None else (state.open,)
    latest: dict[int, Event] = {e.start_ns: e for e in (*seen, *last)}
    for i in np.flatnonzero(x > 1.0):
        t = MS10 * int(i)
        assert any(e.start_ns <= t and (e.end_ns is None or t <= e.end_ns) for e in latest.values())
    assert all(event.statistic > 1.0 for event in latest.values())


def test_an_event_is_one_line_for_a_person() -> None:
    one = Event("fsd", None, 10**9, 2 * 10**9, 0.41, 0.12, 0.1, rotor=2)
    assert str(one) == "fsd 0.41 > 0.12 from 1.00 s to 2.00 s, rotor 2"
