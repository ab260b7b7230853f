"""What every monitor keeps to. A new monitor is one line in CASES."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from flying_telemetry import DT_NS, DT_S, START_NS, flying, flying_front, flying_rows, without
from hypothesis import given, settings
from hypothesis import strategies as st
from made_telemetry import cut

from mavdiag.airframe.layout import layout_named
from mavdiag.decision.events import Reading
from mavdiag.identify import ArxModel, Method
from mavdiag.monitors import innovation, rotor_signature, rotor_trim, unbalance, vibration_level
from mavdiag.monitors.base import Monitor, Rows
from mavdiag.monitors.run_length import RunLength
from mavdiag.telemetry import Axis, Telemetry

SAMPLES = 3200
HEALTHY = [flying_rows(flying(SAMPLES, 100))]  # what the monitors are fitted to


@dataclass(frozen=True)
class Case:
    """A monitor, ready to run at 100 Hz on a flight with every signal."""

    name: str
    build: Callable[[], Monitor[Any]]


MODEL = ArxModel(np.array([1.0, -0.7]), np.array([0.0, 0.3]), DT_S, (1, 1, 1), Method.PUBLISHED)
CASES = (
    Case("latency", lambda: RunLength(MODEL, Axis.ROLL, 0.05)),
    Case("effort", lambda: rotor_trim.RotorTrim(rotor_trim.fit(HEALTHY, layout_named("x")))),
    Case("innovation", lambda: innovation.Innovation(innovation.fit(HEALTHY))),
    Case("shake", lambda: vibration_level.VibrationLevel(vibration_level.fit(HEALTHY))),
    Case("energy", lambda: rotor_signature.RotorSignature(rotor_signature.fit(HEALTHY, layout_named("x")))),
    Case("vibration", lambda: unbalance.Unbalance(unbalance.fit(HEALTHY, layout_named("x")))),
)
FIELDS = ("t_ns", "statistic", "level", "signal", "valid", "rotors")

every_monitor = pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)


def rough_flight(seed: int) -> Telemetry:
    """Two stretches of flight with a break of 1.5 s between them, and a gap of 80 ms in the first."""
    return without(flying(SAMPLES, seed), (10.0, 10.08), (18.0, 19.5))


def run(monitor: Monitor[Any], rows: list[Rows]) -> Reading:
    """All readings of a flight, joined."""
    state, readings = monitor.start(), []
    for one in rows:
        state, reading = monitor.step(state, one)
        readings.append(reading)
    full = [reading for reading in readings if len(reading.t_ns)]
    return Reading(*(np.concatenate([getattr(reading, name) for reading in full]) for name in FIELDS))


@every_monitor
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 3), edges=st.lists(st.integers(0, SAMPLES), max_size=60))
def test_any_chunking_gives_the_same_readings(case: Case, seed: int, edges: list[int]) -> None:
    telemetry = rough_flight(seed)
    expected = run(case.build(), flying_rows(telemetry))
    front = flying_front()
    state = front.start()
    rows: list[Rows] = []
    for chunk in cut(telemetry, sorted(START_NS + edge * DT_NS for edge in edges)):
        state, more = front.step(state, chunk)
        rows += more
    found = run(case.build(), [*rows, *front.finish(state)[1]])
    for name in ("t_ns", "valid"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    for name in ("statistic", "level", "signal", "rotors"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-12, atol=1e-12, err_msg=name)


@every_monitor
def test_inputs_are_left_alone(case: Case) -> None:
    rows = flying_rows(rough_flight(1))
    for one in rows:
        for part in (one.block, one.rates):
            for field in dataclasses.fields(part):
                value = getattr(part, field.name)
                if isinstance(value, np.ndarray):
                    value.setflags(write=False)
    run(case.build(), rows)  # a write would raise


@every_monitor
def test_readings_have_one_row_a_time_and_a_name(case: Case) -> None:
    monitor = case.build()
    for one in flying_rows(rough_flight(2)):
        _, reading = monitor.step(monitor.start(), one)
        n = len(reading.t_ns)
        assert all(getattr(reading, name).shape[0] == n for name in FIELDS[:5])
        assert reading.rotors.ndim == 2
        assert reading.rotors.shape[0] in (0, n)  # (0, 0): it knows nothing of rotors
        assert bool(np.all(np.diff(reading.t_ns) > 0))
    assert monitor.name
    assert monitor.unit


@every_monitor
def test_what_must_not_be_judged_is_not(case: Case) -> None:
    rows = flying_rows(rough_flight(3))
    may = {int(t) for one in rows for t in one.block.t_ns[one.block.valid]}
    reading = run(case.build(), rows)
    judged = {int(t) for t in reading.t_ns[reading.valid]}
    assert judged
    assert judged <= may


@every_monitor
def test_the_statistic_is_finite_where_it_is_valid(case: Case) -> None:
    reading = run(case.build(), flying_rows(rough_flight(4)))
    for name in ("statistic", "level", "signal", "rotors"):
        values = getattr(reading, name)
        assert np.isfinite(values[reading.valid] if len(values) else values).all(), name


@every_monitor
def test_a_new_segment_starts_afresh(case: Case) -> None:
    rows = flying_rows(rough_flight(5))
    segments = sorted({one.block.segment for one in rows})
    assert len(segments) == 2
    later = [one for one in rows if one.block.segment == segments[1]]
    alone, after = run(case.build(), later), run(case.build(), rows)
    first = int(np.searchsorted(after.t_ns, alone.t_ns[0]))
    for name in FIELDS:
        both = getattr(after, name)
        np.testing.assert_array_equal(both[first:] if len(both) else both, getattr(alone, name), err_msg=name)


@every_monitor
def test_the_start_state_is_not_spent_by_a_run(case: Case) -> None:
    rows, monitor = flying_rows(rough_flight(6)), case.build()
    start = monitor.start()
    first = monitor.step(start, rows[0])[1]
    again = monitor.step(start, rows[0])[1]
    np.testing.assert_array_equal(first.statistic, again.statistic)


@every_monitor
def test_the_docstring_states_the_price(case: Case) -> None:
    text = type(case.build()).__doc__ or ""
    for word in ("Warm-up", "RunLength", "Price", "Blind spots", ">>>"):
        assert word in text, f"{case.name} does not state: {word}"
