"""Whatever the chunks, the same rows and the same events: a log and a live link give one verdict."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from made_telemetry import DT_NS, A, B, cut, flight

from mavdiag.chain import Chain, Front, Watch
from mavdiag.decision.events import Event
from mavdiag.identify import ArxModel, Method
from mavdiag.monitors.run_length import RunLength
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.telemetry import Axis, Series, Telemetry

MODEL = ArxModel(A, B, 0.001, (2, 2, 1), Method.PUBLISHED)


def chain(grid: Grid, trim_end_s: float) -> Chain:
    front = Front(AlignSpec(0.001, grid), GateSpec(trim_end_s=trim_end_s), RateSpec.of(0.001, 101))
    watches = tuple(Watch(RunLength(MODEL, axis, 0.005), 0.02, 0.005) for axis in (Axis.ROLL, Axis.PITCH))
    return Chain(front, watches)


def run(one: Chain, chunks: list[Telemetry]) -> tuple[set[Event], int]:
    state, judged = one.start(), 0.0
    events: list[Event] = []
    for chunk in chunks:
        state, found = one.step(state, chunk)
        events += found.events
        judged += found.judged_s
    last = one.finish(state)
    latest = {(e.monitor, e.axis, e.start_ns): e for e in (*events, *last.events)}
    return set(latest.values()), round((judged + last.judged_s) / 0.001)


def damaged(seed: int) -> Telemetry:
    """A flight with losses, swaps, a gap of 80 ms and one of 1.3 s, and a push that must be found."""
    rng = np.random.default_rng(seed)
    push = np.zeros(9000)
    push[4000:4500] = 0.2
    parts = []
    for one in flight(9000, seed, push=push).series:
        keep = rng.random(len(one)) > 0.02
        span = (one.t_ns - one.t_ns[0]) // DT_NS
        keep &= ~((span > 3000) & (span < 3080)) & ~((span > 6000) & (span < 7300))
        at = np.flatnonzero(keep)
        for i in rng.integers(0, len(at) - 1, 5):
            at[[i, i + 1]] = at[[i + 1, i]]
        parts.append(Series(one.signal, one.t_ns[at], np.sort(one.host_ns[at]), one.values[at]))
    return Telemetry(tuple(parts))


@given(
    seed=st.integers(0, 5),
    edges=st.lists(st.integers(0, 9000), max_size=40),
    grid=st.sampled_from(list(Grid)),
    trim_end_s=st.sampled_from([0.0, 0.6]),
)
def test_any_chunking_gives_the_same_events(seed: int, edges: list[int], grid: Grid, trim_end_s: float) -> None:
    telemetry = damaged(seed)
    one = chain(grid, trim_end_s)
    expected = run(one, [telemetry])
    cuts = sorted(1_000_000_000 + edge * DT_NS for edge in edges)
    assert run(one, cut(telemetry, cuts)) == expected
    assert any(e.axis is Axis.ROLL for e in expected[0])
