"""Verdicts on logs: a fault, healthy by whom, and not judgeable why."""

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flying_telemetry import flying, without
from made_baselines import FRAME, NOW, healthy, logged, plain, thesis, trim, whole
from made_statistics import assert_alike
from made_telemetry import START_NS, changed, flight
from scipy.signal import lfilter

from mavdiag.as_json import verdict_json
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import Stage
from mavdiag.errors import InputError
from mavdiag.judging import JudgedFlight, LogVerdict, Verdict, exit_code, judge, judge_in_full
from mavdiag.learning import LearnOptions, learn
from mavdiag.logs import between
from mavdiag.monitors.base import FaultKind
from mavdiag.monitors.run_length import RunLength
from mavdiag.telemetry import Axis, Series, Signal, Telemetry
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
    assert verdict.verdict is Verdict.FAULT
    first = verdict.events[0]
    assert 6.0 < first.t_s < 6.3
    assert first.event.statistic == pytest.approx(0.6, abs=0.12)
    assert verdict.monitors[0].maximum == first.event.statistic
    assert verdict.reason.startswith("fsd on roll 0.")
    assert [one.stage for one in verdict.changes if one.stage is not Stage.SUSPECTED][:2] == [Stage.QUIET, Stage.FAULT]


@pytest.mark.parametrize(
    ("telemetry", "profile", "reason"),
    [
        (without(flight(8000, 1), ALL, signals=(Signal.BODY_RATE,)), "qdrone2", "no body rate"),
        (flight(8000, 1), "px4", "another link: link.profile"),
        (flight(900, 1), "qdrone2", "only 0.9 s of take-off or start"),
    ],
)
def test_what_cannot_be_judged_says_why(telemetry: Telemetry, profile: str, reason: str) -> None:
    verdict = judge(logged(telemetry, profile), thesis())
    assert verdict.verdict is Verdict.NOT_JUDGEABLE
    assert verdict.reason.startswith(reason)
    assert "\n" not in verdict.reason


def test_b1_what_no_deciding_monitor_judged_is_not_healthy() -> None:
    """B1: `scan --monitors effort` called an 8 mm cut healthy, though the monitor gave no valid value."""
    short = judge(logged(flying(450, 1)), trim())
    assert short.verdict is Verdict.NOT_JUDGEABLE
    assert short.judged_s == 0
    assert short.reason == (
        "judged 0.0 s of 3.5 s (0 %), without 1.0 s of take-off or start: "
        "not judged by rotor_trim (waiting for enough unbroken flight)"
    )
    silent = judge(logged(without(flying(2000, 1), ALL, signals=(Signal.ACTUATOR,))), trim())
    assert silent.verdict is Verdict.NOT_JUDGEABLE
    assert silent.reason.endswith("of take-off or start: not judged by rotor_trim (no actuator)")


def test_b1_healthy_says_which_monitors_judged_for_how_long_and_which_did_not() -> None:
    """B1: the innovation monitor alone sufficed for "healthy", without a word of the others."""
    verdict = judge(logged(without(flying(2500, 1), ALL, signals=(Signal.ACTUATOR,))), whole())
    assert verdict.verdict is Verdict.HEALTHY
    assert verdict.reason.startswith("no alarm; judged 24.0 s of 24.0 s (100 %) by innovation, rotor_signature, ")
    assert "; not judged by rotor_trim (no actuator)" in verdict.reason
    assert (verdict.judged_s, verdict.flown_s) == pytest.approx((24, 24), abs=0.1)
    assert verdict_json(verdict)["judged_s"] == pytest.approx(24, abs=0.1)
    assert verdict_json(verdict)["flown_s"] == pytest.approx(24, abs=0.1)


def test_the_exit_code_is_that_of_the_gravest_verdict() -> None:
    healthy, fault, unknown, error = Verdict.HEALTHY, Verdict.FAULT, Verdict.NOT_JUDGEABLE, Verdict.ERROR
    assert exit_code([healthy]) == 0
    assert exit_code([healthy, unknown]) == 3
    assert exit_code([Verdict.SUSPECTED, unknown, healthy]) == 4
    assert exit_code([unknown, Verdict.SUSPECTED, fault]) == 1
    assert exit_code([fault, error, unknown]) == 2
    assert LogVerdict("x", error, "y").events == ()


