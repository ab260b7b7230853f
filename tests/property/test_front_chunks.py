"""Whatever the chunks, the same rows: through losses, disorder and stamps that leap; and running means of them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from made_telemetry import cut, series

from mavdiag.rows.align import GYRO, NEVER_NS, NEWEST, AlignSpec, Grid
from mavdiag.rows.block import Block
from mavdiag.rows.front import in_pieces
from mavdiag.rows.running import FRESH, mean_size, push, total
from mavdiag.telemetry import FloatArray, IntArray, Series, Signal, Telemetry

START_NS = 1_000_000_000
MISSED = (Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT, Signal.SPECIFIC_FORCE, Signal.ATTITUDE)


@given(seed=st.integers(0, 10_000), shift_s=st.sampled_from([-30.0, -1.0, 0.5, 60.0]))
@settings(max_examples=20)
def test_stamps_that_leap_move_no_piece_of_a_log(seed: int, shift_s: float) -> None:
    rng, n = np.random.default_rng(seed), 20_000
    t_ns = START_NS + 1_000_000 * np.arange(n, dtype=np.int64)
    leapt = t_ns.copy()
    leapt[rng.choice(n, 30, replace=False)] += round(shift_s * 1e9)
    values = np.zeros((n, 3))
    log = Telemetry((series(Signal.BODY_RATE, leapt, values), series(Signal.SPECIFIC_FORCE, t_ns, values)))
    parts = list(in_pieces(log, 4000))
    assert len(parts) == 5
    for part in parts:
        gyro, force = part.series
        assert abs(len(gyro) - len(force)) < 10, f"seed {seed}, {len(gyro)} and {len(force)}"


DT_NS = 2_000_000
N = 3000  # 6 s at 500 Hz
SPEC = AlignSpec(0.002)
# Every how many gyro samples each signal comes.
STEPS = {
    Signal.BODY_RATE: 1,
    Signal.ATTITUDE_SETPOINT: 5,
    Signal.SPECIFIC_FORCE: 1,
    Signal.ATTITUDE: 10,
    Signal.THRUST_SETPOINT: 5,
    Signal.ACTUATOR: 25,
    Signal.VIBRATION: 250,
    Signal.ARMED: 500,
}
WIDTHS = {Signal.ACTUATOR: 4, Signal.THRUST_SETPOINT: 1, Signal.ARMED: 1}
COLUMNS = ("t_ns", "setpoint", "rate", "force", "attitude", "thrust", "actuator", "vibration", "armed")
FLAGS = ("valid", "setpoint_valid")


def arrived(
    seed: int,
    late_ns: int = 0,
    share: float = 0.0,
    lost: float = 0.0,
    since_ns: int = 0,
    signals: tuple[Signal, ...] = tuple(STEPS),
) -> Telemetry:
    """In order of arrival: of these signals, a share of the samples from a time on is late; another share is lost."""
    rng, made, parts = np.random.default_rng(seed + 1), np.random.default_rng(seed), []
    for signal, step in STEPS.items():
        t = START_NS + DT_NS * np.arange(0, N, step, dtype=np.int64)
        v = made.normal(size=(len(t), WIDTHS.get(signal, 3)))
        kept = (rng.random(len(t)) >= lost) | (t == START_NS)
        t, v = t[kept], v[kept]
        late = (rng.random(len(t)) < share) & (t >= since_ns) & (signal in signals)
        delays = rng.integers(0, late_ns + 1, len(t)) * late
        order = np.argsort(t + delays, kind="stable")
        parts.append(Series(signal, t[order], (t + delays)[order], v[order]))
    return Telemetry(tuple(parts))


def in_order(telemetry: Telemetry) -> Telemetry:
    orders = [np.argsort(one.t_ns, kind="stable") for one in telemetry.series]
    pairs = zip(telemetry.series, orders, strict=True)
    return Telemetry(tuple(Series(s.signal, s.t_ns[at], s.t_ns[at], s.values[at]) for s, at in pairs))


def run(spec: AlignSpec, chunks: list[Telemetry]) -> tuple[dict[str, FloatArray], IntArray]:
    """All rows; and after each chunk the gyro's newest sample and by how much the rows are behind it, (n, 2) [ns]."""
    state, blocks, behind = spec.start(), list[Block](), list[tuple[int, int]]()
    for chunk in chunks:
        before_ns = state.last_ns
        spec.append(state, [chunk])
        reached_ns = spec.reached_ns(state)
        found = list(spec.rows(state, spec.take(state)))
        blocks += found
        if found and before_ns > -NEVER_NS and all(np.all(np.diff(one.t_ns) >= 0) for one in chunk.series):
            assert int(found[-1].t_ns[-1]) <= reached_ns
        if state.last_ns > -NEVER_NS:
            newest = int(state.streams.marks[GYRO, NEWEST])
            behind.append((newest, newest - state.last_ns))
    blocks += spec.finish(state)
    table = {name: np.concatenate([getattr(block, name) for block in blocks]) for name in (*COLUMNS, *FLAGS)}
    return table, np.array(behind)


