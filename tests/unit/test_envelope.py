"""Conditions of flight by their definitions; the envelope of them: inside, near, outside; a chain that judges by it."""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flying_telemetry import flying
from hypothesis import given
from hypothesis import strategies as st
from made_baselines import FRAME, NOW, healthy, logged

from mavdiag.as_json import verdict_json
from mavdiag.baseline import Baseline
from mavdiag.errors import InputError
from mavdiag.judging import LogVerdict, Verdict, judge
from mavdiag.kernel import Kernel, Outside, Slot
from mavdiag.learning import LearnOptions, learn
from mavdiag.monitors.conditions import Conditions, covered_by, measure
from mavdiag.monitors.control_loss import ControlLoss, ControlLossSpec
from mavdiag.rows.block import Block
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray
from mavdiag.testing import WINDOW, changed, example_rows
from mavdiag.thresholds.envelope import ORDER, RULES, Covered, excess_of, limits_of

BIN_NS = 100_000_000


def made_block(n: int, dt_s: float, seed: int) -> Block:
    """A flight of n rows that moves in every condition; it begins beside the borders of the bins."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0.0, 0.1, (n, 6)), axis=0) * math.sqrt(dt_s)
    block = example_rows(
        n,
        dt_s,
        setpoint=walk[:, :3],
        rate=rng.normal(0.0, 0.2, (n, 3)),
        thrust=0.5 + 0.01 * rng.normal(size=n),
    ).block
    t_ns = block.t_ns + 1_000_037_000_000
    return changed(replace(block, t_ns=t_ns), height=1.0 + walk[:, 3])


def spoilt(block: Block, seed: int) -> Block:
    """The same with spans in which the gyro, the set-point and slow signals are not known."""
    rng = np.random.default_rng([seed, 1])
    n = len(block)
    flags, slow = np.ones((2, n), dtype=np.bool_), [block.thrust.copy(), block.height.copy()]
    for part in (*flags, *slow):
        first = int(rng.integers(0, n))
        part[first : first + int(rng.integers(1, n // 5 + 2))] = 0 if part.dtype == np.bool_ else np.nan
    return changed(block, valid=flags[0], setpoint_valid=flags[1], thrust=slow[0], height=slow[1])


def rows_of(block: Block, edges: Sequence[int] = ()) -> list[Rows]:
    """The block in pieces, with the rates that each completes."""
    spec = RateSpec.of(block.dt_s, WINDOW)
    state, out = spec.start(), []
    for low, high in itertools.pairwise(sorted({0, len(block), *edges})):
        piece = block.rows(low, high)
        out.append(spec.step(state, piece))
    return out


def measured(rows: Sequence[Rows]) -> Conditions:
    """All bins of the rows."""
    parts = list(measure(rows))
    return Conditions(np.concatenate([b.end_ns for b in parts]), np.concatenate([b.values for b in parts]))


def column(found: Conditions, condition: Condition) -> FloatArray:
    """The values of one condition."""
    return found.values[:, list(Condition).index(condition)]


class Ones(ControlLoss):
    """A monitor whose value is 1 where the body rolls at 1 rad/s without a command, and that depends on conditions."""

    def __init__(self, depends: Iterable[Condition], memory_s: float, unit: str = "rad/s") -> None:
        super().__init__(ControlLossSpec())
        self.depends, self.unit, self.memory_s = frozenset(depends), unit, memory_s  # type: ignore[misc]


def ones_judged(
    covered: Sequence[Covered], rows: Sequence[Rows], monitor: Ones
) -> tuple[Statistic, dict[Condition, Outside]]:
    """What the envelope makes of the ones, and what it does not let judge."""
    kernel = Kernel((Slot(monitor, 9.0, True),), tuple(covered), rows[0].block.dt_s, 2 * rows[0].block.dt_s)
    memory, parts = kernel.start(), list[Statistic]()
    for one in rows:
        parts.append(kernel.step(memory, one)[1].found[0])
    names = ("t_ns", "value", "valid", "level", "signal", "rotors")
    joined = {name: np.concatenate([getattr(one, name) for one in parts]) for name in names}
    return Statistic(period_s=parts[0].period_s, **joined), kernel.accounts(memory)[0].outside


def slowly(block: Block) -> tuple[list[int], dict[Condition, list[float]]]:
    """Ends of the bins and the conditions in them, one bin after the other, from their definitions."""
    (rows,) = rows_of(block)
    rates = rows.rates
    bins = sorted({int(t) // BIN_NS for t in rates.t_ns.tolist()})
    bins = [k for k in bins if (k + 1) * BIN_NS <= int(rates.t_ns[-1]) // BIN_NS * BIN_NS]
    out: dict[Condition, list[float]] = {condition: [] for condition in Condition}
    tilts: list[tuple[float, float]] = []
    slopes: list[float] = []
    before: dict[str, float] = {}
    for k in bins:
        inside = [i for i, t in enumerate(block.t_ns.tolist()) if t // BIN_NS == k and block.valid[i]]
        aimed = [i for i in inside if block.setpoint_valid[i]]
        turned = [i for i, t in enumerate(rates.t_ns.tolist()) if t // BIN_NS == k]
        known = [i for i in turned if rates.commanded[i]]
        tilts.append((_mean([block.setpoint[i, 0] for i in aimed]), _mean([block.setpoint[i, 1] for i in aimed])))
        out[Condition.TILT].append(
            math.hypot(*(sum(one[axis] for one in tilts[-50:]) / 50 for axis in (0, 1)))
            if len(tilts) >= 50
            else math.nan
        )
        out[Condition.THROTTLE].append(_mean([block.thrust[i] for i in inside]))
        out[Condition.COMMANDED_RATE].append(
            max((max(abs(rates.u[i, 0]), abs(rates.u[i, 1])) for i in known), default=math.nan)
        )
        heights = [block.height[i] for i in inside if math.isfinite(block.height[i])]
        out[Condition.HEIGHT].append(min(heights, default=math.nan))
        last, end = turned[-1], max(i for i, t in enumerate(block.t_ns.tolist()) if t // BIN_NS == k)
        now = {
            "roll": rates.u[last, 0] if rates.commanded[last] else math.nan,
            "pitch": rates.u[last, 1] if rates.commanded[last] else math.nan,
            "yaw": block.setpoint[end, 2] if block.valid[end] and block.setpoint_valid[end] else math.nan,
        }
        step = {name: abs(now[name] - before.get(name, math.nan)) / 0.1 for name in now}
        accelerations = [one for one in (step["roll"], step["pitch"]) if math.isfinite(one)]
        out[Condition.COMMANDED_ACCELERATION].append(max(accelerations, default=math.nan))
        slopes.append(step["yaw"])
        commanded = max((one for one in slopes[-20:] if math.isfinite(one)), default=math.inf)
        turn = abs(_mean([block.rate[i, 2] for i in inside]))
        out[Condition.YAW_RATE].append(min(turn, commanded))
        before = now
    return [(k + 1) * BIN_NS for k in bins], out


def _mean(values: Sequence[float]) -> float:
    finite = [float(x) for x in values if math.isfinite(x)]
    return math.fsum(finite) / len(finite) if finite else math.nan


RATES_HZ = (10, 12.5, 20, 33, 50, 100, 400, 1000)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("broken", [False, True])
def test_every_condition_is_what_its_definition_says(rate_hz: float, broken: bool) -> None:
    block = made_block(round(9 * rate_hz), 1 / rate_hz, seed=round(rate_hz))
    block = spoilt(block, seed=3) if broken else block
    found, (ends, expected) = measured(rows_of(block)), slowly(block)
    assert found.end_ns.tolist() == ends
    assert len(ends) > 70
    for condition in Condition:
        values = column(found, condition)
        np.testing.assert_allclose(values, expected[condition], rtol=1e-9, atol=1e-12, err_msg=condition)
        assert np.isfinite(values).any(), condition


def test_after_a_step_of_the_heading_the_gyro_tells_for_two_seconds() -> None:
    step = np.zeros((800, 3))
    step[405:, 2] = 1.5  # 15 rad/s in the bin that ends at 4.1 s
    block = example_rows(800, 0.01, setpoint=step, rate=np.tile([0.0, 0.0, -0.8], (800, 1))).block
    found = column(measured(rows_of(block)), Condition.YAW_RATE)
    np.testing.assert_allclose(found[40:60], 0.8)
    np.testing.assert_array_equal(found[60:], 0.0)
    np.testing.assert_array_equal(found[1:40], 0.0)


N = 900
PERIODS_S = (0.0025, 0.01, 0.02, 0.05, 0.1)
NARROW = tuple(
    Covered(condition, low, high)
    for condition, low, high in (
        (Condition.TILT, 0.0, 0.05),
        (Condition.THROTTLE, 0.49, 0.51),
        (Condition.COMMANDED_RATE, 0.0, 0.3),
        (Condition.YAW_RATE, 0.0, 0.2),
        (Condition.HEIGHT, 1.0, 2.0),
    )
)

cuts = st.lists(st.integers(1, N - 1), max_size=40)


@given(seed=st.integers(0, 50), edges=cuts, dt_s=st.sampled_from(PERIODS_S), broken=st.booleans())
def test_any_cut_gives_exactly_the_same_bins(seed: int, edges: list[int], dt_s: float, broken: bool) -> None:
    block = made_block(N, dt_s, seed)
    block = spoilt(block, seed) if broken else block
    expected, found = measured(rows_of(block)), measured(rows_of(block, edges))
    assert len(expected.end_ns) > 10
    np.testing.assert_array_equal(found.end_ns, expected.end_ns)
    np.testing.assert_array_equal(found.values, expected.values)


@given(seed=st.integers(0, 50), edges=cuts, dt_s=st.sampled_from(PERIODS_S), memory_s=st.sampled_from([0.5, 1.0, 5.0]))
def test_any_cut_gives_the_same_limits(seed: int, edges: list[int], dt_s: float, memory_s: float) -> None:
    """The factor near the envelope, what is outside, and for how long."""
    block = made_block(N, dt_s, seed)
    for conditions in (set(Condition), {Condition.YAW_RATE}):
        monitor = Ones(conditions, memory_s)
        (expected, outside), (found, other) = (ones_judged(NARROW, rows_of(block, cut), monitor) for cut in ([], edges))
        for name in ("t_ns", "value", "valid"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
        assert other == outside
    assert ones_judged(NARROW, rows_of(block), Ones(Condition, memory_s))[1], "some of it must be outside"


YAW = Covered(Condition.YAW_RATE, 0.0, 0.4)  # near up to 0.6: its room is a half
TURN_S = 20.0


def excess(covered: Covered, *values: float) -> list[float]:
    """e of values of a condition."""
    limits, number = limits_of([covered]), ORDER.index(covered.condition)
    return [excess_of(value, limits, number) for value in values]


@pytest.mark.parametrize(
    ("covered", "values", "expected"),
    [
        (YAW, [0.0, 0.4, 0.5, 0.6, 0.8], [0.0, 0.0, 0.5, 1.0, 2.0]),
        (Covered(Condition.COMMANDED_RATE, 0.0, 1.0), [1.0, 1.5, 2.0, 3.0], [0.0, 0.5, 1.0, 2.0]),
        (Covered(Condition.HEIGHT, 0.4, 9.0), [20.0, 0.4, 0.3, 0.2, 0.0], [0.0, 0.0, 0.5, 1.0, 2.0]),
        (
            Covered(Condition.THROTTLE, 0.2, 0.6),
            [0.2, 0.6, 0.7, 0.8, 0.1, 0.0, -0.2],
            [0, 0, 0.5, 1.0, 0.5, 1.0, 2],
        ),
    ],
    ids=["upper", "with a room of its own", "lower", "both"],
)
def test_each_side_is_limited_as_its_rule_says(covered: Covered, values: list[float], expected: list[float]) -> None:
    np.testing.assert_allclose(excess(covered, *values), expected, atol=1e-12)


def test_what_counts_as_nothing_is_covered_anyway() -> None:
    still = Covered(Condition.YAW_RATE, 0.0, 0.01)
    assert excess(still, 0.15, 0.225) == pytest.approx([0.0, 1.0])
    high = Covered(Condition.HEIGHT, 3.0, 9.0)
    assert excess(high, 0.5, 0.0) == pytest.approx([0.0, 2.0])
    full = Covered(Condition.THROTTLE, 0.4, 0.4)  # 25 % about it, and room for as much as the half of the span again
    assert excess(full, 0.3, 0.5, 0.2) == pytest.approx([0.0, 0.0, 1.0])


@pytest.mark.parametrize(("low", "high"), [(1.0, 0.5), (np.nan, 1.0), (0.0, np.inf)])
def test_what_is_no_span_is_refused(low: float, high: float) -> None:
    with pytest.raises(InputError, match="envelope: yaw rate from"):
        Covered(Condition.YAW_RATE, low, high)


@pytest.mark.parametrize(
    ("covered", "value", "sentence"),
    [
        (Covered(Condition.YAW_RATE, 0.0, 0.3), 1.81, "yaw rate 1.8 rad/s, learnt up to 0.3"),
        (Covered(Condition.HEIGHT, 0.4, 5.0), 0.05, "height 0.05 m, learnt from 0.4"),
        (Covered(Condition.THROTTLE, 0.3, 0.7), 0.98, "throttle 0.98, learnt 0.3 to 0.7"),
        (Covered(Condition.COMMANDED_ACCELERATION, 0.0, 84.2), 213.4,
         "commanded angular acceleration 213 rad/s^2, learnt up to 84"),
    ],
)  # fmt: skip
def test_the_sentence_says_what_was_flown_and_what_was_learnt(covered: Covered, value: float, sentence: str) -> None:
    assert covered.sentence(value) == sentence


def test_it_says_what_to_fly_where_the_flights_covered_nothing() -> None:
    assert Covered(Condition.YAW_RATE, 0.0, 0.1).advice() == "turn the nose, steadily and along the path"
    assert Covered(Condition.YAW_RATE, 0.0, 0.4).advice() is None
    assert Covered(Condition.TILT, 0.0, 0.2).advice() == "fly in steady wind"
    assert Covered(Condition.THROTTLE, 0.45, 0.5).advice() == "fly with payload, and with a battery that empties"
    assert Covered(Condition.THROTTLE, 0.3, 0.6).advice() is None
    assert Covered(Condition.HEIGHT, 3.0, 9.0).advice() is None  # to fly low is nobody's wish
    assert str(Covered(Condition.YAW_RATE, 0.0, 0.4)) == "yaw rate up to 0.4 rad/s"


def test_the_span_is_that_of_all_flights_and_of_what_they_carry() -> None:
    flights = [rows_of(made_block(900, 0.01, seed), [333]) for seed in (1, 2)]
    covered = {one.condition: one for one in covered_by(flights)}
    assert set(covered) == set(Condition)
    for condition, one in covered.items():
        values = np.concatenate([column(measured(flight), condition) for flight in flights])
        assert (one.low, one.high) == (np.nanmin(values), np.nanmax(values))
    bare = {one.condition for one in covered_by([rows_of(example_rows(900, 0.01).block)])}
    assert bare == set(Condition) - {Condition.THROTTLE, Condition.HEIGHT}
    assert covered_by([]) == ()


def test_21_one_wrong_sample_does_not_widen_what_is_covered() -> None:
    nose = np.zeros((900, 3))
    nose[:, 2] = 0.002 * np.arange(900)
    wrong = nose.copy()
    wrong[400, 2] += 3.0
    spans = [covered_by([rows_of(example_rows(900, 0.01, setpoint=one).block)]) for one in (nose, wrong)]
    highest = [next(one.high for one in span if one.condition is Condition.YAW_RATE) for span in spans]
    assert highest[1] == pytest.approx(highest[0], abs=0.01)


def test_21_a_time_is_not_scaled_like_an_amplitude() -> None:
    """Near what was learnt an amplitude counts less by as much; a time counts as it is."""
    for unit, value in (("rad/s", 0.8), ("s", 1.0)):
        found, _ = ones_judged([YAW], turned(np.full(600, 0.5)), Ones({Condition.YAW_RATE}, 1.0, unit=unit))
        assert found.valid[-1]
        assert found.value[-1] == pytest.approx(value)


def test_a_new_segment_does_not_go_on_from_the_old_one() -> None:
    """Else the step from one heading to another would be a turn."""
    north, south = np.zeros((300, 3)), np.tile([0.0, 0.0, 3.0], (300, 1))
    flight = [example_rows(300, setpoint=north), example_rows(300, segment=1, setpoint=south)]
    (yaw,) = (one for one in covered_by([flight]) if one.condition is Condition.YAW_RATE)
    assert yaw.high == 0.0


def test_a_step_of_the_commanded_heading_covers_the_rate_of_the_nose_and_not_its_own_slope() -> None:
    """A step of 1.5 rad within a row, which the vehicle follows in 1 s: PX4 in offboard flies so."""
    heading, rate = np.zeros((1500, 3)), np.zeros((1500, 3))
    for first in (500, 900):
        heading[first:, 2] += 1.5
        rate[first + 5 : first + 105, 2] = 1.5
    (yaw,) = (
        one
        for one in covered_by([rows_of(example_rows(1500, 0.01, setpoint=heading, rate=rate).block)])
        if one.condition is Condition.YAW_RATE
    )
    assert yaw.high == pytest.approx(1.5)


def turned(yaw_rate: FloatArray) -> list[Rows]:
    """Rows at 100 Hz of a nose that turns, and of a body that rolls at 1 rad/s without a command."""
    nose, rate = np.zeros((len(yaw_rate), 3)), np.zeros((len(yaw_rate), 3))
    nose[:, 2] = 0.01 * np.cumsum(yaw_rate)
    rate[:, 0], rate[:, 2] = 1.0, yaw_rate
    return rows_of(example_rows(len(yaw_rate), 0.01, setpoint=nose, rate=rate).block)


IN_TURNS = Ones({Condition.YAW_RATE}, 1.0)


@pytest.mark.parametrize("rate", [0.61, 1.8, 30.0])
def test_outside_nothing_is_judged_and_it_is_said(rate: float) -> None:
    found, outside = ones_judged([YAW], turned(np.full(400, rate)), IN_TURNS)
    assert not found.valid[100:].any()
    assert set(outside) == {Condition.YAW_RATE}
    told = outside[Condition.YAW_RATE]
    assert told.value == pytest.approx(rate)
    assert told.span_s == pytest.approx(0.01 * np.count_nonzero(~found.valid))


@pytest.mark.parametrize("memory_s", [0.35, 1.0, 10.0])
@pytest.mark.parametrize("wild", [0.3, 3.0])
def test_each_value_counts_by_the_farthest_bin_behind_it(memory_s: float, wild: float) -> None:
    """Value by value, as the module's text says."""
    rng = np.random.default_rng(round(wild + memory_s))
    turns: FloatArray = np.repeat(wild * rng.random(40) * (rng.random(40) < 0.2), 30)
    flight = turned(turns)
    covered = [YAW, Covered(Condition.TILT, 0.0, 0.3), Covered(Condition.COMMANDED_RATE, 0.0, 0.01)]
    found, reasons = ones_judged(covered, flight, Ones({Condition.YAW_RATE, Condition.HEIGHT}, memory_s))
    bins, outside, delay_ns = measured(flight), 0, 20_000_000 + 100_000_000
    for t, value, level, valid in zip(found.t_ns.tolist(), found.value, found.level, found.valid, strict=True):
        behind = (bins.end_ns > t - round(memory_s * 1e9)) & (bins.end_ns <= t - delay_ns)
        far = max(excess(YAW, *column(bins, Condition.YAW_RATE)[behind].tolist()), default=0.0)
        assert value == pytest.approx(level / (1.0 + RULES[Condition.YAW_RATE].room * min(far, 1.0)))
        assert valid == (far <= 1.0)
        outside += far > 1.0
    assert sum(one.span_s for one in reasons.values()) == pytest.approx(0.01 * outside)


