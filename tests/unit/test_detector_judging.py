"""An alert over the decision's stages: when it begins, what is news, what is only the fault going."""

from dataclasses import replace

import numpy as np
from flying_telemetry import flying
from made_baselines import trim

from detector.alerts import Kind
from detector.judging import Alert, Judge, alert_after, not_judged
from detector.streams import Streams, observe
from mavdiag.chain import ChainOutput, chain_of
from mavdiag.decision.alarm import Diagnosis, Stage
from mavdiag.link.profiles import PROFILES
from mavdiag.telemetry import Instant

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
