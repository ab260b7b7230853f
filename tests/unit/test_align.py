"""Rows of one time: joining, gaps and turns; and the rate pair by running Savitzky-Golay filters."""

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_rows import changed, example_rows
from made_telemetry import DT_NS, series
from numpy.typing import NDArray
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from mavdiag.errors import InputError
from mavdiag.rows.align import GYRO, AlignSpec, Grid, measure_grid
from mavdiag.rows.block import MADE_UP, VALID, Block
from mavdiag.rows.gate import Border, GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.savgol import window_samples
from mavdiag.telemetry import FloatArray, IntArray, Signal, Telemetry

SPEC = AlignSpec(0.001)
Many = FloatArray | float
LOSSES = np.random.default_rng(4).random(5000) > 0.2
LOGGER = np.random.default_rng(8).integers(4_500_000, 13_000_000, 3000)
DROPPING = np.where(np.arange(3000) % 3 == 0, LOGGER, 4_000_000)  # R8: the median step says 250 Hz


def ramp(t_ns: IntArray) -> FloatArray:
    """Three columns that are linear in time, so that interpolation must be exact."""
    return np.outer(t_ns / 1e10, [1.0, -2.0, 0.5])


def linear_flight(gyro_t: IntArray, setpoint_t: IntArray) -> Telemetry:
    setpoint = series(Signal.ATTITUDE_SETPOINT, setpoint_t, 3 * ramp(setpoint_t))
    return Telemetry((series(Signal.BODY_RATE, gyro_t, ramp(gyro_t)), setpoint))


def whole(telemetry: Telemetry, spec: AlignSpec = SPEC) -> list[Block]:
    state = spec.start()
    return [*spec.step(state, telemetry), *spec.finish(state)]


def commanded_rates(telemetry: Telemetry) -> FloatArray:
    state = RATES.start()
    return np.concatenate([RATES.step(state, block).rates.u for block in whole(telemetry)])


def column(blocks: list[Block], name: str) -> NDArray[Any]:
    return np.concatenate([getattr(block, name) for block in blocks])


def clock(n: int) -> IntArray:
    return np.arange(n, dtype=np.int64) * DT_NS + 5_000_000_000


@given(steps=st.lists(st.floats(0.6, 12.0), min_size=1, max_size=60))
def test_every_sample_is_a_row_and_gaps_are_filled_evenly(steps: list[float]) -> None:
    points = 7_000_000_000 + np.round(np.cumsum([0.0, *steps]) * DT_NS).astype(np.int64)
    blocks = whole(linear_flight(points, points))
    rows = column(blocks, "t_ns")
    places = np.searchsorted(rows, points)
    np.testing.assert_array_equal(rows[places], points)
    assert len(rows) == places[-1] + 1
    for (a, b), (i, j) in zip(itertools.pairwise(points.tolist()), itertools.pairwise(places.tolist()), strict=True):
        assert j - i == round((b - a) / DT_NS)
        np.testing.assert_allclose(rows[i : j + 1], np.linspace(a, b, j - i + 1), atol=0.51)
    np.testing.assert_allclose(column(blocks, "rate"), ramp(rows), atol=1e-9)
    more = np.sort(np.concatenate((points, points + 100_000)))  # nearer than half a period to the one before
    assert column(whole(linear_flight(more, points)), "t_ns").tolist() == rows.tolist()


def test_a_long_gap_is_blanked_with_what_follows_it_for_300_ms() -> None:
    t = clock(3000)
    blocks = whole(linear_flight(np.delete(t, slice(1500, 1600)), t))
    rows, valid = column(blocks, "t_ns"), column(blocks, "valid")
    seconds = (rows - t[0]) / 1e9
    assert valid[(seconds > 1.001) & (seconds < 1.4995)].all()
    assert not valid[(seconds > 1.4995) & (seconds < 1.599 + 0.3)].any()
    assert valid[seconds > 1.9005].all()
    assert {b.segment for b in blocks} == {0}