@cache
def straight() -> Baseline:
    """Learnt from flights that hardly turn the nose."""
    options = LearnOptions(airframe=FRAME, monitors=("fsd", "innovation", "rotor_signature", "rotor_trim", "trim_step"))
    return learn(healthy(3), options, created=NOW)


def flight(seed: int, turn: float, weak_rotor: int = 0) -> LogVerdict:
    """The verdict on 50 s; the nose begins to turn after 20 s, and gets to `turn` [rad/s] within 2 s."""
    at_s = 0.01 * np.arange(5000) - TURN_S
    made = flying(5000, seed, turn=np.clip(0.5 * turn * at_s, 0.0, turn), weak_rotor=weak_rotor, rise=0.3)
    return judge(logged(made), straight())


@pytest.mark.parametrize("seed", range(60, 64))
def test_a_turn_that_was_not_learnt_is_not_judged_and_never_an_alarm(seed: int) -> None:
    found = flight(seed, 1.8)
    # The turn is most of the flight. Its beginning may come near a threshold, and passes none.
    assert found.verdict in (Verdict.NOT_JUDGEABLE, Verdict.SUSPECTED), found.reason
    assert not found.events
    assert " (4" in found.reason
    assert found.events == ()
    for name, told in verdict_json(found)["monitors"].items():
        assert told["not_judged"].startswith("yaw rate "), name
        assert told["not_judged"].endswith(" rad/s, learnt up to 0.41"), name
        assert 26 < told["outside_s"] < 31, name
        assert told["outside_s"] + told["judged_s"] < 50, name


