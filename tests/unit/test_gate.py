"""The gate: spans of flight, their trims, and what passes for lack of a signal."""

import dataclasses

import numpy as np
import pytest
from made_telemetry import DT_NS

from mavdiag.rows.block import Block
from mavdiag.rows.gate import Border, GateSpec
from mavdiag.telemetry import FloatArray


def block(thrust: FloatArray, *, armed: FloatArray | None = None, first: int = 0, segment: int = 0) -> Block:
    n = len(thrust)
    none3, none = np.full((n, 3), np.nan), np.full(n, np.nan)
    return Block(
        segment=segment,
        dt_s=0.001,
        t_ns=DT_NS * np.arange(first, first + n, dtype=np.int64),
        setpoint=none3,
        rate=none3,
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
    )


def spans(spec: GateSpec, blocks: list[Block]) -> list[tuple[int, ...]]:
    """(segment, first row, last row) of what comes out, neighbouring pieces joined, and (row,) of each border."""
    state, out = spec.step(spec.start(), tuple(blocks))
    _, rest = spec.finish(state)
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
    """On the ground, 1000 rows in the air, down, 1000 rows in the air, down."""
    thrust = np.zeros(4000)
    thrust[500:1500] = thrust[2000:3000] = 0.5
    return thrust


def test_each_flight_is_a_segment_of_its_own() -> None:
    assert spans(GateSpec(min_thrust=0.1), [block(hop())]) == [
        (0, 500, 1499),
        (1499,),
        (1, 2000, 2999),
        (2999,),
    ]


@pytest.mark.parametrize("size", [1, 7, 333, 4000])
def test_chunks_do_not_matter(size: int) -> None:
    thrust = hop()
    blocks = [block(thrust[i : i + size], first=i) for i in range(0, 4000, size)]
    spec = GateSpec(min_thrust=0.1, trim_end_s=0.2)
    assert spans(spec, blocks) == [(0, 500, 1299), (1499,), (1, 2000, 2799), (2999,)]


def test_the_start_of_a_flight_is_marked_invalid() -> None:
    spec = GateSpec(min_thrust=0.1, trim_start_s=0.3)
    _, out = spec.step(spec.start(), (block(hop()),))
    first = out[0]
    assert isinstance(first, Block)
    assert not first.valid[:300].any()
    assert first.valid[300:].all()


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
    assert spans(spec, [block(up), block(ground, first=100)]) == [(0, 0, 99), (99,)]


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
