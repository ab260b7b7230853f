"""Whatever the chunks, the same events and changes: a log and a live link give one verdict."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from flying_telemetry import DT_NS, flying
from hypothesis import given, settings
from hypothesis import strategies as st
from made_baselines import whole
from made_flights import N, hard_flight
from made_statistics import assert_alike
from made_telemetry import START_NS, cut

from mavdiag.chain import Chain, ChainState, chain_of
from mavdiag.decision.diagnosis import Change, Event, Stage
from mavdiag.rows.align import Grid
from mavdiag.telemetry import Series, Signal, Telemetry

Story = tuple[list[Event], list[Change], ChainState]


def run(chain: Chain, chunks: list[Telemetry]) -> Story:
    """All events and changes in the order in which they came."""
    state, events, changes = chain.start(), list[Event](), list[Change]()
    for chunk in chunks:
        state, output = chain.step(state, chunk)
        events += output.events
        changes += output.changes
    state, output = chain.finish(state)
    return [*events, *output.events], [*changes, *output.changes], state


def assert_same(found: Story, expected: Story) -> None:
    """Equal, but for the rounding of running sums."""
    assert_alike(found[0], expected[0])
    assert_alike(found[1], expected[1])
    assert found[2].judged_s == pytest.approx(expected[2].judged_s)
    assert found[2].diagnosis.stage is expected[2].diagnosis.stage
    for one, other in zip(found[2].accounts, expected[2].accounts, strict=True):
        assert one.peak == (None if other.peak is None else pytest.approx(other.peak, rel=1e-9))
        assert (one.flight_s, one.judged_s) == pytest.approx((other.flight_s, other.judged_s))
        assert dict(one.not_judged) == pytest.approx(dict(other.not_judged), abs=1e-6)


@cache
def chain(grid: Grid, trim_end_s: float) -> Chain:
    made = chain_of(whole())
    front = dataclasses.replace(
        made.front,
        align=dataclasses.replace(made.front.align, grid=grid),
        gate=dataclasses.replace(made.front.gate, trim_end_s=trim_end_s),
    )
    return dataclasses.replace(made, front=front)


@cache
def uncut(seed: int, grid: Grid, trim_end_s: float) -> Story:
    return run(chain(grid, trim_end_s), [hard_flight(seed)])


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 3),
    edges=st.lists(st.integers(0, N), max_size=60),
    grid=st.sampled_from(list(Grid)),
    trim_end_s=st.sampled_from([0.0, 0.6]),
)
def test_l5_any_cut_gives_equal_events_and_changes(seed: int, edges: list[int], grid: Grid, trim_end_s: float) -> None:
    """L5: scan and live differed in type and severity. With faults, borders, and signals that stop."""
    cuts = sorted(START_NS + edge * DT_NS for edge in edges)
    assert_same(run(chain(grid, trim_end_s), cut(hard_flight(seed), cuts)), uncut(seed, grid, trim_end_s))


def joined(*flights: Telemetry, armed: tuple[tuple[float, float], ...]) -> Telemetry:
    """Flights in a row, at 100 Hz; armed in these spans [s] since the start."""
    parts, shift = [], 0
    for one in flights:
        parts.append({s.signal: Series(s.signal, s.t_ns + shift, s.host_ns + shift, s.values) for s in one.series})
        shift += len(one.need(Signal.BODY_RATE)) * DT_NS
    out = []
    for signal in parts[0]:
        t, host, values = (
            np.concatenate([getattr(p[signal], n) for p in parts]) for n in ("t_ns", "host_ns", "values")
        )
        if signal is Signal.ARMED:
            at_s = (t - START_NS) / 1e9
            values = np.any([(at_s >= low) & (at_s < high) for low, high in armed], axis=0).astype(float)[:, None]
        out.append(Series(signal, t, host, values))
    return Telemetry(tuple(out))


@pytest.mark.parametrize("every_ms", [10**6, 40])
def test_b3_a_landing_closes_the_events_and_nothing_goes_into_the_next_flight(every_ms: int) -> None:
    """B3: an event of flight 1 stayed open on the ground, and flight 2 began with a CRITICAL."""
    weak = flying(2000, 1, weak_rotor=2, rise=0.3)
    two = joined(weak, flying(3500, 2), armed=((0, 16), (26, 55)))
    cuts = list(range(START_NS, START_NS + 55 * 10**9, every_ms * 1_000_000))
    events, changes, state = run(chain_of(whole()), cut(two, cuts))
    second_ns = START_NS + 25 * 10**9
    assert events
    assert all(one.start_ns < second_ns for one in events)
    closed = {(one.monitor, one.axis, one.start_ns): one for one in events}
    assert all(one.end_ns is not None and one.end_ns < second_ns for one in closed.values())
    assert not [one for one in changes if one.t_ns > second_ns]
    landing = [one for one in changes if one.stage is Stage.INSPECT]
    assert len(landing) == 1
    assert landing[0].t_ns == pytest.approx(START_NS + 16e9, abs=0.2e9)
    assert (state.diagnosis.stage, state.diagnosis.rotor) == (Stage.INSPECT, 2)


def test_b3_the_end_of_a_watch_closes_what_is_open() -> None:
    """B3, where the link is lost in flight."""
    chain, weak = chain_of(whole()), flying(2000, 1, weak_rotor=2, rise=0.3)
    state, output = chain.step(chain.start(), weak)
    assert state.diagnosis.stage is Stage.FAULT
    opened = [one for one in output.events if one.end_ns is None]
    state, output = chain.end_flight(state)
    assert {one.start_ns for one in output.events} == {one.start_ns for one in opened}
    assert all(one.end_ns is not None for one in output.events)
    assert (state.diagnosis.stage, state.diagnosis.rotor) == (Stage.INSPECT, 2)
    assert chain.end_flight(state)[1].events == ()
