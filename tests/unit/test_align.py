"""Alignment: gaps, losses, disorder and separate rates, each with an answer known beforehand."""

import numpy as np
import pytest
from made_telemetry import DT_NS, flight, series

from mavdiag.errors import InputError
from mavdiag.rows.align import AlignCounts, AlignSpec, Grid, align, finish, measure_grid, start
from mavdiag.rows.block import Block
from mavdiag.telemetry import FloatArray, IntArray, Signal, Telemetry

SPEC = AlignSpec(0.001)


def ramp(t_ns: IntArray) -> FloatArray:
    """Three columns that are linear in time, so that interpolation must be exact."""
    return np.outer(t_ns / 1e9, [1.0, -2.0, 0.5])


def linear_flight(gyro_t: IntArray, setpoint_t: IntArray) -> Telemetry:
    return Telemetry(
        (
            series(Signal.BODY_RATE, gyro_t, ramp(gyro_t)),
            series(Signal.ATTITUDE_SETPOINT, setpoint_t, 3 * ramp(setpoint_t)),
        )
    )


def whole(telemetry: Telemetry, spec: AlignSpec = SPEC) -> tuple[list[Block], AlignCounts]:
    state, blocks = align(spec, start(), telemetry)
    state, rest = finish(spec, state)
    return [*blocks, *rest], state.counts


def clock(n: int) -> IntArray:
    return np.arange(n, dtype=np.int64) * DT_NS + 5_000_000_000


def test_a_clean_flight_is_taken_sample_for_sample() -> None:
    telemetry = flight(3000, seed=1)
    blocks, counts = whole(telemetry)
    assert {block.segment for block in blocks} == {0}
    rate = np.concatenate([block.rate for block in blocks])
    assert np.array_equal(rate, telemetry.need(Signal.BODY_RATE).values)
    assert counts == AlignCounts(breaks=1)


def test_the_first_second_of_a_segment_is_blanked() -> None:
    blocks, _ = whole(flight(3000, seed=1))
    valid = np.concatenate([block.valid for block in blocks])
    assert not valid[:1001].any()
    assert valid[1001:].all()


def test_lost_gyro_samples_become_rows_between_their_neighbours() -> None:
    t = clock(2000)
    kept = np.delete(t, [1500, 1501, 1700])
    blocks, counts = whole(linear_flight(kept, t))
    rows = np.concatenate([block.t_ns for block in blocks])
    assert np.array_equal(rows, t)
    np.testing.assert_allclose(np.concatenate([b.rate for b in blocks]), ramp(t), atol=1e-9)
    assert counts.filled == 3
    assert np.concatenate([b.valid for b in blocks])[1100:].all()  # 2 ms is no gap


def test_a_long_gap_is_blanked_with_what_follows_it_for_300_ms() -> None:
    t = clock(3000)
    gyro = np.delete(t, slice(1500, 1600))
    blocks, _ = whole(linear_flight(gyro, t))
    rows = np.concatenate([b.t_ns for b in blocks])
    valid = np.concatenate([b.valid for b in blocks])
    seconds = (rows - t[0]) / 1e9
    assert valid[(seconds > 1.001) & (seconds < 1.4995)].all()
    assert not valid[(seconds > 1.4995) & (seconds < 1.599 + 0.3)].any()
    assert valid[seconds > 1.9005].all()
    assert {b.segment for b in blocks} == {0}


@pytest.mark.parametrize("which", ["gyro", "setpoint"])
def test_a_gap_above_one_second_starts_a_new_segment(which: str) -> None:
    t = clock(6000)
    holed = np.delete(t, slice(2000, 3500))
    blocks, counts = whole(linear_flight(holed, t) if which == "gyro" else linear_flight(t, holed))
    assert [b.segment for b in blocks] == sorted(b.segment for b in blocks)
    assert {b.segment for b in blocks} == {0, 1}
    assert counts.breaks == 2
    rows = np.concatenate([b.t_ns for b in blocks])
    assert np.array_equal(rows, holed)  # nothing is invented in between