def assert_equal(found: dict[str, FloatArray], expected: dict[str, FloatArray]) -> None:
    for name, column in expected.items():
        np.testing.assert_array_equal(found[name], column, err_msg=name)


def ticks(every_ns: int) -> list[int]:
    return list(range(START_NS, START_NS + N * DT_NS + 60_000_000, every_ns))


cuts = st.lists(st.integers(START_NS, START_NS + N * DT_NS + 60_000_000), max_size=150)


@settings(max_examples=8, deadline=None)
@given(
    seed=st.integers(0, 1000),
    late_ms=st.integers(0, 49),
    share=st.sampled_from([0.02, 0.2, 1.0]),
    lost=st.sampled_from([0.0, 0.05, 0.5]),
    grid=st.sampled_from(list(Grid)),
    edges=cuts,
)
def test_disorder_within_the_wait_gives_the_rows_of_the_sorted_stream(
    seed: int, late_ms: int, share: float, lost: float, grid: Grid, edges: list[int]
) -> None:
    spec, telemetry = AlignSpec(0.002, grid), arrived(seed, late_ms * 1_000_000, share, lost)
    expected, _ = run(spec, [in_order(telemetry)])
    assert_equal(run(spec, cut(telemetry, sorted(edges)))[0], expected)
    assert_equal(run(spec, cut(telemetry, ticks(40_000_000)))[0], expected)


@settings(max_examples=8, deadline=None)
@given(
    seed=st.integers(0, 1000),
    late_ms=st.integers(0, 49),
    share=st.sampled_from([0.002, 0.02, 0.2]),
    lost=st.sampled_from([0.0, 0.02]),
    every_ms=st.sampled_from([2, 7, 40]),
)
def test_the_first_disorder_of_an_orderly_link_changes_no_row_where_what_is_late_is_missed(
    seed: int, late_ms: int, share: float, lost: float, every_ms: int
) -> None:
    telemetry = arrived(seed, late_ms * 1_000_000, share, lost, START_NS + 3_000_000_000, MISSED)
    expected, _ = run(SPEC, [in_order(telemetry)])
    assert_equal(run(SPEC, cut(telemetry, ticks(every_ms * 1_000_000)))[0], expected)


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 1000), lost=st.sampled_from([0.0, 0.05, 0.5]), edges=cuts, lag_ms=st.integers(0, 4))
def test_on_an_orderly_link_any_cut_gives_the_logs_rows(seed: int, lost: float, edges: list[int], lag_ms: int) -> None:
    """With every signal but the gyro behind it by less than what counts as disorder."""
    lags = ((s, lag_ms * 1_000_000 * (s.signal is not Signal.BODY_RATE)) for s in arrived(seed, lost=lost).series)
    telemetry = Telemetry(tuple(Series(s.signal, s.t_ns, s.host_ns + lag_ns, s.values) for s, lag_ns in lags))
    expected, _ = run(SPEC, [telemetry])
    assert_equal(run(SPEC, cut(telemetry, sorted(edges)))[0], expected)
    assert_equal(run(SPEC, cut(telemetry, ticks(2_000_000)))[0], expected)


def test_an_orderly_stream_leaves_its_rows_at_once() -> None:
    """Once the first second is over: 5 ms behind the gyro, and not before attitude, at 50 Hz, has reached them."""
    _, behind = run(SPEC, cut(arrived(1), ticks(2_000_000)))
    judged = behind[behind[:, 0] > START_NS + 1_100_000_000]
    np.testing.assert_array_equal(judged[:, 1], np.maximum((judged[:, 0] - START_NS) % 20_000_000, 6_000_000))
    assert behind[behind[:, 0] < START_NS + 1_000_000_000][-100:, 1].min() >= 50_000_000


@given(seed=st.integers(0, 99), window=st.integers(1, 40), at=st.integers(0, 3))
def test_a_full_window_is_its_mean(seed: int, window: int, at: int) -> None:
    rng = np.random.default_rng(seed)
    x, valid = rng.normal(0, 3, (200, 2)), rng.random(200) > 0.02
    x[~valid] = np.nan
    mem = np.zeros(at + mean_size(window, 2))
    for i in range(200):
        mem[at + FRESH : at + FRESH + 2] = x[i]
        full = push(mem, at, window, 2, bool(valid[i]))
        last = np.where(valid[: i + 1, None], x[: i + 1], 0.0)[-window:]
        assert full == (i + 1 >= window and bool(valid[i + 1 - window : i + 1].all()))
        np.testing.assert_allclose([total(mem, at, 2, 0), total(mem, at, 2, 1)], last.sum(axis=0), atol=1e-10)
    mem[:] = 0.0
    for value in (1e12, *[1e-3] * 2000):  # and what is rounded stays no longer than the window
        mem[at + FRESH : at + FRESH + 2] = value
        push(mem, at, window, 2, True)
    assert abs(total(mem, at, 2, 0) - window * 1e-3) < 1e-14
