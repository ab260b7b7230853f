"""An alert over the decision's stages: when it begins, what is news, what is only the fault going."""

from dataclasses import replace

import numpy as np
import pytest
from flying_telemetry import flying
from made_baselines import trim

from detector.alerts import Kind
from detector.judging import Alert, Judge, alert_after, not_judged
from detector.streams import Streams, observe
from mavdiag.chain import ChainOutput, chain_of
from mavdiag.decision.alarm import Diagnosis, Stage
from mavdiag.link.profiles import PROFILES
from mavdiag.telemetry import FloatArray, Instant, Series, Signal, Telemetry

ROWS = ChainOutput(events=(), changes=(), gauges=(), flight_s=0.1, judged_s=0.1, now_ns=1)
QUIET = Diagnosis(stage=Stage.QUIET, reason="monitors judge")
FAULT = replace(QUIET, stage=Stage.FAULT, monitor="innovation", statistic=3.0, threshold=2.0)
SUSPECTED = replace(FAULT, stage=Stage.SUSPECTED)


def after(*diagnoses: Diagnosis, suspect: frozenset[str] = frozenset()) -> Alert | None:
    alert = None
    for second, diagnosis in enumerate(diagnoses):
        alert = alert_after(alert, ROWS, diagnosis, suspect, Instant(second * 10**9))
    return alert


def test_a_suspicion_becomes_a_fault_and_a_rotor_that_is_named_is_news() -> None:
    assert after(QUIET) is None
    suspected, fault, named = after(SUSPECTED), after(SUSPECTED, FAULT), after(FAULT, replace(FAULT, rotor=3))
    assert suspected is not None
    assert fault is not None
    assert named is not None
    assert (suspected.notice.kind, fault.notice.kind) == (Kind.SUSPECT, Kind.FAULT)
    assert fault.notice.key != named.notice.key


def test_l8_a_rotor_that_is_named_while_the_fault_goes_is_no_news() -> None:
    """The removal of a fault raised the same CRITICAL as its onset."""
    going = after(FAULT, QUIET, *(replace(FAULT, rotor=2),) * 3)
    assert going is not None
    assert going.notice.key == ""
    assert going.notice.silent is False
    silent = after(FAULT, QUIET)
    assert silent is not None
    assert silent.notice.silent


def test_l8_a_fault_that_is_only_held_is_not_repeated_with_a_figure_below_its_threshold() -> None:
    held = after(FAULT, replace(FAULT, statistic=0.1))
    assert held is not None
    assert held.notice.silent
    again = after(FAULT, replace(FAULT, statistic=0.1), FAULT)
    assert again is not None
    assert not again.notice.silent


def test_a_monitor_named_as_suspect_only_raises_a_suspicion() -> None:
    alert = after(FAULT, suspect=frozenset({"innovation"}))
    assert alert is not None
    assert alert.notice.kind is Kind.SUSPECT


def test_without_new_rows_nothing_changes() -> None:
    alert = after(FAULT)
    assert alert_after(alert, replace(ROWS, now_ns=None), FAULT, frozenset(), Instant(10**10)) is alert


def test_a_flight_outside_of_the_envelope_says_which_condition_was_not_learnt() -> None:
    """And not that it waits for unbroken flight, nor a figure that changes with every look."""
    for rate, said in ((2.0, (("rotor trim", "yaw rate not learnt"),)), (0.0, ())):
        telemetry, chain = flying(3000, 5, turn=np.full(3000, rate)), chain_of(trim())
        judge, _ = Judge(trim(), chain, chain.start(), Instant(0)).step(telemetry, Instant(0))
        streams = observe(Streams(), telemetry, Instant(0), PROFILES["qdrone2"])
        assert not_judged(judge, streams, Instant(30 * 10**9)) == said


def came(streams: Streams, t_s: FloatArray, now_s: float) -> Streams:
    t_ns = np.round(1e9 * t_s).astype(np.int64)
    gyro = Series(Signal.BODY_RATE, t_ns, t_ns, np.zeros((len(t_ns), 3)))
    return observe(streams, Telemetry((gyro,)), Instant(round(now_s * 1e9)), PROFILES["ardupilot"])


def test_h5_a_link_that_stalls_changes_no_rate() -> None:
    """By arrival 0.2 s without data read 45 Hz, then 100 Hz: 204 requests in 718 s."""
    streams, seen = Streams(), []
    for k in range(100):  # 100 Hz by the vehicle's clock; every second look comes late, with all that waited
        stamps = np.arange(20 * k, 20 * (k + 1)) / 100.0
        first, rest = stamps[:3], stamps[3:]
        streams = came(streams, first, 0.2 * k + 0.18)
        seen.append(streams.rate_hz(Signal.BODY_RATE, Instant(round((0.2 * k + 0.181) * 1e9))))
        streams = came(streams, rest, 0.2 * k + 0.19)
    assert [one for one in seen if one is not None] == pytest.approx([100.0] * sum(one is not None for one in seen))
    slow = came(streams, 20.0 + 0.25 * np.arange(1, 4), 21.0)
    assert slow.rate_hz(Signal.BODY_RATE, Instant(21 * 10**9)) == pytest.approx(4.0)  # and a lower one shows at once
