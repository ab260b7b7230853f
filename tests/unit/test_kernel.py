"""The compiled pass against its definition: looks, alarms, what was judged; and that no cut of rows changes a bit."""

import itertools
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from flying_telemetry import DT_NS, flying, without
from hypothesis import given, settings
from hypothesis import strategies as st
from made_baselines import thesis, whole
from made_statistics import alarms_of, assert_alike, looked_of
from made_telemetry import START_NS, changed, cut, flight

from mavdiag.chain import Chain, ChainState, chain_of
from mavdiag.decision.diagnosis import Change, Event, Stage
from mavdiag.jit import jit
from mavdiag.kernel import Account, Alarm, Looked, Piece, Stretch
from mavdiag.rows.align import Grid
from mavdiag.rows.block import COVERED, DOUBT, SPEEDS
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

N = 4600
Told = tuple[tuple[Alarm, ...], tuple[Account, ...], int, int, tuple[Stretch, ...]]
Story = tuple[list[Event], list[Change], ChainState, FloatArray]


def hard_flight(seed: int) -> Telemetry:
    """Losses, swapped samples, a short gap, a break, signals that stop for a while, and faults.

    The nose turns as was not learnt from 1 to 2.5 s, rotor 2 is weak from 8 to 16 s, the gyro shakes from 18 to 20 s, a
    landing is at 22 s, vibration is up from 30 to 38 s, rotor 3 is weak from 38 s on.
    """
    rng, s = np.random.default_rng(seed), DT_NS * np.arange(N) / 1e9
    healthy = flying(N, seed, turn=np.where((s > 1.0) & (s < 2.5), 1.5, 0.0))
    parts = []
    for one in healthy.series:
        values, at_s = one.values.copy(), (one.t_ns - START_NS) / 1e9
        if one.signal is Signal.ACTUATOR:
            values[(at_s >= 8) & (at_s < 16), 1] += 0.1
            values[at_s >= 38, 2] += 0.1
        if one.signal is Signal.VIBRATION:
            values[(at_s >= 30) & (at_s < 38)] *= 1.75
        if one.signal is Signal.BODY_RATE:
            values[(s >= 18) & (s < 20)] += rng.normal(0, 0.3, (200, 3))
        if one.signal is Signal.ARMED:
            values[(at_s >= 22) & (at_s < 24)] = 0
        at = np.flatnonzero((rng.random(len(one)) > 0.02) | (one.signal is Signal.ARMED))
        for i in rng.integers(0, len(at) - 1, 5):
            if len(one) == N:
                at[[i, i + 1]] = at[[i + 1, i]]
        parts.append(Series(one.signal, one.t_ns[at], np.sort(one.host_ns[at]), values[at]))
    rough = without(Telemetry(tuple(parts)), (5.0, 5.08), (29.0, 30.6))
    rough = without(rough, (12.0, 15.0), signals=(Signal.VIBRATION, Signal.SPECIFIC_FORCE))
    rough = without(rough, (13.0, 15.5), (44.0, 60.0), signals=(Signal.ACTUATOR,))
    return without(rough, (19.0, 19.5), (26.0, 28.5), signals=(Signal.ATTITUDE_SETPOINT,))


