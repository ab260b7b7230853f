"""Whatever the chunks, the same rows, rates and borders, to the bit: through losses, stops, yaw turns and landings."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from made_telemetry import ROUNDING, cut, series

from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.front import Front, Rows, in_pieces
from mavdiag.rows.gate import Border, GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.telemetry import FloatArray, Series, Signal, Telemetry

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
def test_any_chunking_gives_the_same_rows_and_borders(
    seed: int, edges: list[int], grid: Grid, trim_end_s: float
) -> None:
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


@settings(max_examples=25)
@given(
    seed=st.integers(0, 5),
    most=st.integers(20, N),
    grid=st.sampled_from(list(Grid)),
    trim_end_s=st.sampled_from([0.0, 0.6]),
)
def test_a_whole_log_in_pieces_gives_the_same(seed: int, most: int, grid: Grid, trim_end_s: float) -> None:
    telemetry = hard_flight(seed)
    front = Front(AlignSpec(0.005, grid), GateSpec(min_thrust=0.1, trim_end_s=trim_end_s), RateSpec.of(0.005, 21))
    story, table = run(front, [telemetry])
    found_story, found = told(list(front.pieces(in_pieces(telemetry, most))))
    assert found_story == story
    for name, column in table.items():
        np.testing.assert_allclose(found[name], column, rtol=0.0, atol=ROUNDING, err_msg=name)


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