@pytest.mark.parametrize("seed", range(60, 64))
def test_without_the_envelope_the_same_turn_is_an_alarm(seed: int) -> None:
    bare = straight().model_copy(update={"envelope": ()})
    at_s = 0.01 * np.arange(5000) - TURN_S
    turning = logged(flying(5000, seed, turn=np.clip(0.9 * at_s, 0.0, 1.8)))
    assert judge(turning, bare).verdict is Verdict.FAULT
    told = verdict_json(judge(turning, bare))["monitors"]
    assert {one["outside_s"] for one in told.values()} == {0.0}


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_damaged_rotor_inside_the_envelope_is_found_and_named(rotor: int) -> None:
    found = flight(70 + rotor, 0.0, weak_rotor=rotor)
    assert found.verdict is Verdict.FAULT
    assert f"rotor {rotor}" in found.reason
    assert {one.outside_s for one in found.monitors} == {0.0}


def test_a_link_that_carries_no_heading_and_no_height_is_judged_all_the_same() -> None:
    """A condition of the baseline that the link does not tell now restricts nothing."""
    high = (*straight().envelope, Covered(Condition.HEIGHT, 0.4, 3.0))
    found = judge(logged(flying(3000, 80)), straight().model_copy(update={"envelope": high}))
    assert found.verdict is Verdict.HEALTHY
    assert {one.outside_s for one in found.monitors} == {0.0}