def test_a_heading_that_passes_pi_is_no_step() -> None:
    t = clock(3000)
    yaw = np.mod(np.arange(3000) / 250, 2 * np.pi) - np.pi
    setpoint = series(Signal.ATTITUDE_SETPOINT, t, np.outer(yaw, [0.0, 0.0, 1.0]))
    blocks = whole(Telemetry((series(Signal.BODY_RATE, t, ramp(t)), setpoint)))
    np.testing.assert_allclose(np.diff(column(blocks, "setpoint")[:, 2]), 0.004, atol=1e-9)


@pytest.mark.parametrize(
    ("steps", "dt_s", "grid"),
    [
        (np.diff(clock(5000)[LOSSES]), 0.001, Grid.NATIVE),
        (np.tile([1_000_000, 1_800_000], 50), 0.0014, Grid.RESAMPLED),
        (
            np.insert(DROPPING, 1500, 20_000_000_000),
            float(np.mean(DROPPING)) / 1e9,
            Grid.RESAMPLED,
        ),  # a pause is no step
    ],
)
def test_the_rate_is_measured_through_losses_uneven_steps_and_pauses(steps: IntArray, dt_s: float, grid: Grid) -> None:
    t = 5_000_000_000 + np.concatenate(([0], np.cumsum(steps)))
    found_s, found = measure_grid(linear_flight(t, t))
    assert found is grid
    assert found_s == pytest.approx(dt_s, rel=1e-3)


def test_without_setpoints_the_rows_flow_and_memory_stays_bounded() -> None:
    state = SPEC.start()
    blocks: list[Block] = []
    for i in range(50):
        t = clock(1000) + i * 1_000_000_000
        blocks += SPEC.step(state, Telemetry((series(Signal.BODY_RATE, t, ramp(t)),)))
    assert len(state.streams.times[GYRO]) <= 6000
    assert len(column(blocks, "t_ns")) == 50_000 - 5  # the gyro must be 5 ms further
    assert column(blocks, "valid")[1001:].all()
    assert not column(blocks, "setpoint_valid").any()
    assert np.isnan(column(blocks, "setpoint")).all()


def test_a_setpoint_that_stops_leaves_the_gyro_rows_valid_and_is_waited_for_one_second() -> None:
    t = clock(8000)
    stopped = np.delete(t, slice(2000, 4500))
    blocks = whole(linear_flight(t, stopped))
    assert {b.segment for b in blocks} == {0}
    assert column(blocks, "valid")[1001:].all()
    usable, setpoint = column(blocks, "setpoint_valid"), column(blocks, "setpoint")
    assert usable[:2000].all()
    assert not usable[2000 : 4500 + 999].any()  # the outage, and a second to settle
    assert usable[5501:].all()
    assert np.isnan(setpoint[2000:4500]).all()  # nobody knows it
    some, known = (commanded_rates(linear_flight(t, times)) for times in (stopped[9:], t))
    np.testing.assert_allclose(some, np.where(some.any(axis=1, keepdims=True), known, 0.0), atol=1e-9)  # and no leap
    gyro, wanted = linear_flight(t, stopped)
    head = Telemetry((gyro.where(slice(3100)), wanted.where(slice(2000))))
    assert len(column(SPEC.step(SPEC.start(), head), "t_ns")) == 3100 - 5  # no wait any more


@pytest.mark.parametrize(
    ("signal", "width", "step", "limit_s"),
    [
        (Signal.SPECIFIC_FORCE, 3, 1, 0.0),
        (Signal.TORQUE_COMMAND, 3, 20, 0.0),
        (Signal.RATE_SETPOINT, 3, 2, 0.0),
        (Signal.THRUST_SETPOINT, 1, 1, 1.0),
        (Signal.ACTUATOR, 4, 10, 1.0),
        (Signal.VIBRATION, 3, 50, 1.0),
        (Signal.HEIGHT, 1, 10, 2.0),
        (Signal.ARMED, 1, 399, 99.0),
    ],
)
def test_b2_a_stopped_signal_is_unknown_after_its_limit(signal: Signal, width: int, step: int, limit_s: float) -> None:
    """Rows of 12 s at 100 Hz in which one more signal stops after 4 s."""
    t = clock(1200)[0] + 10 * DT_NS * np.arange(1200, dtype=np.int64)
    extra = series(signal, t[:400:step], np.ones((len(t[:400:step]), width)))
    blocks = whole(Telemetry((*linear_flight(t, t).series, extra)), AlignSpec(0.01))
    known = np.concatenate([block.known(signal) for block in blocks])
    np.testing.assert_array_equal(known, t <= t[:400:step][-1] + round(limit_s * 1e9))
    assert column(blocks, "valid")[101:].all()  # the gyro does not depend on it


