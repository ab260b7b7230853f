"""The events that a statistic above its threshold makes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.decision import events as event_step
from mavdiag.decision.events import Event, EventSpec, Reading, events
from mavdiag.telemetry import BoolArray, FloatArray


def reading(statistic: FloatArray, valid: BoolArray | None = None, first: int = 0) -> Reading:
    n = len(statistic)
    t_ns = 10_000_000 * np.arange(first, first + n, dtype=np.int64)
    return Reading(t_ns, statistic, statistic, statistic, np.ones(n, dtype=np.bool_) if valid is None else valid)


def test_an_alert_needs_strictly_more_than_the_threshold() -> None:
    _, seen = events(EventSpec("m", None, 1.0), event_step.start(), reading(np.array([1.0, 1.0])))
    assert seen == ()


def test_unjudged_rows_raise_nothing() -> None:
    hidden = np.zeros(3, dtype=np.bool_)
    _, seen = events(EventSpec("m", None, 1.0), event_step.start(), reading(np.full(3, 9.0), hidden))
    assert seen == ()


@pytest.mark.parametrize("size", [1, 2, 3, 10])
def test_one_event_spans_chunks_and_closes_after_the_clear_time(size: int) -> None:
    statistic = np.array([0, 2, 3, 0, 4, 0, 0, 0, 0, 5.0])
    spec = EventSpec("m", None, 1.0, clear_s=0.03)
    state = event_step.start()
    seen: list[Event] = []
    for i in range(0, 10, size):
        state, found = events(spec, state, reading(statistic[i : i + size], first=i))
        seen += found
    ms10 = 10_000_000
    assert [(e.start_ns, e.end_ns, e.statistic) for e in seen] == [
        (ms10, None, 2.0),
        (ms10, 4 * ms10, 4.0),
        (9 * ms10, None, 5.0),
    ]
    assert event_step.finish(state) == (seen[-1],)


@given(values=st.lists(st.floats(0, 3), min_size=1, max_size=50), clear=st.sampled_from([0.0, 0.02, 0.05]))
def test_every_row_above_the_threshold_lies_in_an_event(values: list[float], clear: float) -> None:
    statistic = np.array(values)
    state, seen = events(EventSpec("m", None, 1.0, clear), event_step.start(), reading(statistic))
    latest: dict[int, Event] = {e.start_ns: e for e in (*seen, *event_step.finish(state))}
    for i in np.flatnonzero(statistic > 1.0):
        t = 10_000_000 * int(i)
        assert any(e.start_ns <= t and (e.end_ns is None or t <= e.end_ns) for e in latest.values())
    for event in latest.values():
        assert event.statistic > 1.0
