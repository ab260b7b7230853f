"""Verdicts on logs: a fault, healthy by whom, not judgeable why; and the envelope of conditions that is judged."""

import itertools
import math
import re
import tracemalloc
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flying_telemetry import flying, without
from made_baselines import FRAME, NOW, healthy, logged, plain, thesis, trim, whole
from made_rows import WINDOW, example_rows
from made_rows import changed as with_columns
from made_statistics import assert_alike
from made_telemetry import START_NS, changed, flight
from scipy.signal import lfilter

from mavdiag.as_json import verdict_json
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import Stage
from mavdiag.errors import InputError
from mavdiag.judging import JudgedFlight, LogVerdict, Verdict, exit_code, judge, judge_in_full
from mavdiag.kernel import Kernel, Outside, Slot
from mavdiag.learning import LearnOptions, learn
from mavdiag.logs import between
from mavdiag.monitors.base import FaultKind
from mavdiag.monitors.conditions import Conditions, covered_by, measure
from mavdiag.monitors.control_loss import ControlLoss, ControlLossSpec
from mavdiag.monitors.run_length import RunLength
from mavdiag.rows.block import Block
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, FloatArray, Series, Signal, Telemetry
from mavdiag.thresholds.envelope import ORDER, RULES, Covered, excess_of, limits_of
from mavdiag.traces import rate_traces
from mavdiag.units import NS_PER_S

ALL = (0.0, 1e9)


@cache
def pushed() -> JudgedFlight:
    """By the thesis's monitor; a push of 0.3 rad/s begins after 5 s."""
    push = np.where((np.arange(10_000) >= 5000) & (np.arange(10_000) < 5600), 0.3, 0.0)
    return judge_in_full(logged(flight(10_000, 50, push=push), "qdrone2"), thesis())


def test_a_push_is_a_fault_at_its_time_and_a_healthy_flight_is_not() -> None:
    verdict = pushed().verdict
    first = verdict.events[0]
    assert np.abs(np.array([first.t_s - 6.15, first.statistic - 0.6]) / (0.15, 0.12)).max() < 1.0
    assert verdict.reason.startswith("fsd on roll 0.")
    assert [one.stage for one in verdict.changes if one.stage is not Stage.SUSPECTED][:2] == [Stage.QUIET, Stage.FAULT]


@pytest.mark.parametrize(
    ("telemetry", "profile", "reason"),
    [
        (without(flight(8000, 1), ALL, signals=(Signal.BODY_RATE,)), "qdrone2", "no body rate"),
        (flight(8000, 1), "px4", "another link: link.profile"),
        (flight(900, 1), "qdrone2", "only 0.9 s of take-off or start"),
        (flight(1900, 1), "qdrone2", "too little flight: judged 0.8 s of 0.9 s (94 %) by fsd, "),
    ],
)
def test_what_cannot_be_judged_says_why(telemetry: Telemetry, profile: str, reason: str) -> None:
    verdict = judge(logged(telemetry, profile), thesis())
    assert verdict.verdict is Verdict.NOT_JUDGEABLE
    assert verdict.reason.startswith(reason)


def test_b1_what_no_deciding_monitor_judged_is_not_healthy() -> None:
    short = judge(logged(flying(450, 1)), trim())
    assert (short.verdict, short.judged_s) == (Verdict.NOT_JUDGEABLE, 0)
    assert short.reason == (
        "judged 0.0 s of 3.5 s (0 %), without 1.0 s of take-off or start: "
        "not judged by rotor_trim (waiting for enough unbroken flight)"
    )
    silent = judge(logged(without(flying(2000, 1), ALL, signals=(Signal.ACTUATOR,))), trim())
    told = silent.reason.partition(" of take-off or start: ")[2]
    assert (silent.verdict, told) == (Verdict.NOT_JUDGEABLE, "not judged by rotor_trim (no actuator)")