def test_b2_a_force_gap_is_not_bridged_and_a_signal_without_a_column_is_unknown() -> None:
    t = clock(3000)
    base, force_t = linear_flight(t, t), np.delete(t, slice(2000, 2100))
    blocks = whole(Telemetry((*base.series, series(Signal.SPECIFIC_FORCE, force_t, ramp(force_t)))))
    known = np.concatenate([block.known(Signal.SPECIFIC_FORCE) for block in blocks])
    assert np.flatnonzero(~known).tolist() == list(range(2000, 2100))
    assert not any(block.known(signal).any() for block in blocks for signal in (Signal.ACTUATOR, Signal.VOLTAGE))
    assert all((block.known(Signal.BODY_RATE) == block.valid).all() for block in blocks)


def test_b22_memory_stays_bounded_when_the_gyro_stops_and_others_go_on() -> None:
    t, state = clock(1000), SPEC.start()
    blocks = SPEC.step(state, linear_flight(t, t))
    extra: list[Block] = []
    for i in range(1, 40):
        later = clock(1000) + i * 1_000_000_000
        chunk = [series(s, later, ramp(later)) for s in (Signal.ATTITUDE_SETPOINT, Signal.SPECIFIC_FORCE)]
        extra += SPEC.step(state, Telemetry(tuple(chunk)))
    assert state.room < 10_000  # samples of each stream
    assert np.array_equal(column([*blocks, *extra], "t_ns"), t)  # the last rows do not wait for ever
    t = clock(1000) + 40_000_000_000
    assert {block.segment for block in SPEC.step(state, linear_flight(t, t))} == {1}


def test_a_sample_that_is_no_number_is_a_lost_sample_and_what_comes_late_or_twice_is_dropped() -> None:
    t = clock(3000)
    base = linear_flight(t, t)
    for one in base.series:
        one.values[1500] = np.nan
    blocks = whole(base)
    np.testing.assert_allclose(column(blocks, "setpoint"), 3 * ramp(t), atol=1e-9)
    np.testing.assert_allclose(column(blocks, "rate"), ramp(t), atol=1e-9)
    order = np.arange(3000)
    order[[300, 301]] = order[[301, 300]]  # a swap within the wait is repaired
    order = np.append(np.insert(order, 1800, 1799), 1000)  # a duplicate; a sample that is seconds late
    gyro = series(Signal.BODY_RATE, t[order], ramp(t[order]))
    gyro.values[1799] += 0.1  # the other one is another sample
    rows = whole(Telemetry((gyro, linear_flight(t, t).series[1])))
    assert np.array_equal(column(rows, "t_ns"), t)
    assert np.flatnonzero(np.concatenate([block.x[VALID] for block in rows]) == MADE_UP).tolist() == [1799]
    np.testing.assert_allclose(column(rows, "rate"), ramp(t), atol=1e-9)


def test_a_signal_whose_number_of_columns_changes_is_refused_and_nothing_else_is_lost() -> None:
    t, odd = clock(1000), series(Signal.ACTUATOR, clock(2000), np.ones((2000, 6)))
    flight = (*linear_flight(t, t).series, series(Signal.ACTUATOR, t, np.arange(4000.0).reshape(1000, 4) / 4000))
    first, rest = (Telemetry(tuple(one.where(part) for one in flight)) for part in (slice(500), slice(500, None)))
    state = SPEC.start()
    blocks = SPEC.step(state, first)
    with pytest.raises(InputError, match="actuator has 6 columns in place of 4"):
        SPEC.step(state, Telemetry((odd,)))
    blocks += [*SPEC.step(state, rest), *SPEC.finish(state)]
    assert np.array_equal(column(blocks, "actuator"), column(whole(Telemetry(flight)), "actuator"), equal_nan=True)


