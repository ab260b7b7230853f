"""Whatever the chunks, the same rows, rates and borders, to the bit: through losses, stops, yaw turns and landings."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from made_telemetry import ROUNDING, cut, series

from mavdiag.rows.align import GYRO, NEVER_NS, NEWEST, AlignSpec, Grid
from mavdiag.rows.block import Block
from mavdiag.rows.front import Front, Rows, in_pieces
from mavdiag.rows.gate import Border, GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.running import FRESH, mean_size, push, total
from mavdiag.telemetry import FloatArray, IntArray, Series, Signal, Telemetry

DT_NS = 5_000_000
N = 3200  # 16 s at 200 Hz
START_NS = 1_000_000_000
# Spans without a sample [s]: short and long gaps of the gyro, stops of every other signal, in flight and at its end.
STOPS = {
    Signal.BODY_RATE: ((3.0, 3.08), (9.0, 10.6)),
    Signal.ATTITUDE_SETPOINT: ((0.0, 0.4), (4.0, 4.2), (6.0, 7.7), (15.5, 99.0)),
    Signal.SPECIFIC_FORCE: ((5.0, 5.03), (7.5, 12.0)),
    Signal.TORQUE_COMMAND: ((2.0, 2.2), (8.0, 9.5)),
    Signal.RATE_SETPOINT: ((6.0, 14.0),),
    Signal.THRUST_SETPOINT: ((13.0, 15.0),),
    Signal.ACTUATOR: ((0.0, 2.0), (11.0, 14.5)),
    Signal.VIBRATION: ((9.0, 13.0),),
}
STEPS = {Signal.ATTITUDE_SETPOINT: 4, Signal.TORQUE_COMMAND: 20, Signal.ACTUATOR: 10, Signal.VIBRATION: 40}
COLUMNS = ("t_ns", "setpoint", "rate", "force", "torque", "rate_setpoint", "thrust", "armed", "vibration")


def hard_flight(seed: int) -> Telemetry:
    """A flight that turns on and on, with a landing (disarmed), losses, swapped samples and the stops above."""
    rng = np.random.default_rng(seed)
    t_ns = START_NS + DT_NS * np.arange(N, dtype=np.int64)
    s = (t_ns - START_NS) / 1e9
    yaw = np.mod(3.0 + 2.0 * s + np.pi, 2 * np.pi) - np.pi
    values: dict[Signal, FloatArray] = {
        Signal.ATTITUDE_SETPOINT: np.column_stack((0.3 * np.sin(s), 0.2 * np.cos(2 * s), yaw)),
        Signal.THRUST_SETPOINT: np.where((s > 11.2) & (s < 12.0), 0.05, 0.5)[:, None],
        Signal.ARMED: np.where((s > 11.6) & (s < 12.0), 0.0, 1.0)[:, None],
        Signal.ACTUATOR: 0.5 + 0.05 * np.sin(np.outer(s, [5.0, 7.0, 11.0, 13.0])),  # motors that carry: 0..1
    }
    parts = []
    for signal in (*STOPS, Signal.ARMED):
        width = 4 if signal is Signal.ACTUATOR else 3
        given_values = values.get(signal, rng.normal(size=(N, width)))
        keep = rng.random(N) > 0.02
        keep &= np.arange(N) % STEPS.get(signal, 1) == 0
        for low, high in STOPS.get(signal, ()):
            keep &= ~((s >= low) & (s < high))
        at = np.flatnonzero(keep)
        for i in rng.integers(0, len(at) - 1, 5):
            if at[i + 1] - at[i] <= 4:
                at[[i, i + 1]] = at[[i + 1, i]]
        one = series(signal, t_ns[at], given_values[at])
        parts.append(Series(signal, one.t_ns, np.maximum.accumulate(one.host_ns), one.values))
    return Telemetry(tuple(parts))


def run(front: Front, chunks: list[Telemetry]) -> tuple[list[tuple[int, ...]], dict[str, FloatArray]]:
    """What comes of chunks."""
    state = front.start()
    parts: list[Rows | Border] = []
    for chunk in chunks:
        state, found = front.step(state, chunk)
        parts += found
    return told([*parts, *front.finish(state)[1]])


def told(parts: list[Rows | Border]) -> tuple[list[tuple[int, ...]], dict[str, FloatArray]]:
    """Segments and borders in order, and all columns of all rows."""
    story: list[tuple[int, ...]] = []
    for part in parts:
        entry = (part.t_ns,) if isinstance(part, Border) else (part.block.segment, 0)
        if not story or story[-1] != entry:
            story.append(entry)
    rows = [part for part in parts if isinstance(part, Rows)]
    table = {name: np.concatenate([getattr(one.block, name) for one in rows]) for name in COLUMNS}
    table |= {name: np.concatenate([getattr(one.block, name) for one in rows]) for name in ("valid", "setpoint_valid")}
    rates = ("t_ns", "u", "y", "valid", "commanded")
    table |= {f"rate {name}": np.concatenate([getattr(one.rates, name) for one in rows]) for name in rates}
    for signal in (Signal.ACTUATOR, Signal.SPECIFIC_FORCE, Signal.ROTOR_SPEED):
        table[signal] = np.concatenate([one.block.known(signal) for one in rows])
    return story, table


@given(
    seed=st.integers(0, 5),
    edges=st.lists(st.integers(0, N + 20), max_size=40),
    grid=st.sampled_from(list(Grid)),
    trim_end_s=st.sampled_from([0.0, 0.6]),
)
def test_any_cut_gives_the_same_rows_and_borders(seed: int, edges: list[int], grid: Grid, trim_end_s: float) -> None:
    telemetry = hard_flight(seed)
    front = Front(AlignSpec(0.005, grid), GateSpec(min_thrust=0.1, trim_end_s=trim_end_s), RateSpec.of(0.005, 21))
    story, table = run(front, [telemetry])
    found_story, found = run(front, cut(telemetry, sorted(START_NS + edge * DT_NS for edge in edges)))
    assert found_story == story
    for name, column in table.items():
        np.testing.assert_allclose(found[name], column, rtol=0.0, atol=ROUNDING, err_msg=name)
    assert [len(entry) for entry in story] == [2, 1, 2, 1, 2]  # a break, then a landing
    assert np.isfinite(table["rate u"]).all()
    assert table["rate commanded"].any()
    assert np.abs(table["rate u"][table["rate commanded"].astype(bool)]).max() < 4.0  # a turn through pi is no step


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


DT_NS_ALIGN = 2_000_000
N_ALIGN = 3000  # 6 s at 500 Hz
SPEC = AlignSpec(0.002)
# Every how many gyro samples each signal comes.
STEPS_ALIGN = {
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
COLUMNS_ALIGN = ("t_ns", "setpoint", "rate", "force", "attitude", "thrust", "actuator", "vibration", "armed")
FLAGS = ("valid", "setpoint_valid")


def sent(seed: int) -> dict[Signal, tuple[IntArray, FloatArray]]:
    """Times and values of each signal."""
    rng = np.random.default_rng(seed)
    every = {
        signal: START_NS + DT_NS_ALIGN * np.arange(0, N_ALIGN, step, dtype=np.int64)
        for signal, step in STEPS_ALIGN.items()
    }
    return {signal: (t, rng.normal(size=(len(t), WIDTHS.get(signal, 3)))) for signal, t in every.items()}


def arrived(
    seed: int,
    late_ns: int = 0,
    share: float = 0.0,
    lost: float = 0.0,
    since_ns: int = 0,
    signals: tuple[Signal, ...] = tuple(STEPS_ALIGN),
) -> Telemetry:
    """In order of arrival: of these signals, a share of the samples from a time on is late; another share is lost."""
    rng, parts = np.random.default_rng(seed + 1), []
    for signal, (t, v) in sent(seed).items():
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


def table(blocks: list[Block]) -> dict[str, FloatArray]:
    return {name: np.concatenate([getattr(block, name) for block in blocks]) for name in (*COLUMNS_ALIGN, *FLAGS)}


def run_align(spec: AlignSpec, chunks: list[Telemetry]) -> tuple[dict[str, FloatArray], IntArray]:
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
    return table([*blocks, *spec.finish(state)]), np.array(behind)


def assert_equal(found: dict[str, FloatArray], expected: dict[str, FloatArray]) -> None:
    for name, column in expected.items():
        np.testing.assert_array_equal(found[name], column, err_msg=name)


def ticks(every_ns: int) -> list[int]:
    return list(range(START_NS, START_NS + N_ALIGN * DT_NS_ALIGN + 60_000_000, every_ns))


cuts = st.lists(st.integers(START_NS, START_NS + N_ALIGN * DT_NS_ALIGN + 60_000_000), max_size=150)


@settings(max_examples=15, deadline=None)
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
    expected, _ = run_align(spec, [in_order(telemetry)])
    assert_equal(run_align(spec, cut(telemetry, sorted(edges)))[0], expected)
    assert_equal(run_align(spec, cut(telemetry, ticks(40_000_000)))[0], expected)


MISSED = (Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT, Signal.SPECIFIC_FORCE, Signal.ATTITUDE)


@settings(max_examples=15, deadline=None)
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
    expected, _ = run_align(SPEC, [in_order(telemetry)])
    assert_equal(run_align(SPEC, cut(telemetry, ticks(every_ms * 1_000_000)))[0], expected)


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1000), lost=st.sampled_from([0.0, 0.05, 0.5]), edges=cuts, lag_ms=st.integers(0, 4))
def test_on_an_orderly_link_any_cut_gives_the_logs_rows(seed: int, lost: float, edges: list[int], lag_ms: int) -> None:
    """With every signal but the gyro behind it by less than what counts as disorder."""
    whole = arrived(seed, lost=lost)
    telemetry = Telemetry(
        tuple(
            Series(s.signal, s.t_ns, s.host_ns + lag_ms * 1_000_000 * (s.signal is not Signal.BODY_RATE), s.values)
            for s in whole.series
        )
    )
    expected, _ = run_align(SPEC, [telemetry])
    assert_equal(run_align(SPEC, cut(telemetry, sorted(edges)))[0], expected)
    assert_equal(run_align(SPEC, cut(telemetry, ticks(2_000_000)))[0], expected)


def test_an_orderly_stream_leaves_its_rows_at_once() -> None:
    """Once the first second is over: 5 ms behind the gyro, and not before attitude, at 50 Hz, has reached them."""
    _, behind = run_align(SPEC, cut(arrived(1), ticks(2_000_000)))
    judged = behind[behind[:, 0] > START_NS + 1_100_000_000]
    reached = (judged[:, 0] - START_NS) % 20_000_000
    np.testing.assert_array_equal(judged[:, 1], np.maximum(reached, 6_000_000))
    before = behind[behind[:, 0] < START_NS + 1_000_000_000]
    assert before[-100:, 1].min() >= 50_000_000


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


def test_what_is_rounded_does_not_grow() -> None:
    mem = np.zeros(mean_size(10, 1))
    for value in (1e12, *[1e-3] * 100_000):
        mem[FRESH] = value
        push(mem, 0, 10, 1, True)
    assert abs(total(mem, 0, 1, 0) - 1e-2) < 1e-15