@pytest.mark.parametrize("rows", [137, 1000, 10**6])
def test_the_pieces_that_a_log_is_judged_in_change_nothing(rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    log = logged(without(flying(4000, 5, weak_rotor=2, rise=0.2), (9.0, 9.08), (20.0, 21.4)))
    expected = judge_in_full(log, whole()).verdict
    assert expected.verdict is Verdict.FAULT
    monkeypatch.setattr("mavdiag.judging.PIECE_ROWS", rows)
    found = judge(log, whole())
    assert (found.verdict, found.reason, found.notes) == (expected.verdict, expected.reason, expected.notes)
    assert_alike([one.event for one in found.events], [one.event for one in expected.events])
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
    """F1: the dips of its thrust were taken for landings, and 5 s after each of them nobody judged."""
    verdict = judge(logged(tumbling()), flown())
    assert verdict.verdict is Verdict.FAULT
    assert "the flight ends in an upset, at 3" in verdict.reason
    assert verdict.since_s == pytest.approx(31.0, abs=1.0)
    assert verdict.flown_s == pytest.approx(34.0 - 5.0, abs=0.2)
    with pytest.raises(InputError, match="the flight ends in an upset, at 3"):
        learn([logged(tumbling())], LearnOptions(airframe=replace(FRAME, gate=None)), created=NOW)


def test_f1_an_upset_is_a_loss_of_control_where_no_monitor_saw_a_fault() -> None:
    force = np.random.default_rng(4).normal([0.0, 0.0, -0.5], 0.05, (200, 3))
    verdict = judge(logged(changed(flying(3000, 1), Signal.SPECIFIC_FORCE, lambda _: force, 28.0, 30.0)), trim())
    assert (verdict.verdict, verdict.kind) == (Verdict.FAULT, FaultKind.LOSS_OF_CONTROL)
    assert verdict.reason.startswith("loss of control: the flight ends in an upset, at 28.9 s: free fall")
    assert verdict.since_s == pytest.approx(28.9, abs=0.2)
    assert verdict_json(verdict)["kind"] == "loss of control"


C1: dict[str, tuple[Callable[[Telemetry], Telemetry], str]] = {
    "the gyro ends": (lambda flight: without(flight, (18.0, 99.0), signals=(Signal.BODY_RATE,)), "no gyro from 19.0 s"),
    "it keeps one stamp": (
        lambda flight: Telemetry(
            tuple(
                replace(one, t_ns=np.minimum(one.t_ns, START_NS + 18 * NS_PER_S)) if one.signal == "body_rate" else one
                for one in flight
            )
        ),
        "no gyro from 19.0 s",
    ),
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
    """C1: what failed half way was unmentioned, and 1.9 judged seconds were enough for "healthy"."""
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
    verdict = judge(logged(landed), flown())
    assert verdict.verdict is Verdict.HEALTHY
    assert verdict.flown_s == pytest.approx(20.0, abs=0.2)


def test_c3_alarms_of_monitors_that_do_not_decide_are_a_suspicion() -> None:
    base = learn(plain(3), LearnOptions(airframe=FRAME, monitors=("innovation", "fsd")), created=NOW)
    push = np.zeros(20_000)
    push[8000:11_000] = 0.2 * np.hanning(3000)
    verdict = judge(logged(flight(20_000, 50, push=push), "qdrone2"), base)
    alarmed = {one.event.monitor for one in verdict.events}
    assert (verdict.verdict, alarmed) == (Verdict.SUSPECTED, {"fsd"})
    assert verdict.reason.startswith("1 alarm of fsd, which decides nothing alone, first at ")
    assert "healthy" not in verdict.reason


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
        times = (one.t_ns[before], one.t_ns + shift)
        stamps = np.concatenate(times)
        parts.append(Series(one.signal, stamps, stamps, np.concatenate((rest, one.values))))
    return Telemetry(tuple(parts))


@cache
def grounded() -> Baseline:
    options = LearnOptions(airframe=replace(FRAME, gate=None))
    spans = zip(healthy(3, 9000), (3.0, 30.0, 8.0), strict=True)
    taught = [logged(ground_first(one.telemetry, s), name=one.name) for one, s in spans]
    return learn(taught, options, created=NOW)


@pytest.mark.parametrize("span_s", [12.0, 45.0])
def test_f2_ground_time_at_the_start_of_a_log_is_not_compared_with_flight(span_s: float) -> None:
    """F2: three of eight flights of an X8 were "another vehicle: gyro noise x0.015", one that had taught it too."""
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
    assert roll.fml_s == judged.verdict.monitors[0].threshold
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