@cache
def segment(name: str) -> tuple[Chain, Rows]:
    """A chain, and the longest segment of a flight with faults and losses; some of it is outside of the envelope."""
    made = chain_of(whole() if name == "whole" else thesis())
    push = np.where(np.arange(9000) // 700 % 3 == 1, 0.2, 0.0)
    telemetry = hard_flight(1) if name == "whole" else flight(9000, 1, push=push)
    parts = [part for part in made.front.pieces([telemetry]) if isinstance(part, Rows)]
    return made, max(parts, key=lambda part: len(part.block))


def judged(name: str, edges: list[int]) -> tuple[list[Looked], list[Piece], Told]:
    made, rows = segment(name)
    memory, looked, pieces = made.kernel.start(), list[Looked](), list[Piece]()
    for ends in itertools.pairwise(sorted({0, len(rows.block), *edges})):
        more, piece = made.kernel.step(memory, rows.part(*ends))
        looked.append(more)
        pieces.append(piece)
    looked.append(made.kernel.close(memory, int(rows.block.t_ns[-1])))
    told = (made.kernel.open_alarms(memory), made.kernel.accounts(memory), memory.flown, memory.judged)
    made.kernel.restart(memory)
    return looked, pieces, (*told, memory.unjudged)


def joined(looked: list[Looked]) -> tuple[object, ...]:
    arrays = [np.concatenate([getattr(one, name)[: len(one.heights)] for one in looked if len(one.heights)]).tobytes()
              for name in ("readings", "sums")]  # fmt: skip
    flat = [[x for one in looked for x in getattr(one, name)] for name in ("heights", "leads", "alarms")]
    return (*arrays, *flat)


@pytest.mark.parametrize("name", ["whole", "thesis"])
def test_looks_and_alarms_are_what_their_definition_says(name: str) -> None:
    made, rows = segment(name)
    looked, (piece,), (lasting, *_) = judged(name, [])
    lag = len(rows.block) - len(rows.rates)
    arrived: list[IntArray] = []
    for slot, at, count in zip(made.slots, piece.at, piece.counts, strict=True):
        arrived.append(rows.block.t_ns[at[:count] + (lag if slot.monitor.by_rates else 0)])
    expected = looked_of(made.slots, piece.found, int(rows.block.t_ns[-1]), arrived)
    for found, wanted in zip(looked, expected, strict=True):
        skipped = wanted.first - found.first  # looks before the first value
        assert skipped >= 0
        assert set(found.heights[:skipped]) <= {-1}
        assert list(found.heights[skipped:]) == list(wanted.heights)
        assert list(found.leads[skipped:]) == list(wanted.leads)
        count = len(wanted.heights)
        np.testing.assert_allclose(found.readings[skipped : skipped + count], wanted.readings[:count], rtol=1e-12)
        np.testing.assert_allclose(found.sums[skipped : skipped + count], wanted.sums[:count], rtol=1e-9, atol=1e-12)
        assert sorted(found.alarms, key=repr) == sorted(wanted.alarms, key=repr)
    assert any(one.alarms for one in looked)
    for alarm in lasting:
        started = alarms_of(alarm.slot, made.slots[alarm.slot], piece.found[alarm.slot], [0] * int(piece.counts.max()))
        assert (alarm.start_ns, started[-1].end_ns) == (started[-1].start_ns, -1)


@settings(max_examples=12, deadline=None)
@given(name=st.sampled_from(["whole", "thesis"]), edges=st.lists(st.integers(1, 1000), max_size=40))
def test_no_cut_of_the_rows_changes_a_bit(name: str, edges: list[int]) -> None:
    (looked, pieces, told), (whole_looked, (one,), whole_told) = judged(name, edges), judged(name, [])
    assert (joined(looked), told) == (joined(whole_looked), whole_told)
    for number, expected in enumerate(one.found):
        for field in ("t_ns", "value", "valid", "level", "signal"):
            values = np.concatenate([getattr(piece.found[number], field) for piece in pieces])
            assert values.tobytes() == getattr(expected, field).tobytes()


@pytest.mark.parametrize("name", ["whole", "thesis"])
def test_accounts_add_up(name: str) -> None:
    made, rows = segment(name)
    _, (piece,), (_, accounts, flown, covered, unjudged) = judged(name, [])
    for account, found in zip(accounts, piece.found, strict=True):
        assert account.flight_s == pytest.approx(len(rows.block) * rows.block.dt_s)
        assert account.judged_s == pytest.approx(found.judged_s)
        assert account.peak == (found.value[found.valid].max() if found.valid.any() else None)
        spans = account.judged_s + account.outside_s + sum(account.not_judged.values())
        assert spans == pytest.approx(account.flight_s, abs=max(made.kernel.periods_s))
    assert any(account.outside_s for account in accounts) == (name == "whole")
    assert 0 < covered <= flown <= len(rows.block)
    lost = sum((stop - first) / NS_PER_S + rows.block.dt_s for first, stop in unjudged)
    assert lost == pytest.approx((flown - covered) * rows.block.dt_s)


def run(chain: Chain, chunks: list[Telemetry]) -> Story:
    """All events and changes in the order in which they came, the end, and the time and signals of every row."""
    state = chain.start()
    outputs = [*(chain.step(state, chunk) for chunk in chunks), chain.finish(state)]
    blocks = [piece.rows.block for one in outputs for piece in one.pieces]
    own = [np.delete(one.x[:SPEEDS], COVERED, axis=0) for one in blocks]  # without what the pass writes
    rows = np.concatenate([np.vstack((one.t_ns, x)) for one, x in zip(blocks, own, strict=True)], axis=1)
    events, changes = ([x for one in outputs for x in getattr(one, name)] for name in ("events", "changes"))
    return events, changes, state, rows


def assert_same(found: Story, expected: Story) -> None:
    """Equal, but for the rounding of running sums."""
    assert_alike(found[0], expected[0])
    assert_alike(found[1], expected[1])
    np.testing.assert_allclose(found[3], expected[3], rtol=1e-9, atol=1e-9)
    assert found[2].memory.judged == expected[2].memory.judged
    assert found[2].diagnosis.stage is expected[2].diagnosis.stage
    for one, other in zip(found[2].accounts, expected[2].accounts, strict=True):
        assert one.peak == (None if other.peak is None else pytest.approx(other.peak, rel=1e-9))
        assert (one.flight_s, one.judged_s) == pytest.approx((other.flight_s, other.judged_s))
        assert dict(one.not_judged) == pytest.approx(dict(other.not_judged), abs=1e-6)


@cache
def chain(grid: Grid, trim_end_s: float) -> Chain:
    made = chain_of(whole())
    front = replace(
        made.front, align=replace(made.front.align, grid=grid), gate=replace(made.front.gate, trim_end_s=trim_end_s)
    )
    return replace(made, front=front)


@cache
def uncut(seed: int, grid: Grid, trim_end_s: float) -> Story:
    return run(chain(grid, trim_end_s), [hard_flight(seed)])


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 3), st.lists(st.integers(0, N), max_size=60), st.sampled_from(Grid), st.sampled_from([0.0, 0.6]))
def test_l5_any_cut_gives_equal_events_and_changes(seed: int, edges: list[int], grid: Grid, trim_end_s: float) -> None:
    """L5: scan and live differed in type and severity. With rows, faults, borders, and signals that stop."""
    cuts = sorted(START_NS + edge * DT_NS for edge in edges)
    assert_same(run(chain(grid, trim_end_s), cut(hard_flight(seed), cuts)), uncut(seed, grid, trim_end_s))


