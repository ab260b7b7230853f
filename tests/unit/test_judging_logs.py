"""Verdicts on logs: a fault, healthy by whom, and not judgeable why."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from flying_telemetry import START_NS, flying, without
from made_baselines import NOW, logged, thesis, trim, whole
from made_statistics import assert_alike
from made_telemetry import cut, flight

from mavdiag.airframe.airframe import Airframe
from mavdiag.as_json import verdict_json
from mavdiag.chain import chain_of
from mavdiag.commands.options import between
from mavdiag.decision.alarm import Stage
from mavdiag.errors import InputError
from mavdiag.judging import LogVerdict, Verdict, exit_code, judge, judge_in_full
from mavdiag.learning import LearnOptions, learn
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import Log, Signal, Telemetry

ALL = (0.0, 1e9)


def test_a_push_is_a_fault_at_its_time_and_a_healthy_flight_is_not() -> None:
    push = np.zeros(10_000)
    push[5000:5600] = 0.3
    verdict = judge(logged(flight(10_000, 50, push=push), "qdrone2"), thesis())
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
        (flight(900, 1), "qdrone2", "0.9 s of flight, but no deciding monitor judged"),
    ],
)
def test_what_cannot_be_judged_says_why(telemetry: Telemetry, profile: str, reason: str) -> None:
    verdict = judge(logged(telemetry, profile), thesis())
    assert verdict.verdict is Verdict.NOT_JUDGEABLE
    assert verdict.reason.startswith(reason)
    assert "\n" not in verdict.reason


def test_a_log_that_never_flies_is_not_judgeable() -> None:
    grounded = Telemetry(
        tuple(
            type(one)(one.signal, one.t_ns, one.host_ns, 0 * one.values) if one.signal is Signal.ARMED else one
            for one in flight(4000, 1)
        )
    )
    verdict = judge(logged(grounded, "qdrone2"), thesis())
    assert (verdict.verdict, verdict.reason) == (Verdict.NOT_JUDGEABLE, "never airborne: no armed flight with thrust")


def test_b1_what_no_deciding_monitor_judged_is_not_healthy() -> None:
    """B1: `scan --monitors effort` called an 8 mm cut healthy, though the monitor gave no valid value."""
    short = judge(logged(flying(450, 1)), trim())
    assert short.verdict is Verdict.NOT_JUDGEABLE
    assert short.judged_s == 0
    assert short.reason == (
        "4.5 s of flight, but no deciding monitor judged: rotor_trim (waiting for enough unbroken flight)"
    )
    silent = judge(logged(without(flying(2000, 1), ALL, signals=(Signal.ACTUATOR,))), trim())
    assert silent.verdict is Verdict.NOT_JUDGEABLE
    assert silent.reason.endswith("no deciding monitor judged: rotor_trim (no actuator)")


def test_b1_healthy_says_which_monitors_judged_for_how_long_and_which_did_not() -> None:
    """B1: the innovation monitor alone sufficed for "healthy", without a word of the others."""
    verdict = judge(logged(without(flying(2500, 1), ALL, signals=(Signal.ACTUATOR,))), whole())
    assert verdict.verdict is Verdict.HEALTHY
    assert "; judged by innovation 22." in verdict.reason
    assert "; not judged by rotor_trim (no actuator)" in verdict.reason
    assert verdict.judged_s == pytest.approx(23, abs=1.5)


def test_r2_a_monitor_that_never_judged_has_no_maximum_but_a_reason() -> None:
    """R2: max 0.0 for monitors that never judged."""
    found = verdict_json(judge(logged(without(flying(2500, 1), ALL, signals=(Signal.VIBRATION,))), whole()))["monitors"]
    assert found["vibration_level"] | {"threshold": 0} == {
        "max": None,
        "threshold": 0,
        "unit": "m/s^2",
        "alarms": 0,
        "judged_s": 0.0,
        "not_judged": "no vibration",
        "outside_s": 0.0,
        "axis": None,
    }
    assert found["rotor_trim"]["max"] > 0
    assert found["rotor_trim"]["judged_s"] == pytest.approx(19.5, abs=1)
    assert found["rotor_trim"]["not_judged"] is None


def test_a_signal_that_stops_in_flight_is_told_in_the_verdict() -> None:
    stopped = without(flying(3000, 1), (12.0, 30.0), signals=(Signal.ACTUATOR,))
    found = {one.name: one for one in judge(logged(stopped), whole()).monitors}
    assert found["rotor_trim"].not_judged == "no actuator"
    assert found["innovation"].not_judged is None


def test_a_signal_that_stops_is_told_with_the_time_it_cost() -> None:
    chain = chain_of(whole())
    stopped = without(flying(3000, 1), (12.0, 30.0), signals=(Signal.ACTUATOR,))
    state, _ = chain.step(chain.start(), stopped)
    state, _ = chain.finish(state)
    accounts = {slot.monitor.name: account for slot, account in zip(chain.slots, state.accounts, strict=True)}
    assert accounts["rotor_trim"].judged_s == pytest.approx(8, abs=1.5)
    assert accounts["rotor_trim"].not_judged["no actuator"] == pytest.approx(17, abs=1.5)
    for account in accounts.values():
        assert account.judged_s + sum(account.not_judged.values()) == pytest.approx(account.flight_s, abs=0.1)


def test_an_account_does_not_depend_on_chunks() -> None:
    telemetry = without(flying(3000, 1), (12.0, 20.0), signals=(Signal.ACTUATOR, Signal.VIBRATION))
    chain = chain_of(whole())
    found = []
    for step in (10**12, 50_000_000, 330_000_000):
        state = chain.start()
        for chunk in cut(telemetry, list(range(START_NS, START_NS + 31 * 10**9, step))):
            state, _ = chain.step(state, chunk)
        found.append(chain.finish(state)[0])
    for other in found[1:]:
        assert other.judged_s == pytest.approx(found[0].judged_s, abs=0.1)
        for one, same in zip(other.accounts, found[0].accounts, strict=True):
            assert (one.peak, one.judged_s) == pytest.approx((same.peak, same.judged_s))
            assert dict(one.not_judged) == pytest.approx(dict(same.not_judged))


def test_a_part_of_a_log_is_cut_by_the_vehicle_s_clock() -> None:
    part = between(flight(8000, 1), 3.0, 4.0)
    t = part.need(Signal.BODY_RATE).t_ns
    assert (t[0] / 1e9, len(t)) == (3.0, 1000)
    with pytest.raises(InputError, match=r"no data from 5 s to 6 s .* from 1\.0 to 1\.8 s"):
        between(flight(800, 1), 5.0, 6.0)


def test_notes_of_a_file_stand_in_the_reason() -> None:
    log = replace(logged(flying(2500, 1)), notes=("the file ends within a record",))
    assert judge(log, whole()).reason.endswith("; the file ends within a record")


def test_the_exit_code_is_that_of_the_gravest_verdict() -> None:
    healthy, fault, unknown, error = Verdict.HEALTHY, Verdict.FAULT, Verdict.NOT_JUDGEABLE, Verdict.ERROR
    assert exit_code([healthy]) == 0
    assert exit_code([healthy, unknown]) == 3
    assert exit_code([unknown, fault]) == 1
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


def test_judging_a_longer_log_takes_no_more_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mavdiag.judging.PIECE_ROWS", 1000)
    log, most = logged(flying(18_000, 5)), []
    for seconds in (60.0, 180.0):
        part = replace(log, telemetry=between(log.telemetry, 0.0, seconds))
        tracemalloc.start()
        judge(part, whole())
        most.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert most[1] < 1.3 * most[0]


@pytest.mark.parametrize(
    ("layout", "frame", "named"),
    [("octo-x", (3, 1), True), ("x8", (4, 1), False), ("y6", (5, 0), False), ("deca-x", (14, 1), True)],
)
def test_a_frame_by_its_parameters_is_judged_and_two_rotors_on_an_arm_are_not_told_apart(
    layout: str, frame: tuple[int, int], named: bool
) -> None:
    parameters = {"FRAME_CLASS": float(frame[0]), "FRAME_TYPE": float(frame[1])}
    airframe = Airframe(name=layout, gate=GateSpec())
    flights = [
        Log(f"f{k}", f"{k:064x}", "ardupilot", flying(3000, 100 + k, layout=layout), parameters=parameters)
        for k in range(3)
    ]
    baseline = learn(flights, LearnOptions(airframe=airframe, monitors=("rotor_trim",)), created=NOW)
    assert baseline.airframe.layout is not None
    assert baseline.airframe.layout.name == layout
    assert judge(replace(flights[0], telemetry=flying(3000, 7, layout=layout)), baseline).verdict is Verdict.HEALTHY
    weak = judge(replace(flights[0], telemetry=flying(3000, 7, weak_rotor=2, rise=0.4, layout=layout)), baseline)
    assert weak.verdict is Verdict.FAULT, weak.reason
    assert {one.rotor for one in weak.changes} - {None} == ({2} if named else set())