def block(
    thrust: FloatArray, *, armed: Many = np.nan, gyro: Many = 0.0, up: Many = np.nan, first: int = 0, segment: int = 0
) -> Block:
    """Rows at 1 kHz. gyro: (n,) roll rate [rad/s]. up: -f_z."""
    n = len(thrust)
    rate, force = np.outer(np.full(n, gyro), [1.0, 0.0, 0.0]), np.outer(np.full(n, up), [0.0, 0.0, -1.0])
    rows = example_rows(n, 0.001, segment=segment, thrust=thrust, rate=rate).block
    t_ns = DT_NS * np.arange(first, first + n, dtype=np.int64)
    return changed(dataclasses.replace(rows, t_ns=t_ns), armed=np.full(n, armed), force=force)


def spans(spec: GateSpec, blocks: list[Block]) -> list[tuple[int, ...]]:
    """(segment, first row, last row) of what comes out, neighbouring pieces joined, and (row,) of each border."""
    state = spec.start()
    out = [part for one in blocks for part in spec.step(state, one)]
    rest = spec.finish(state)
    found: list[tuple[int, ...]] = []
    for one in (*out, *rest):
        if isinstance(one, Border):
            found.append((one.t_ns // DT_NS,))
            continue
        low, high = int(one.t_ns[0]) // DT_NS, int(one.t_ns[-1]) // DT_NS
        if found and len(found[-1]) == 3 and found[-1][0] == one.segment and found[-1][2] == low - 1:
            found[-1] = (one.segment, found[-1][1], high)
        else:
            found.append((one.segment, low, high))
    return found


def tumble(n: int) -> FloatArray:
    """(n,) roll rate of a vehicle that tumbles [rad/s]."""
    return 9.0 + 8.0 * np.sin(np.arange(n) / 50)


def levels(*pairs: tuple[int, float]) -> FloatArray:
    return np.concatenate([np.full(n, value) for n, value in pairs])


def test_a_break_is_no_landing_until_what_follows_does_not_fly() -> None:
    state, blocks = THRUST.start(), [block(levels((900, 0.5))), block(levels((99, 0.0)), first=4000, segment=1)]
    parts = [part for one in blocks for part in THRUST.step(state, one)]
    assert [(one.t_ns // DT_NS, one.landed) for one in parts if isinstance(one, Border)] == [(899, False), (899, True)]


THRUST = GateSpec(min_thrust=0.1)
TRIMMED = GateSpec(min_thrust=0.1, trim_start_s=0.3, trim_end_s=0.2)
HOP = levels((500, 0.0), (1000, 0.5), (1500, 0.0), (1000, 0.5), (1500, 0.0))
DROP = levels((1000, 0.5), (3000, 0.0))  # thrust of a landing, or of a vehicle that tumbles
DIP = levels((1000, 0.5), (900, 0.0), (600, 0.5), (900, 0.0), (600, 0.5))
SPIKE, TWO_SAMPLES, UP = np.zeros(4000), np.zeros(4000), np.full(1000, 0.5)
HIT, HITS = levels((1500, 9.8), (50, 40.0), (3350, 9.8)), levels((1500, 9.8), (20, 150.0), (2000, 9.8), (5480, 40.0))
LATE, CLIMB = levels((1900, 0.5), (3000, 0.0)), levels((1500, 0.3), (100, 0.6))
SPIKE[1300:1800], TWO_SAMPLES[[1700, 2600]] = 11.0, 30.0
CASES = {
    "each flight is a segment of its own": (THRUST, [block(HOP)], [(0, 500, 1499), (1499,), (1, 3000, 3999), (3999,)]),
    "a dip of thrust is no landing": (THRUST, [block(DIP)], [(0, 0, 3999)]),
    "nor is one in a tumble": (THRUST, [block(DIP, gyro=tumble(4000))], [(0, 0, 3999)]),
    "the spike of a touch-down is not judged": (THRUST, [block(DROP, gyro=SPIKE)], [(0, 0, 999), (999,)]),
    "nor an impact before": (THRUST, [block(LATE, up=HIT, gyro=tumble(4900) * (HIT > 10))], [(0, 0, 1501), (1501,)]),
    "what flies on has not landed": (THRUST, [block(np.full(9000, 0.5), up=HITS)], [(0, 0, 8999)]),
    "nor has what climbs": (THRUST, [block(CLIMB, up=9.8 * (CLIMB / 0.3) ** 2)], [(0, 0, 1599)]),
    "one wrong sample makes no tumble": (THRUST, [block(DROP, gyro=TWO_SAMPLES)], [(0, 0, 999), (999,)]),
    "a tumble ends a second after it lies still": (
        THRUST,
        [block(levels((1000, 0.5), (6000, 0.0)), gyro=np.r_[np.zeros(1000), tumble(2000), np.zeros(4000)])],
        [(0, 0, 3998), (3998,)],
    ),
    "disarming is a landing at once": (
        THRUST,
        [block(DROP[:2000], armed=levels((1400, 1.0), (600, 0.0)), gyro=tumble(2000))],
        [(0, 0, 999), (999,)],
    ),
    "nothing is judged while disarmed": (
        GateSpec(),
        [block(UP[:100], armed=levels((40, 0.0), (60, 1.0)))],
        [(0, 40, 99)],
    ),
    "data that end in a tumble are judged to the last row": (
        TRIMMED,
        [block(DROP[:1600], gyro=tumble(1600))],
        [(0, 0, 1599)],
    ),
    "data that end in a landing are not": (TRIMMED, [block(DROP[:1600])], [(0, 0, 799)]),
    "a touch-down that is calm as the data end is a landing": (
        THRUST,
        [block(DROP[:2000], gyro=np.r_[np.zeros(1200), tumble(200), np.zeros(600)])],
        [(0, 0, 999)],
    ),
    "what flies after a break has not taken off, and the break is no landing": (
        TRIMMED,
        [block(UP), block(UP, first=5000, segment=1)],
        [(0, 0, 999), (999,), (1, 5000, 5999)],
    ),
    "no border follows the ground": (THRUST, [block(0 * UP), block(0 * UP, first=5000, segment=1)], []),
    "a signal that is never sent passes": (
        GateSpec(min_thrust=0.1, min_height_m=0.4),
        [block(np.nan * UP)],
        [(0, 0, 999)],
    ),
    "a signal that is unknown for a while passes": (THRUST, [block(np.r_[UP, np.nan * UP])], [(0, 0, 1999)]),
}


@pytest.mark.parametrize("name", CASES)
def test_what_comes_out(name: str) -> None:
    spec, blocks, expected = CASES[name]
    assert spans(spec, blocks) == expected


@given(edges=st.lists(st.integers(1, 11_999), max_size=30), seed=st.integers(0, 9))
def test_any_cut_gives_the_same_flight(edges: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)

    def made(lengths: list[int], values: list[float]) -> FloatArray:
        return np.resize(np.repeat(rng.choice(values, 80), rng.choice(lengths, 80)), 12_000)

    thrust, gyro = made([50, 400, 1500, 2500], [0.0, 0.5]), made([20, 300, 1200, 3000], [0.0, 0.0, 9.0])
    armed, up = made([4000, 300], [1.0, 1.0, 1.0, 0.0]), made([30, 800], [9.8, 9.8, 30.0])
    ends = itertools.pairwise([0, *sorted(set(edges)), 12_000])
    parts = [block(thrust[a:b], armed=armed[a:b], gyro=gyro[a:b], up=up[a:b], first=a) for a, b in ends]
    assert spans(TRIMMED, parts) == spans(TRIMMED, [block(thrust, armed=armed, gyro=gyro, up=up)])


@pytest.mark.parametrize(("thrust", "flies"), [(np.nan, [False, False, True, True, True, False]), (0.5, [True] * 6)])
def test_without_a_thrust_set_point_outputs_that_all_idle_are_no_flight(thrust: float, flies: list[bool]) -> None:
    outputs = np.array([[0.0, 0.1], [0.15, 0.1], [0.15, 0.2], [0.4, 0.4], [np.nan, 0.1], [0.0, 0.0]])
    for row, expected in zip(outputs, flies, strict=True):
        many = changed(block(np.full(100, thrust)), actuator=np.tile(row, (100, 1)))
        assert (bool(spans(THRUST, [many])), spans(GateSpec(), [many])) == (expected, [(0, 0, 99)])


DT_S = 0.001
RATES = RateSpec.of(DT_S, 101)


def block_of(setpoint: FloatArray, rate: FloatArray | None = None) -> Block:
    return example_rows(len(setpoint), DT_S, setpoint=setpoint, rate=rate).block


def leaning_turn(t: FloatArray) -> FloatArray:
    """(n, 3) roll, pitch, yaw of a vehicle that leans and turns its nose along a path."""
    return np.column_stack((0.5 * np.sin(1.1 * t), 0.4 * np.cos(0.7 * t) - 0.1, 0.8 * t + 0.6 * np.sin(0.9 * t)))


@pytest.mark.parametrize(("window", "order"), [(5, 2), (11, 1), (101, 2)])
def test_running_moments_are_the_filters_of_scipy(window: int, order: int) -> None:
    """After 100,000 rows, too, of which the first ones are large."""
    rng, m = np.random.default_rng(1), window // 2
    rate, roll = rng.normal(0, 1, (100_000, 3)), np.cumsum(rng.normal(0, 0.01, (100_000, 1)), axis=0)
    rate[:200] += 1e3
    spec = RateSpec.of(DT_S, window, order)
    out = spec.step(spec.start(), block_of(roll * (1, 0, 0), rate)).rates
    np.testing.assert_allclose(out.y, savgol_filter(rate, window, order, axis=0)[m:-m], atol=1e-9)
    slope = savgol_filter(roll[:, 0], window, order, deriv=1, delta=DT_S)[m:-m]
    np.testing.assert_allclose(out.u[:, 0], slope, atol=1e-9 * np.abs(slope).max())
    np.testing.assert_array_equal(out.gyro, rate[m:-m])


def test_l1_u_is_the_body_rate_of_a_vehicle_that_turns_and_leans() -> None:
    """Truth from rotations, whose logarithm of the change over one step is the body rate, and no formula of W."""
    t = np.arange(12_000, dtype=np.float64) * DT_S
    out = RATES.step(RATES.start(), block_of(leaning_turn(t))).rates
    at = np.round(out.t_ns / 1e9 / DT_S).astype(int)

    def attitude(offset: float) -> Rotation:
        return Rotation.from_euler("ZYX", leaning_turn(np.asarray(t[at] + offset, dtype=np.float64))[:, ::-1])

    truth = (attitude(-1e-5).inv() * attitude(1e-5)).as_rotvec() / 2e-5
    np.testing.assert_allclose(out.u, truth, atol=2e-3)  # the window of 0.1 s bends a curve a little
    slopes = np.gradient(leaning_turn(t), DT_S, axis=0)[at]
    assert np.abs(slopes - truth).max() > 0.3  # the slopes of the angles are no body rates


def test_a_row_is_valid_and_commanded_only_with_its_whole_window_and_a_segment_begins_afresh() -> None:
    rows, state = block_of(np.zeros((1000, 3))), RATES.start()
    valid, setpoint_valid = np.arange(1000) >= 200, np.arange(1000) != 600
    out = RATES.step(state, changed(rows, valid=valid, setpoint_valid=setpoint_valid)).rates
    at = np.round(out.t_ns / 1e9 / DT_S).astype(int)
    np.testing.assert_array_equal(out.rated, at >= 250)
    np.testing.assert_array_equal(out.commanded, (at >= 250) & (np.abs(at - 600) > 50))
    assert len(RATES.step(state, rows.rows(0, 50, segment=7)).rates) == 0
    again = RATES.step(state, rows.rows(50, 101, segment=7)).rates
    assert (len(again), int(again.t_ns[0])) == (1, int(rows.t_ns[50]))


def test_window_samples() -> None:
    found = [window_samples(dt_s, 0.1) for dt_s in (0.001, 1 / 999, 1 / 1002, 1 / 270, 0.005, 0.1)]
    assert found == [101, 101, 101, 27, 21, 5]