def test_a_doubt_stays_with_its_sample_where_the_aligner_makes_room() -> None:
    telemetry = flying(900, 1)
    telemetry.series[1].values[300:700] = telemetry.series[1].values[300]  # of the gyro; room is made on the way
    chunks = cut(telemetry, [START_NS + k * DT_NS for k in range(900)])
    found, expected = (run(chain(Grid.NATIVE, 0.0), parts)[3][1 + DOUBT] for parts in (chunks, [telemetry]))
    assert expected.any()
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("every_ms", [10**6, 40])
def test_b3_a_landing_closes_the_events_and_nothing_goes_into_the_next_flight(every_ms: int) -> None:
    """B3: an event of flight 1 stayed open on the ground, and flight 2 began with a CRITICAL."""
    weak = flying(2000, 1, weak_rotor=2, rise=0.3)
    parts = []
    for one, other in zip(weak, flying(3500, 2), strict=True):
        later = replace(other, t_ns=other.t_ns + 20 * NS_PER_S, host_ns=other.host_ns + 20 * NS_PER_S)
        joined = (np.concatenate([getattr(x, name) for x in (one, later)]) for name in ("t_ns", "host_ns", "values"))
        parts.append(Series(one.signal, *joined))
    two = changed(Telemetry(tuple(parts)), Signal.ARMED, lambda _: 0.0, 16.0, 26.0)
    cuts = list(range(START_NS, START_NS + 55 * 10**9, every_ms * 1_000_000))
    events, changes, state, _ = run(chain_of(whole()), cut(two, cuts))
    second_ns = START_NS + 25 * 10**9
    assert {one.start_ns < second_ns for one in events} == {True}
    closed = {(one.monitor, one.axis, one.start_ns): one for one in events}
    assert all(one.end_ns is not None and one.end_ns < second_ns for one in closed.values())
    assert not [one for one in changes if one.t_ns > second_ns]
    [landing] = [one for one in changes if one.stage is Stage.INSPECT]
    assert landing.t_ns == pytest.approx(START_NS + 16e9, abs=0.2e9)
    assert (state.diagnosis.stage, state.diagnosis.rotor) == (Stage.INSPECT, 2)


def test_a_number_that_is_written_out_compiles_no_version_of_its_own() -> None:
    compiled: Any = jit
    inner = compiled(lambda k: k + 1)
    assert (compiled(lambda: inner(inner(0)) + inner(1))(), len(inner.signatures)) == (4, 1)
