"""The gate: spans of flight, their trims, and what passes for lack of a signal."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_telemetry import DT_NS

from mavdiag.rows.block import Block
from mavdiag.rows.gate import Border, GateSpec
from mavdiag.telemetry import FloatArray


def block(
    thrust: FloatArray,
    *,
    armed: FloatArray | None = None,
    gyro: FloatArray | None = None,
    first: int = 0,
    segment: int = 0,
) -> Block:
    """Rows at 1 kHz. gyro: (n,) roll rate [rad/s]."""
    n = len(thrust)
    none3, none = np.full((n, 3), np.nan), np.full(n, np.nan)
    return Block(
        segment=segment,
        dt_s=0.001,
        t_ns=DT_NS * np.arange(first, first + n, dtype=np.int64),
        setpoint=none3,
        rate=none3 if gyro is None else np.outer(gyro, [1.0, 0.0, 0.0]),
        force=none3,
        torque=none3,
        rate_setpoint=none3,
        thrust=thrust,
        attitude=none3,
        height=none,
        voltage=none,
        armed=none if armed is None else armed,
        vibration=none3,
        actuator=np.empty((n, 0)),
        valid=np.ones(n, dtype=np.bool_),
        setpoint_valid=np.ones(n, dtype=np.bool_),
        doubt=np.zeros(n),
    )


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


def hop() -> FloatArray:
    """On the ground, 1000 rows in the air, 1500 rows on the ground, 1000 rows in the air, down."""
    thrust = np.zeros(5500)
    thrust[500:1500] = thrust[3000:4000] = 0.5
    return thrust


def test_each_flight_is_a_segment_of_its_own() -> None:
    assert spans(GateSpec(min_thrust=0.1), [block(hop())]) == [
        (0, 500, 1499),
        (1499,),
        (1, 3000, 3999),
        (3999,),
    ]


@pytest.mark.parametrize("size", [1, 7, 333, 5500])
def test_chunks_do_not_matter(size: int) -> None:
    thrust = hop()
    blocks = [block(thrust[i : i + size], first=i) for i in range(0, len(thrust), size)]
    spec = GateSpec(min_thrust=0.1, trim_end_s=0.2)
    assert spans(spec, blocks) == [(0, 500, 1299), (1499,), (1, 3000, 3799), (3999,)]


def tumble(n: int) -> FloatArray:
    """(n,) roll rate of a vehicle that tumbles [rad/s]."""
    return 9.0 + 8.0 * np.sin(np.arange(n) / 50)


def test_a_dip_of_thrust_is_no_landing() -> None:
    """Neither a border nor the blanking of a take-off follows it, and its rows are judged."""
    thrust = np.full(4000, 0.5)
    thrust[1000:1900] = thrust[2500:3400] = 0.0
    spec = GateSpec(min_thrust=0.1, trim_start_s=0.3)
    for gyro in (np.zeros(4000), tumble(4000)):
        assert spans(spec, [block(thrust, gyro=gyro)]) == [(0, 0, 3999)]
        out = spec.step(spec.start(), block(thrust, gyro=gyro))
        valid = np.concatenate([one.valid for one in out if isinstance(one, Block)])
        assert not valid[:300].any()
        assert valid[300:].all()


def test_a_vehicle_that_tumbles_without_thrust_is_judged_to_the_end() -> None:
    """Its low rows are held back for little more than a second, and from then on not at all."""
    thrust = np.r_[np.full(1000, 0.5), np.zeros(4000)]
    gyro = np.r_[np.zeros(1000), tumble(4000)]
    spec = GateSpec(min_thrust=0.1)
    assert spans(spec, [block(thrust, gyro=gyro)]) == [(0, 0, 4999)]
    state = spec.start()
    for first in range(0, 5000, 100):
        rows = slice(first, first + 100)
        out = spec.step(state, block(thrust[rows], gyro=gyro[rows], first=first))
        assert bool(out) == (not 1000 <= first < 2100)


def test_a_tumble_ends_a_second_after_it_lies_still() -> None:
    thrust = np.r_[np.full(1000, 0.5), np.zeros(6000)]
    gyro = np.r_[np.zeros(1000), tumble(2000), np.zeros(4000)]
    assert spans(GateSpec(min_thrust=0.1), [block(thrust, gyro=gyro)]) == [(0, 0, 3998), (3998,)]


def test_the_spike_of_a_touch_down_is_not_judged() -> None:
    thrust = np.r_[np.full(1000, 0.5), np.zeros(3000)]
    gyro = np.zeros(4000)
    gyro[1300:1800] = 11.0
    assert spans(GateSpec(min_thrust=0.1), [block(thrust, gyro=gyro)]) == [(0, 0, 999), (999,)]


def test_disarming_is_a_landing_at_once() -> None:
    thrust, armed = np.r_[np.full(1000, 0.5), np.zeros(1000)], np.r_[np.ones(1400), np.zeros(600)]
    spec = GateSpec(min_thrust=0.1)
    assert spans(spec, [block(thrust, armed=armed, gyro=tumble(2000))]) == [(0, 0, 999), (999,)]


def test_one_wrong_sample_makes_no_tumble_of_a_landing() -> None:
    gyro = np.zeros(6000)
    gyro[[1700, 2600]] = 30.0
    thrust = np.r_[np.full(1000, 0.5), np.zeros(5000)]
    assert spans(GateSpec(min_thrust=0.1), [block(thrust, gyro=gyro)]) == [(0, 0, 999), (999,)]


def test_a_log_that_ends_in_a_tumble_is_judged_to_its_last_sample_and_one_that_ends_in_a_landing_is_not() -> None:
    thrust = np.r_[np.full(1000, 0.5), np.zeros(600)]
    spec = GateSpec(min_thrust=0.1, trim_end_s=0.2)
    assert spans(spec, [block(thrust, gyro=tumble(1600))]) == [(0, 0, 1599)]
    assert spans(spec, [block(thrust, gyro=np.zeros(1600))]) == [(0, 0, 799)]


def test_a_touch_down_that_is_calm_as_the_data_end_is_a_landing() -> None:
    gyro = np.r_[np.zeros(1200), tumble(200), np.zeros(600)]
    blocks = [block(np.r_[np.full(1000, 0.5), np.zeros(1000)], gyro=gyro)]
    assert spans(GateSpec(min_thrust=0.1), blocks) == [(0, 0, 999)]
    short = [block(np.r_[np.full(1000, 0.5), np.zeros(700)], gyro=gyro[:1700])]
    assert spans(GateSpec(min_thrust=0.1), short) == [(0, 0, 1699)]


def test_what_flies_after_a_break_has_not_taken_off() -> None:
    """The break is no landing either: nothing is cut off before it."""
    spec, up = GateSpec(min_thrust=0.1, trim_start_s=0.3, trim_end_s=0.2), np.full(1000, 0.5)
    parts = (block(up), block(up, first=5000, segment=1))
    assert spans(spec, list(parts)) == [(0, 0, 999), (999,), (1, 5000, 5999)]
    state = spec.start()
    out = [one for part in parts for one in spec.step(state, part)]
    assert all(one.valid.all() for one in out if isinstance(one, Block) and one.segment == 1)


@settings(max_examples=40)
@given(edges=st.lists(st.integers(1, 11_999), max_size=30), seed=st.integers(0, 9))
def test_any_cut_gives_the_same_flight(edges: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)

    def levels(lengths: list[int], values: list[float]) -> FloatArray:
        return np.resize(np.repeat(rng.choice(values, 80), rng.choice(lengths, 80)), 12_000)

    thrust, gyro = levels([50, 400, 1500, 2500], [0.0, 0.5]), levels([20, 300, 1200, 3000], [0.0, 0.0, 9.0])
    armed = levels([4000, 300], [1.0, 1.0, 1.0, 0.0])
    spec = GateSpec(min_thrust=0.1, trim_start_s=0.3, trim_end_s=0.2)
    bounds = [0, *sorted(set(edges)), 12_000]
    parts = [block(thrust[a:b], armed=armed[a:b], gyro=gyro[a:b], first=a) for a, b in itertools.pairwise(bounds)]
    assert spans(spec, parts) == spans(spec, [block(thrust, armed=armed, gyro=gyro)])


def test_the_start_of_a_flight_is_marked_invalid() -> None:
    spec = GateSpec(min_thrust=0.1, trim_start_s=0.3)
    out = spec.step(spec.start(), block(hop()))
    first = out[0]
    assert isinstance(first, Block)
    assert not first.valid[:300].any()
    assert first.valid[300:].all()
    assert first.settled_ns == DT_NS * 1000  # no sooner than a second after the data began


def test_nothing_is_judged_while_disarmed() -> None:
    armed = np.zeros(100)
    armed[40:] = 1.0
    assert spans(GateSpec(need_armed=True), [block(np.full(100, 0.5), armed=armed)]) == [(0, 40, 99)]


def test_a_signal_that_is_never_sent_passes() -> None:
    thrust = np.full(100, np.nan)
    assert spans(GateSpec(min_thrust=0.1, min_height_m=0.4), [block(thrust)]) == [(0, 0, 99)]


def test_a_break_in_the_data_ends_the_flight() -> None:
    up = np.full(100, 0.5)
    assert spans(GateSpec(min_thrust=0.1), [block(up), block(up, first=5000, segment=1)]) == [
        (0, 0, 99),
        (99,),
        (1, 5000, 5099),
    ]


def test_b3_a_border_follows_a_landing_and_none_the_ground_or_the_end_of_a_log() -> None:
    spec = GateSpec(min_thrust=0.1)
    ground, up = np.zeros(100), np.full(100, 0.5)
    assert spans(spec, [block(ground), block(ground, first=5000, segment=1)]) == []
    assert spans(spec, [block(up)]) == [(0, 0, 99)]
    assert spans(spec, [block(up), block(np.zeros(2000), first=100)]) == [(0, 0, 99), (99,)]


def test_a_signal_that_is_unknown_for_a_while_passes() -> None:
    thrust = np.r_[np.full(50, 0.5), np.full(50, np.nan)]
    assert spans(GateSpec(min_thrust=0.1), [block(thrust)]) == [(0, 0, 99)]


def test_without_a_thrust_set_point_outputs_that_all_idle_are_no_flight() -> None:
    unknown = np.full(6, np.nan)
    outputs = np.array([[0.0, 0.1], [0.15, 0.1], [0.15, 0.2], [0.4, 0.4], [np.nan, 0.1], [0.0, 0.0]])
    spec = GateSpec(min_thrust=0.1, need_armed=False)
    flies = spec.flying(dataclasses.replace(block(unknown), actuator=outputs))
    assert flies.tolist() == [False, False, True, True, True, False]
    known = dataclasses.replace(block(np.full(6, 0.5)), actuator=outputs)
    assert spec.flying(known).all()  # the set-point goes before the outputs
    assert GateSpec(need_armed=False).flying(dataclasses.replace(block(unknown), actuator=outputs)).all()