def test_slow_setpoints_are_interpolated_to_the_gyro() -> None:
    t = clock(2000)
    blocks, _ = whole(linear_flight(t, t[::20]))
    got = np.concatenate([b.setpoint for b in blocks])
    rows = np.concatenate([b.t_ns for b in blocks])
    np.testing.assert_allclose(got, 3 * ramp(rows), atol=1e-9)


def test_duplicates_and_late_samples_are_dropped_and_counted() -> None:
    t = clock(2000)
    order = np.arange(2000)
    order[[300, 301]] = order[[301, 300]]  # a swap within the window is repaired
    order = np.insert(order, 500, 499)  # a duplicate
    order = np.append(order, 1000)  # a second late: dropped
    shuffled = t[order]
    telemetry = Telemetry(
        (series(Signal.BODY_RATE, shuffled, ramp(shuffled)), series(Signal.ATTITUDE_SETPOINT, t, 3 * ramp(t)))
    )
    blocks, counts = whole(telemetry)
    assert np.array_equal(np.concatenate([b.t_ns for b in blocks]), t)
    np.testing.assert_allclose(np.concatenate([b.rate for b in blocks]), ramp(t), atol=1e-9)
    assert (counts.duplicate, counts.late) == (1, 1)


def test_uneven_senders_are_resampled() -> None:
    rng = np.random.default_rng(3)
    t = np.sort(clock(4000) + rng.integers(-450_000, 450_000, 4000))
    dt_s, grid = measure_grid(linear_flight(t, t))
    assert grid is Grid.RESAMPLED
    blocks, _ = whole(linear_flight(t, t), AlignSpec(dt_s, grid))
    rows = np.concatenate([b.t_ns for b in blocks])
    assert np.unique(np.diff(rows)).tolist() == [round(dt_s * 1e9)]
    np.testing.assert_allclose(np.concatenate([b.rate for b in blocks]), ramp(rows), atol=1e-9)


def test_the_rate_is_measured_through_losses() -> None:
    rng = np.random.default_rng(4)
    t = clock(5000)[rng.random(5000) > 0.2]
    dt_s, grid = measure_grid(linear_flight(t, t))
    assert dt_s == pytest.approx(0.001, rel=1e-9)
    assert grid is Grid.NATIVE


def test_two_step_lengths_in_turn_have_their_mean_rate() -> None:
    t = 5_000_000_000 + np.concatenate(([0], np.cumsum(np.tile([1_000_000, 1_800_000], 50))))
    dt_s, grid = measure_grid(linear_flight(t, t))
    assert dt_s == pytest.approx(0.0014)
    assert grid is Grid.RESAMPLED


def test_too_few_samples_have_no_rate() -> None:
    t = clock(5)
    with pytest.raises(InputError, match="only 5 gyro samples"):
        measure_grid(linear_flight(t, t))


def test_without_setpoints_nothing_comes_out_and_memory_stays_bounded() -> None:
    state = start()
    for i in range(50):
        t = clock(1000) + i * 1_000_000_000
        state, blocks = align(SPEC, state, Telemetry((series(Signal.BODY_RATE, t, ramp(t)),)))
        assert blocks == ()
    assert len(state.streams[Signal.BODY_RATE].t) <= 3000


def test_held_signals_keep_their_last_value_and_are_nan_before_the_first() -> None:
    t = clock(3000)
    base = linear_flight(t, t)
    armed_t = t[[500, 2000]]
    telemetry = Telemetry((*base.series, series(Signal.ARMED, armed_t, np.array([[0.0], [1.0]]))))
    blocks, _ = whole(telemetry)
    armed = np.concatenate([b.armed for b in blocks])
    assert np.isnan(armed[:500]).all()
    assert (armed[500:2000] == 0).all()
    assert (armed[2000:] == 1).all()
