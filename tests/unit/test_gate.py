"""The gate: spans of flight, their trims, and what passes for lack of a signal."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_telemetry import DT_NS

from mavdiag.rows.block import Block
from mavdiag.rows.gate import Border, GateSpec
from mavdiag.telemetry import FloatArray
from mavdiag.testing import changed, example_rows


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
    rate = np.outer(np.zeros(n) if gyro is None else gyro, [1.0, 0.0, 0.0])
    rows = example_rows(n, 0.001, segment=segment, thrust=thrust, rate=rate).block
    t_ns = DT_NS * np.arange(first, first + n, dtype=np.int64)
    return changed(dataclasses.replace(rows, t_ns=t_ns), armed=np.full(n, np.nan) if armed is None else armed)


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


def tumble(n: int) -> FloatArray:
    """(n,) roll rate of a vehicle that tumbles [rad/s]."""
    return 9.0 + 8.0 * np.sin(np.arange(n) / 50)


def levels(*pairs: tuple[int, float]) -> FloatArray:
    return np.concatenate([np.full(n, value) for n, value in pairs])


THRUST = GateSpec(min_thrust=0.1)
TRIMMED = GateSpec(min_thrust=0.1, trim_start_s=0.3, trim_end_s=0.2)
DROP = levels((1000, 0.5), (3000, 0.0))  # thrust of a landing, or of a vehicle that tumbles
DIP = levels((1000, 0.5), (900, 0.0), (600, 0.5), (900, 0.0), (600, 0.5))
SPIKE, TWO_SAMPLES, UP = np.zeros(4000), np.zeros(4000), np.full(1000, 0.5)
SPIKE[1300:1800], TWO_SAMPLES[[1700, 2600]] = 11.0, 30.0
CASES = {
    "each flight is a segment of its own": (
        THRUST,
        [block(hop())],
        [(0, 500, 1499), (1499,), (1, 3000, 3999), (3999,)],
    ),
    "a dip of thrust is no landing": (THRUST, [block(DIP)], [(0, 0, 3999)]),
    "nor is one in a tumble": (THRUST, [block(DIP, gyro=tumble(4000))], [(0, 0, 3999)]),
    "the spike of a touch-down is not judged": (THRUST, [block(DROP, gyro=SPIKE)], [(0, 0, 999), (999,)]),
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
    armed = made([4000, 300], [1.0, 1.0, 1.0, 0.0])
    bounds = [0, *sorted(set(edges)), 12_000]
    parts = [block(thrust[a:b], armed=armed[a:b], gyro=gyro[a:b], first=a) for a, b in itertools.pairwise(bounds)]
    assert spans(TRIMMED, parts) == spans(TRIMMED, [block(thrust, armed=armed, gyro=gyro)])


@pytest.mark.parametrize(("thrust", "flies"), [(np.nan, [False, False, True, True, True, False]), (0.5, [True] * 6)])
def test_without_a_thrust_set_point_outputs_that_all_idle_are_no_flight(thrust: float, flies: list[bool]) -> None:
    outputs = np.array([[0.0, 0.1], [0.15, 0.1], [0.15, 0.2], [0.4, 0.4], [np.nan, 0.1], [0.0, 0.0]])
    for row, expected in zip(outputs, flies, strict=True):
        many = changed(block(np.full(100, thrust)), actuator=np.tile(row, (100, 1)))
        assert bool(spans(THRUST, [many])) == expected
        assert spans(GateSpec(), [many]) == [(0, 0, 99)]
