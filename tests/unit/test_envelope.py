"""Conditions of flight by their definitions; the envelope of them: inside, near, outside; a chain that judges by it."""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flying_telemetry import flying
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

YAW = Covered(Condition.YAW_RATE, 0.0, 0.4)  # near up to 0.6: its room is a half
TURN_S = 20.0


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


def rows_of(block: Block, edges: Sequence[int] = ()) -> list[Rows]:
    spec = RateSpec.of(block.dt_s, WINDOW)
    state, out = spec.start(), []
    for low, high in itertools.pairwise(sorted({0, len(block), *edges})):
        piece = block.rows(low, high)
        out.append(spec.step(state, piece))
    return out


def measured(rows: Sequence[Rows]) -> Conditions:
    parts = list(measure(rows))
    return Conditions(np.concatenate([b.end_ns for b in parts]), np.concatenate([b.values for b in parts]))


def column(found: Conditions, condition: Condition) -> FloatArray:
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


def test_the_conditions_of_a_steady_flight_are_those_that_were_flown() -> None:
    """Leaning by 0.3 rad, a roll command of 0.4 rad/s that alternates, the nose at 0.5 rad/s, throttle up and low."""
    n, dt_s = 2000, 0.01
    t_s = dt_s * np.arange(n)
    triangle = 0.4 * (1.0 - np.abs(t_s % 2.0 - 1.0))  # slopes of 0.4 rad/s to and fro
    setpoint = np.column_stack((triangle - 0.2, np.full(n, 0.3), 0.5 * t_s))
    block = example_rows(
        n, dt_s, setpoint=setpoint, rate=np.tile([0.0, 0.0, 0.5], (n, 1)), thrust=np.full(n, 0.6)
    ).block
    found = measured(rows_of(changed(block, height=np.where(np.arange(n) % 10 == 3, 1.0, 2.0))))
    assert np.unique(np.diff(found.end_ns)).tolist() == [100_000_000]
    settled = found.values[60:]  # the tilt is a mean over 5 s
    for condition, value, tolerance in (
        (Condition.TILT, 0.3, 0.01),
        (Condition.THROTTLE, 0.6, 1e-9),
        (Condition.YAW_RATE, 0.5, 1e-6),
        (Condition.HEIGHT, 1.0, 0.0),
    ):
        np.testing.assert_allclose(settled[:, list(Condition).index(condition)], value, atol=tolerance)
    turn = 0.5 * math.sin(0.3)  # what the turning nose is of the roll rate
    commanded = settled[:, list(Condition).index(Condition.COMMANDED_RATE)]
    assert commanded.max() == pytest.approx(0.4 + turn, rel=0.02)
    accelerated = settled[:, list(Condition).index(Condition.COMMANDED_ACCELERATION)]
    assert np.median(accelerated) == pytest.approx(0.5 * math.cos(0.3) * 0.4, rel=0.02)  # of the pitch, as it rolls
    assert 4.0 < accelerated.max() < 0.8 / 0.1  # where the roll command turns round


def test_after_a_step_of_the_heading_the_gyro_tells_for_two_seconds() -> None:
    step = np.zeros((800, 3))
    step[405:, 2] = 1.5  # 15 rad/s in the bin that ends at 4.1 s
    block = example_rows(800, 0.01, setpoint=step, rate=np.tile([0.0, 0.0, -0.8], (800, 1))).block
    found = column(measured(rows_of(block)), Condition.YAW_RATE)
    np.testing.assert_allclose(found[40:60], 0.8)
    np.testing.assert_array_equal(found[60:], 0.0)
    np.testing.assert_array_equal(found[1:40], 0.0)


def excess(covered: Covered, *values: float) -> list[float]:
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


def test_a_link_that_carries_no_heading_and_no_height_is_judged_all_the_same() -> None:
    """A condition of the baseline that the link does not tell now restricts nothing."""
    high = (*straight().envelope, Covered(Condition.HEIGHT, 0.4, 3.0))
    found = judge(logged(flying(3000, 80)), straight().model_copy(update={"envelope": high}))
    assert found.verdict is Verdict.HEALTHY
    assert {one.outside_s for one in found.monitors} == {0.0}