def test_b1_healthy_says_which_monitors_judged_for_how_long_and_which_did_not() -> None:
    verdict = judge(logged(without(flying(2500, 1), ALL, signals=(Signal.ACTUATOR,))), whole())
    assert verdict.reason.startswith("no alarm; judged 24.0 s of 24.0 s (100 %) by innovation, rotor_signature, ")
    assert "; not judged by rotor_trim (no actuator" in verdict.reason
    log = logged(without(flying(2500, 1), (9.0, 99.0), signals=(Signal.ACTUATOR,)))
    ceases, alone = judge(log, whole()).reason, judge(log, trim(), 0.1).reason
    assert re.search(r"; not judged by rotor_trim \(.*; it judged [1-9] s\)", ceases), ceases
    assert re.search(r"no alarm; .* start; nothing judged from [^(]* \(no actuator", alone), alone
    lost = without(flying(8000, 1), (5.0, 30.0), signals=(Signal.ATTITUDE_SETPOINT,))
    dead = judge(logged(changed(lost, Signal.BODY_RATE, lambda _: 0.0, 50.0, 62.0)), whole()).reason
    assert re.search(r"no alarm; .*; nothing judged from [^(]* \(gyro", dead), dead  # not "no attitude setpoint"
    assert " s of 2.0 s (98 %) by innovation, without " in judge(logged(flying(700, 1)), flown()).reason


def test_a_flight_after_its_clock_went_back_is_judged_as_one_behind() -> None:
    plain = flying(4000, 5)
    for back_ns in (5 * NS_PER_S, 40 * NS_PER_S):
        series = (replace(one, t_ns=one.t_ns - (one.t_ns >= 20 * NS_PER_S) * back_ns) for one in plain)
        first, found = judge(logged(plain), whole()), judge(logged(Telemetry(tuple(series))), whole())
        assert found.verdict is first.verdict
        assert found.judged_s == pytest.approx(first.judged_s - 1.0, abs=0.1)
        assert found.reason.endswith("; the vehicle's clock went back at 20.0 s; what follows was put behind")


def test_the_exit_code_is_that_of_the_gravest_verdict() -> None:
    healthy, fault, unknown, error = Verdict.HEALTHY, Verdict.FAULT, Verdict.NOT_JUDGEABLE, Verdict.ERROR
    assert (exit_code([healthy]), exit_code([healthy, unknown])) == (0, 3)
    assert exit_code([Verdict.SUSPECTED, unknown, healthy]) == 4
    assert (exit_code([unknown, Verdict.SUSPECTED, fault]), exit_code([fault, error, unknown])) == (1, 2)
    assert LogVerdict("x", error, "y").events == ()


@pytest.mark.parametrize("rows", [137, 1000, 10**6])
def test_the_pieces_that_a_log_is_judged_in_change_nothing(rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    log = logged(without(flying(4000, 5, weak_rotor=2, rise=0.2), (9.0, 9.08), (20.0, 21.4)))
    expected = judge_in_full(log, whole()).verdict
    assert expected.verdict is Verdict.FAULT
    monkeypatch.setattr("mavdiag.judging.PIECE_ROWS", rows)
    found = judge(log, whole())
    assert (found.verdict, found.reason, found.notes) == (expected.verdict, expected.reason, expected.notes)
    assert_alike(found.events, expected.events)
    assert_alike(found.changes, expected.changes)
    for one, other in zip(found.monitors, expected.monitors, strict=True):
        assert one.maximum == pytest.approx(other.maximum, rel=1e-9)
        assert one.judged_s == pytest.approx(other.judged_s)


@cache
def flown() -> Baseline:
    """All monitors that can work on `flying`, with the gate of a live link."""
    return learn(healthy(3), LearnOptions(airframe=replace(FRAME, gate=None)), created=NOW)


def tumbling() -> Telemetry:
    """A flight that tumbles at up to 18 rad/s from 30 s until its log ends, and whose thrust dips all the while."""
    n, start = 3400, 3000
    turn = 18.0 * np.sin(np.linspace(0.3, 40.0, n - start))[:, None] * [1.0, 0.6, 0.2] + [6.0, 6.0, 1.0]
    tumbled = changed(flying(n, 1), Signal.BODY_RATE, lambda _: turn, 30.0, 34.0)
    for from_s, to_s in ((30.2, 30.9), (31.3, 32.5), (33.0, 33.5), (33.7, 34.0)):
        tumbled = changed(tumbled, Signal.THRUST_SETPOINT, lambda _: 0.02, from_s, to_s)
    return tumbled


def test_f1_a_vehicle_that_tumbles_until_its_log_ends_is_no_healthy_one() -> None:
    shaken = changed(tumbling(), Signal.VIBRATION, lambda x: 3.0 * x, 12.0, 34.0)  # a propeller fault before
    verdict = judge(logged(shaken), flown())
    assert (verdict.verdict, verdict.kind) == (Verdict.FAULT, FaultKind.LOSS_OF_CONTROL)
    assert re.search("^loss of control: .*, first at 31.* the flight ends in an upset, at 3", verdict.reason)
    assert [verdict.since_s, verdict.flown_s] == pytest.approx([31.0, 34.0 - 5.0], abs=0.2)
    with pytest.raises(InputError, match="the flight ends in an upset, at 3"):
        learn([logged(tumbling())], LearnOptions(airframe=replace(FRAME, gate=None)), created=NOW)


def test_f1_an_upset_is_a_loss_of_control_where_no_monitor_saw_a_fault() -> None:
    force = np.random.default_rng(4).normal([0.0, 0.0, -0.5], 0.05, (200, 3))
    verdict = judge(logged(changed(flying(3000, 1), Signal.SPECIFIC_FORCE, lambda _: force, 28.0, 30.0)), trim())
    assert (verdict.verdict, verdict.kind) == (Verdict.FAULT, FaultKind.LOSS_OF_CONTROL)
    assert verdict.reason.startswith("loss of control: the flight ends in an upset, at 28.9 s: free fall")
    assert verdict.since_s == pytest.approx(28.9, abs=0.2)
    assert verdict_json(verdict)["kind"] == "loss of control"


def stopped(one: Series) -> Series:
    return replace(one, t_ns=np.minimum(one.t_ns, START_NS + 18 * NS_PER_S)) if one.signal == "body_rate" else one


SLOW = [(k / 10, k / 10 + 0.09) for k in range(180, 400)]
C1: dict[str, tuple[Callable[[Telemetry], Telemetry], str]] = {
    "the gyro ends": (lambda flight: without(flight, (18.0, 99.0), signals=(Signal.BODY_RATE,)), "no gyro from 19.0 s"),
    "it slows": (
        lambda one: without(one, *SLOW, signals=(Signal.BODY_RATE,)),
        "clock (waiting for enough unbroken flight)",
    ),
    "it keeps one stamp": (lambda flight: Telemetry(tuple(map(stopped, flight))), "no gyro from 19.0 s"),
    "thrust reads 0": (
        lambda flight: changed(flight, Signal.THRUST_SETPOINT, np.zeros_like, 18.0),
        "its thrust reads 0 while it flies from 19.0 s",
    ),
    "it reads disarmed": (
        lambda flight: changed(flight, Signal.ARMED, np.zeros_like, 18.0),
        "it reads disarmed while its thrust says that it flies from 19.0 s",
    ),
}


@pytest.mark.parametrize("case", C1)
def test_c1_a_flight_that_was_judged_in_part_is_not_healthy(case: str) -> None:
    change, reason = C1[case]
    verdict = judge(logged(change(flying(4000, 1))), flown())
    assert verdict.verdict is Verdict.NOT_JUDGEABLE
    assert verdict.reason.startswith("judged 1")
    assert reason in verdict.reason
    assert verdict.flown_s == pytest.approx(35.0, abs=1.1)
    assert 11.0 < verdict.judged_s < 14.1
    assert judge(logged(change(flying(4000, 1))), flown(), judged_share=0.3).verdict is Verdict.HEALTHY


def test_c1_a_landing_with_the_motors_off_is_no_hidden_flight() -> None:
    landed = flying(4000, 1)
    for signal, value in ((Signal.THRUST_SETPOINT, 0.0), (Signal.ACTUATOR, 0.05), (Signal.BODY_RATE, 0.001)):
        landed = changed(landed, signal, lambda _, value=value: value, 25.0)  # type: ignore[misc]  # one for each
        if signal is not Signal.THRUST_SETPOINT:  # carried by hand, then at rest
            verdict = judge(logged(landed), flown())
            assert (verdict.verdict, abs(verdict.flown_s - 20.0) <= 0.2) == (Verdict.HEALTHY, True)


def test_c3_alarms_of_monitors_that_do_not_decide_are_a_suspicion() -> None:
    base = learn(plain(3), LearnOptions(airframe=FRAME, monitors=("innovation", "fsd")), created=NOW)
    push = np.zeros(20_000)
    push[8000:11_000] = 0.2 * np.hanning(3000)
    verdict = judge(logged(flight(20_000, 50, push=push), "qdrone2"), base)
    assert (verdict.verdict, {one.monitor for one in verdict.events}) == (Verdict.SUSPECTED, {"fsd"})
    assert verdict.reason.startswith("1 alarm of fsd, which decides nothing alone, first at ")


def test_a_suspicion_names_the_monitor_that_is_suspected_and_not_the_highest_one() -> None:
    def told(name: str) -> LogVerdict:
        entries = [(one, 0.01 if one.spec.kind == name else 1.0) for one in whole().monitors]
        told = [one.model_copy(update={"threshold": replace(one.threshold, suspected=(s, s))}) for one, s in entries]
        return judge(logged(flying(3000, 8)), whole().model_copy(update={"monitors": tuple(told)}))

    for name in ("rotor_trim", "innovation"):
        verdict = told(name)
        (own,) = (one for one in verdict.monitors if one.name == name)
        assert verdict.verdict is Verdict.SUSPECTED
        assert verdict.reason.startswith(f"{name} came to {100 * own.ratio:.0f} % of its threshold, first at ")


def ground_first(telemetry: Telemetry, span_s: float) -> Telemetry:
    """The flight after so long on the ground: hardly any noise of the gyro, its motors at idle, and no thrust."""
    shift, parts = round(span_s * NS_PER_S), []
    for one in telemetry.series:
        if one.signal is Signal.THRUST_SETPOINT:
            continue
        before = one.t_ns - one.t_ns[0] < shift
        quiet = {Signal.BODY_RATE: 0.015, Signal.SPECIFIC_FORCE: 0.02, Signal.TORQUE_COMMAND: 0.0}.get(one.signal, 1.0)
        rest = one.values[before].mean(axis=0) + quiet * (one.values[before] - one.values[before].mean(axis=0))
        if one.signal is Signal.ACTUATOR:
            rest[:] = 0.12
        stamps = np.concatenate((one.t_ns[before], one.t_ns + shift))
        parts.append(Series(one.signal, stamps, stamps, np.concatenate((rest, one.values))))
    return Telemetry(tuple(parts))


@cache
def grounded() -> Baseline:
    options = LearnOptions(airframe=replace(FRAME, gate=None))
    spans = zip(healthy(3, 9000), (3.0, 30.0, 8.0), strict=True)
    return learn([logged(ground_first(one.telemetry, s), name=one.name) for one, s in spans], options, created=NOW)


@pytest.mark.parametrize("span_s", [12.0, 45.0])
def test_f2_ground_time_at_the_start_of_a_log_is_not_compared_with_flight(span_s: float) -> None:
    verdict = judge(logged(ground_first(flying(6000, 1), span_s)), grounded())
    assert verdict.verdict is Verdict.HEALTHY, verdict.reason
    assert "may be another vehicle" not in verdict.reason
    assert verdict.flown_s == pytest.approx(55.0, abs=1.5)
    quiet = changed(flying(6000, 1), Signal.BODY_RATE, np.zeros_like)
    other = Telemetry(tuple(one for one in quiet.series if one.signal is not Signal.THRUST_SETPOINT))
    assert judge(logged(other), grounded()).verdict is Verdict.NOT_JUDGEABLE


def test_judging_a_longer_log_takes_no_more_memory_than_its_signals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mavdiag.judging.PIECE_ROWS", 1000)
    log, most, size = logged(flying(18_000, 5)), [], []
    judge(replace(log, telemetry=between(log.telemetry, 0.0, 30.0)), whole())  # the first time loads
    for seconds in (60.0, 180.0):
        part = replace(log, telemetry=between(log.telemetry, 0.0, seconds))
        size.append(sum(series.t_ns.nbytes + series.values.nbytes for series in part.telemetry.series))
        tracemalloc.start()
        judge(part, whole())
        most.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # what is believed of the signals; rows would take three times as much
    assert most[1] - most[0] < 1.5 * (size[1] - size[0])


def test_the_traces_hold_the_highest_statistic_of_the_verdict() -> None:
    judged = pushed()
    assert judged.chain is not None
    roll = next(one for one in rate_traces(judged.chain, judged.pieces) if one.axis is Axis.ROLL)
    assert roll.fsd_s[roll.judged].max() == judged.verdict.monitors[0].maximum
    assert (roll.fsd_s > 0).sum() == (roll.judged & (np.abs(roll.residual) > roll.margin_rad_s)).sum()


def test_the_simulated_rate_is_the_models_output_to_the_commanded_rate_alone() -> None:
    judged = judge_in_full(logged(flight(6000, 4), "qdrone2"), thesis())
    assert judged.chain is not None
    (trace, _) = rate_traces(judged.chain, judged.pieces)
    (slot, _) = judged.chain.slots
    assert isinstance(slot.monitor, RunLength)
    model = slot.monitor.spec.model.model()
    free = lfilter(model.b, model.a, trace.commanded)
    settled = len(free) // 2  # what the start gets wrong has died out
    np.testing.assert_allclose(trace.simulated[settled:], free[settled:], atol=2e-3)


YAW = Covered(Condition.YAW_RATE, 0.0, 0.4)  # near up to 0.6: its room is a half
TURN_S = 20.0


def made_block(n: int, dt_s: float, seed: int) -> Block:
    """A flight of n rows that moves in every condition; it begins beside the borders of the bins."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0.0, 0.1, (n, 6)), axis=0) * math.sqrt(dt_s)
    rate, thrust = rng.normal(0.0, 0.2, (n, 3)), 0.5 + 0.01 * rng.normal(size=n)
    block = example_rows(n, dt_s, setpoint=walk[:, :3], rate=rate, thrust=thrust).block
    return with_columns(replace(block, t_ns=block.t_ns + 1_000_037_000_000), height=1.0 + walk[:, 3])


def rows_of(block: Block, edges: Sequence[int] = ()) -> list[Rows]:
    spec = RateSpec.of(block.dt_s, WINDOW)
    state, out = spec.start(), []
    for low, high in itertools.pairwise(sorted({0, len(block), *edges})):
        out.append(spec.step(state, block.rows(low, high)))
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


def ones_judged(covered: list[Covered], rows: list[Rows], monitor: Ones) -> tuple[Statistic, dict[Condition, Outside]]:
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
    angles = np.column_stack((triangle - 0.2, np.full(n, 0.3), 0.5 * t_s))
    block = example_rows(n, dt_s, setpoint=angles, rate=np.tile([0.0, 0.0, 0.5], (n, 1)), thrust=np.full(n, 0.6)).block
    found = measured(rows_of(with_columns(block, height=np.where(np.arange(n) % 10 == 3, 1.0, 2.0))))
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
    assert settled[:, list(Condition).index(Condition.COMMANDED_RATE)].max() == pytest.approx(0.4 + turn, rel=0.02)
    accelerated = settled[:, list(Condition).index(Condition.COMMANDED_ACCELERATION)]
    assert np.median(accelerated) == pytest.approx(0.5 * math.cos(0.3) * 0.4, rel=0.02)  # of the pitch, as it rolls
    assert 4.0 < accelerated.max() < 0.8 / 0.1  # where the roll command turns round
    assert settled[:, list(Condition).index(Condition.YAW_ACCELERATION)].max() < 0.05  # of the heading's rate, leaning


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
        (Covered(Condition.THROTTLE, 0.2, 0.6), [0.2, 0.6, 0.7, 0.8, 0.1, 0.0, -0.2], [0, 0, 0.5, 1.0, 0.5, 1.0, 2]),
        (Covered(Condition.YAW_RATE, 0.0, 0.01), [0.15, 0.225], [0.0, 1.0]),
        (Covered(Condition.HEIGHT, 3.0, 9.0), [0.5, 0.0], [0.0, 2.0]),
        (Covered(Condition.THROTTLE, 0.4, 0.4), [0.3, 0.5, 0.2], [0.0, 0.0, 1.0]),  # 25 %, and half of the span again
    ],
    ids=["upper", "with a room of its own", "lower", "both", "no turn", "no height", "one throttle"],
)
def test_each_side_is_limited_as_its_rule_says(covered: Covered, values: list[float], expected: list[float]) -> None:
    np.testing.assert_allclose(excess(covered, *values), expected, atol=1e-12)


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
    assert (bare, covered_by([])) == (set(Condition) - {Condition.THROTTLE, Condition.HEIGHT}, ())


def test_21_one_wrong_sample_does_not_widen_what_is_covered() -> None:
    nose = np.zeros((900, 3))
    nose[:, 2] = 0.002 * np.arange(900)
    wrong = nose.copy()
    wrong[400, 2] += 3.0
    spans = [covered_by([rows_of(example_rows(900, 0.01, setpoint=one).block)]) for one in (nose, wrong)]
    highest = [next(one.high for one in span if one.condition is Condition.YAW_RATE) for span in spans]
    assert highest[1] == pytest.approx(highest[0], abs=0.01)


def test_21_a_time_is_not_scaled_like_an_amplitude() -> None:
    for unit, value, turn in (("rad/s", 0.8, 0.5), ("s", 1.0, 0.39), ("s", None, 0.5)):
        found, _ = ones_judged([YAW], turned(np.full(600, turn)), Ones({Condition.YAW_RATE}, 1.0, unit=unit))
        assert found.valid[-1] == (value is not None)
        assert value is None or found.value[-1] == pytest.approx(value)


def test_a_new_segment_does_not_go_on_from_the_old_one() -> None:
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


@pytest.mark.parametrize("rate", [0.61, 1.8, 30.0])
def test_outside_nothing_is_judged_and_it_is_said(rate: float) -> None:
    found, outside = ones_judged([YAW], turned(np.full(400, rate)), Ones({Condition.YAW_RATE}, 1.0))
    assert not found.valid[100:].any()
    assert set(outside) == {Condition.YAW_RATE}
    told = outside[Condition.YAW_RATE]
    assert told.value == pytest.approx(rate)
    assert told.span_s == pytest.approx(0.01 * np.count_nonzero(~found.valid))


@pytest.mark.parametrize("memory_s", [0.35, 1.0, 10.0])
@pytest.mark.parametrize("wild", [0.3, 3.0])
def test_each_value_counts_by_the_farthest_bin_behind_it(memory_s: float, wild: float) -> None:
    rng = np.random.default_rng(round(wild + memory_s))
    turns: FloatArray = np.repeat(wild * rng.random(40) * (rng.random(40) < 0.2), 30)
    flight = turned(turns)
    covered = [YAW, Covered(Condition.TILT, 0.0, 0.3), Covered(Condition.COMMANDED_RATE, 0.0, 0.01)]
    found, reasons = ones_judged(covered, flight, Ones({Condition.YAW_RATE, Condition.HEIGHT}, memory_s))
    bins, outside = measured(flight), 0
    for t, value, level, valid in zip(found.t_ns.tolist(), found.value, found.level, found.valid, strict=True):
        behind = (bins.end_ns > t - round(memory_s * 1e9)) & (bins.end_ns <= t)
        far = max(excess(YAW, *column(bins, Condition.YAW_RATE)[behind].tolist()), default=0.0)
        assert value == pytest.approx(level / (1.0 + RULES[Condition.YAW_RATE].room * min(far, 1.0)))
        assert valid == (far <= 1.0)
        outside += far > 1.0
    assert sum(one.span_s for one in reasons.values()) == pytest.approx(0.01 * outside)


def test_a_step_of_the_set_points_is_not_judged_from_the_rate_on_that_shows_it() -> None:
    angles = np.where(np.arange(400) < 203, 0.0, 0.5)[:, None] * (1.0, 0.0, 0.0)
    rows = rows_of(example_rows(400, 0.01, setpoint=angles).block)
    sharp = Covered(Condition.COMMANDED_ACCELERATION, 0.0, 5.0)
    found, outside = ones_judged([sharp], rows, Ones({sharp.condition}, 0.35))
    shown = np.flatnonzero(np.abs(rows[0].rates.u[:, 0]) / 0.1 > 2.0 * sharp.high)[0]
    assert (found.valid[shown - 1], found.valid[shown], found.valid[-1]) == (True, False, True)
    assert outside[sharp.condition].value == pytest.approx(np.abs(rows[0].rates.u[:, 0]).max() / 0.1)


@cache
def straight() -> Baseline:
    options = LearnOptions(airframe=FRAME, monitors=("fsd", "innovation", "rotor_signature", "rotor_trim", "trim_step"))
    return learn(healthy(3), options, created=NOW)


@pytest.mark.parametrize("seed", range(60, 64))
def test_a_turn_that_was_not_learnt_is_not_judged_and_never_an_alarm(seed: int) -> None:
    turn = np.clip(0.9 * (0.01 * np.arange(5000) - TURN_S), 0.0, 1.8)  # within 2 s
    found = judge(logged(flying(5000, seed, turn=turn)), straight())
    # The turn is most of the flight. Its beginning may come near a threshold, and passes none.
    assert found.verdict in (Verdict.NOT_JUDGEABLE, Verdict.SUSPECTED), found.reason
    assert not found.events
    assert " (4" in found.reason
    for name, told in verdict_json(found)["monitors"].items():
        assert told["not_judged"].startswith("yaw rate "), name
        assert told["not_judged"].endswith(" rad/s, learnt up to 0.41"), name
        assert 26 < told["outside_s"] < (35 if name == "fsd" else 31), name  # near it is not judged, either
        assert told["outside_s"] + told["judged_s"] < 50, name


def test_a_link_that_carries_no_heading_and_no_height_is_judged_all_the_same() -> None:
    high = (*straight().envelope, Covered(Condition.HEIGHT, 0.4, 3.0))
    found = judge(logged(flying(3000, 80)), straight().model_copy(update={"envelope": high}))
    assert found.verdict is Verdict.HEALTHY
    assert {one.outside_s for one in found.monitors if one.decides} == {0.0}
