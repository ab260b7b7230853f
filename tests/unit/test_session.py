"""What a session does: stories on a virtual clock, laws that hold whatever happens, and the table of states."""

import itertools
import os
import runpy
import threading
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from flying_telemetry import flying
from hypothesis import example, given, settings
from hypothesis import strategies as st
from made_baselines import trim
from made_session import Story, baseline_for, outcome_of
from web_page import wait_for

from detector.check import plan
from detector.config import SessionSettings, Settings
from detector.fitting import ProcessFitter
from detector.fleet import Fleet, Vehicle
from detector.judging import Judge, chain_for
from detector.session import FITS, Session
from detector.states import TABLE, State
from detector.streams import HELD_S, METERED, Negotiation, Streams
from detector.values import Learn, Note, SendCommand, SendFloat, SendText, SessionSpec, StateChanged
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.fingerprint import Figure, Fingerprint
from mavdiag.airframe.layout import layout_named
from mavdiag.baseline import Baseline
from mavdiag.chain import chain_of
from mavdiag.decision.diagnosis import Change, Diagnosis, Stage
from mavdiag.errors import BaselineError
from mavdiag.link.messages import Autopilot, MavCmd, MavResult, MessageId, Severity
from mavdiag.link.profiles import LAST_RESORT, PROFILES
from mavdiag.link.vehicles import Ack, Received
from mavdiag.link.wants import Want, wants_of
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.telemetry import FloatArray, Instant, Series, Signal, Telemetry
from mavdiag.units import G

QDRONE2 = PROFILES["qdrone2"]
INSPECT = SendText(Severity.WARNING, "PROP rotor unknown: inspect before flight")
HIDDEN: dict[str, dict[str, Any]] = {
    "its thrust reads 0 while it flies": {"thrust": 0.0},
    "it reads disarmed while its thrust says that it flies": {"armed": False},
}
DOCS = Path(__file__).resolve().parents[2] / "docs"
TICK_S = 0.04
GYRO = Want(
    Signal.BODY_RATE, MessageId.RAW_IMU, 100.0, 98.0, 102.0, mandatory=True, others=(MessageId.HIGHRES_IMU, LAST_RESORT)
)


def watching(seconds: int = 120, **changes: object) -> Story:
    """A session with a baseline, already monitoring."""
    story = Story(SessionSpec(QDRONE2, baseline_for(), SessionSettings.model_validate(changes)), seconds=seconds)
    story.fly(5.0)
    assert story.at(State.MONITORING)
    return story


def test_it_learns_then_watches_then_alerts_and_never_says_that_it_is_clear() -> None:
    story = Story()
    job = next(effect for effect in story.fly(26.0) if isinstance(effect, Learn))
    assert len(job.telemetry.need(Signal.BODY_RATE)) == pytest.approx(20 * 100, abs=10)
    assert job.profile == "qdrone2"
    story.answer(outcome_of(story))
    story.fly(10.0)
    story.fly(8.0, push=0.5)
    story.fly(10.0)
    assert story.states == [State.LEARNING, State.FITTING, State.WAITING, State.MONITORING]
    said = [text for text in story.texts if "monitoring" not in text]
    assert said[-3:] == [*["PROP FAULT roll attitude unlike the model"] * 2, "PROP no longer seen: the fault"]
    assert story.state.diagnosis.stage is Stage.FAULT
    assert any(isinstance(effect, Baseline) for _, effect in story.log)


@pytest.mark.parametrize("end", ["landing", "link", "gyro", "restart", "reboot"])
def test_whatever_ends_the_flight_the_fault_is_told_until_it_is_acknowledged(end: str) -> None:
    story = watching(seconds=300)
    story.fly(3.0, push=0.5)
    assert str(story.state.diagnosis.stage) == "fault"
    if end == "landing":
        story.fly(20.0, armed=False)
    elif end == "link":
        story.silence(20.0)
    elif end == "gyro":
        story.fly(20.0, without=(Signal.BODY_RATE,))
    elif end == "reboot":
        story.reboots = 1
    else:
        left = story.session.finish()
        assert [effect.stage for effect in left if isinstance(effect, Change)] == [Stage.INSPECT]
        held = story.state.diagnosis
        story.session = Session(replace(story.spec, held=held), story.now)
    story.fly(20.0, armed=False)
    assert INSPECT in [effect for _, effect in story.log]
    assert story.state.diagnosis.stage is Stage.INSPECT
    assert not [text for text in story.texts if "clear" in text or "over" in text]
    assert [effect for effect in story.fly(20.0) if effect == INSPECT] == [INSPECT]  # said again at the next arming
    closed = SendText(Severity.INFO, "PROP rotor unknown: inspection acknowledged")
    assert story.session.acknowledge("a test")[-1] == closed
    assert INSPECT not in [*story.fly(20.0, armed=False), *story.fly(20.0)]
    assert str(story.state.diagnosis.stage) == "quiet"


TWIN = Fingerprint((Figure("motors", 2.0, 0.1),), flights=3)
X = Airframe(name="made", layout=layout_named("x"))


@pytest.mark.parametrize(
    ("profile", "reason", "text"),
    [
        ("px4", "link.profile: the baseline is for 'qdrone2'", "baseline for qdrone2, not px4"),
        ("qdrone2", "another vehicle: does not look like made: 4 motors (", "4 motors (learnt 2)"),
    ],
)
def test_a_baseline_of_another_profile_or_vehicle_is_refused_by_name(profile: str, reason: str, text: str) -> None:
    baseline = baseline_for("qdrone2").model_copy(update={"fingerprint": TWIN, "airframe": X})
    story = Story(SessionSpec(PROFILES[profile], baseline))
    said = [effect for effect in story.fly(8.0, outputs=True) if isinstance(effect, SendText)]
    assert said[-1] == SendText(Severity.WARNING, f"PROP OFF: {text}")
    assert story.state.reason.startswith(reason)
    assert (story.states[-1], story.session.working) == (State.FAULTED, False)


def test_b6_another_rate_is_asked_for_and_waited_for_but_never_a_reason_to_be_off() -> None:
    story = Story(SessionSpec(QDRONE2, baseline_for(rate_hz=50.0)), seconds=200)
    story.fly(15.0)
    assert story.state.reason == "rate not the baseline's (100 Hz)"
    assert SendCommand(MavCmd.SET_MESSAGE_INTERVAL, (MessageId.RAW_IMU, 20_000)) in [effect for _, effect in story.log]
    story.fly(100.0)
    assert story.at(State.WAITING)
    assert story.session.working
    requests = [at for at, effect in story.log if isinstance(effect, SendCommand)]
    assert min(b - a for a, b in itertools.pairwise(requests)) >= 2.0
    assert len(requests) < 12  # paced: the autopilot does not do it
    story.fly(3.0, every=2)
    assert story.at(State.MONITORING)


def test_a_baseline_of_a_slow_link_is_judged_by_at_its_own_rate() -> None:
    story = Story(SessionSpec(QDRONE2, baseline_for(rate_hz=25.0)))
    story.fly(10.0, every=4)
    assert story.at(State.MONITORING), story.state.reason


@pytest.mark.parametrize("negotiate", [True, False])
def test_b6_a_throttled_link_is_judged_again_within_three_seconds_of_the_right_rate(negotiate: bool) -> None:
    """A parameter download halves the rate for 40 s: the session was off for the rest of the flight."""
    story = watching(negotiate=negotiate)
    story.fly(5.0)
    story.fly(40.0, every=2)
    assert story.at(State.WAITING)
    story.fly(3.0)
    assert story.at(State.MONITORING)
    before = story.state.judge.judged_s if story.state.judge else 0.0
    story.fly(10.0)
    assert story.state.judge is not None
    assert story.state.judge.judged_s > before + 9.0
    assert State.FAULTED not in story.states


def test_l2_what_the_optional_streams_lack_is_told_and_hinders_nothing() -> None:
    story = Story(SessionSpec(PROFILES["ardupilot"], baseline_for("ardupilot", names=("fsd", "rotor_trim"))))
    story.fly(12.0)
    assert story.at(State.MONITORING)
    trim = RotorTrim.label
    assert story.state.reason == f"monitoring; {trim} not judged: no actuator outputs"
    assert f"PROP monitoring; {trim}: no actuator outputs" in story.texts
    notes = [effect.text for _, effect in story.log if isinstance(effect, Note)]
    assert notes.count(f"{trim} not judged: no actuator outputs") == 1
    story.fly(12.0, outputs=True)
    assert story.state.reason == "monitoring"
    story.give(Received(alive=True, imu=MessageId.SCALED_IMU2))
    assert story.texts[-1] == "PROP another gyro: SCALED_IMU2"
    assert Note("the gyro is read from RAW_IMU again") in story.give(Received(alive=True))


def test_a_wall_clock_that_is_set_late_changes_the_session_at_the_next_arming(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Baseline, "same_session", lambda _, started_ns: started_ns == 0)
    story = watching()
    before, story.session.unix_offset_ns = story.session.judge, 1
    story.fly(3.0)
    assert story.session.judge is before
    story.fly(2.0, armed=False)
    story.fly(6.0)
    assert story.session.judge is not before


def test_l9_learning_that_fails_keeps_its_data_and_goes_on_with_more() -> None:
    story = Story()
    story.fly(26.0)
    assert story.at(State.FITTING)
    collected = story.state.flight_s
    story.answer("roll: the input is not exciting enough")
    assert story.at(State.LEARNING)
    assert story.session.working
    assert story.state.flight_s >= collected >= 20.0
    assert "PROP not learned, goes on: roll: the input is no.." in story.texts
    [job] = [effect for effect in story.fly(25.0) if isinstance(effect, Learn)]
    assert len(job.telemetry.need(Signal.BODY_RATE)) == pytest.approx(40 * 100, abs=10)
    story.give(Received(alive=True, imu=MessageId.SCALED_IMU2))
    assert story.state.flight_s == 0.0


def weighing(felt_g: float, t_s: float) -> Received:
    """A quarter of a second of both streams and of an accelerometer that feels so much."""
    t_ns = np.round((1.0 + t_s + np.arange(25) / 100) * 1e9).astype(np.int64)
    still, down = np.zeros((25, 3)), np.tile([0.0, 0.0, -felt_g * G], (25, 1))
    signals = ((Signal.ATTITUDE_SETPOINT, still), (Signal.BODY_RATE, still), (Signal.SPECIFIC_FORCE, down))
    return Received(Telemetry(tuple(Series(one, t_ns, t_ns, values) for one, values in signals)), alive=True)


def test_a_scale_that_gravity_contradicts_is_told_with_the_profile_to_try_and_nothing_is_judged() -> None:
    story = Story(SessionSpec(QDRONE2, baseline_for()))
    for number in range(24):
        story.passed += 25
        story.give(weighing(2.04, 0.25 * number))
    assert story.at(State.WAITING)
    assert story.session.working
    assert "PROP waiting: IMU scale 2.0 g: --profile spec" in story.texts
    notes = [effect.text for _, effect in story.log if isinstance(effect, Note) and "1 g" in effect.text]
    assert notes == ["the vehicle does not feel 1 g by the scale of the profile qdrone2, but 2.0 g: --profile spec"]
    for number in range(24, 48):
        story.passed += 25
        story.give(weighing(1.02, 0.25 * number))
    assert story.at(State.MONITORING)


@pytest.mark.parametrize("reason", HIDDEN)
def test_c1_a_vehicle_that_flies_and_is_not_judged_is_told(reason: str) -> None:
    story = watching()
    story.fly(20.0)
    effects = story.fly(12.0, **HIDDEN[reason])
    (told,) = [one for one in effects if isinstance(one, SendText) and "not judged: it" in one.text]
    assert told.severity is Severity.WARNING
    assert told.text.startswith(f"PROP not judged: {reason[:30]}")
    assert [one.text for one in effects if isinstance(one, Note)].count(f"not judged: {reason}") == 1
    assert story.state.reason == f"not judged: {reason}"
    story.fly(6.0)
    assert story.state.reason.startswith("monitoring")
    judge = story.state.judge
    assert judge is not None
    judge.judged = Instant(0)  # what judges is none of those that decide
    for held in (judge.memory.diagnosis, Diagnosis(reason="not flying")):  # until now, for it has just taken off
        judge.chain.renew(judge.memory, held)
        story.state._idle(judge, story.now)
        assert story.state.reason == "monitoring: propellers not judged"
    later = [one.text for one in story.fly(10.0) if isinstance(one, SendText)]
    assert not any("not judged: it" in text for text in later)


def test_every_state_has_a_handler_and_states_and_settings_are_documented() -> None:
    assert set(TABLE) == set(State)
    assert [state for state in State if not hasattr(Session, f"_{state}")] == [State.LOST]
    text = (DOCS / "detector.md").read_text()
    assert [name for name in Settings.model_fields if f"`{name}`" not in text] == []
    page = runpy.run_path(str(DOCS / "draw_detector_states.py"))["page"]
    assert (DOCS / "detector-states.md").read_text() == page(), "run `python docs/draw_detector_states.py`"


SECONDS = 400
ACTIONS = st.lists(
    st.one_of(
        st.tuples(st.just("fly"), st.integers(1, 8), st.sampled_from([0.0, 0.5]), st.booleans()),
        st.tuples(st.just("silence"), st.integers(1, 8)),
        st.tuples(st.just("reboot")),
        st.tuples(st.just("learned"), st.sampled_from(["qdrone2", "px4"])),
        st.tuples(st.just("failed")),
        st.tuples(st.just("ack"), st.sampled_from(MavResult)),
        st.tuples(st.just("without"), st.sampled_from([Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT])),
        st.tuples(st.just("slow"), st.integers(2, 10)),
        st.tuples(st.just("garbage"), st.integers(0, 5)),
    ),
    max_size=30,
)


def garbage(seed: int) -> Telemetry:
    """Finite numbers (the conversion lets nothing else through), but any of them, at any time."""
    rng = np.random.default_rng(seed)
    columns = {Signal.BODY_RATE: 3, Signal.ATTITUDE_SETPOINT: 3, Signal.ARMED: 1, Signal.THRUST_SETPOINT: 1}
    out = []
    for signal, k in columns.items():
        n = int(rng.integers(0, 40))
        t_ns = rng.integers(0, 2**61, n)
        out.append(Series(signal, t_ns, t_ns, rng.normal(0, 1e6, (n, k))))
    return Telemetry(tuple(out))


def act(story: Story, action: tuple[object, ...]) -> None:
    match action:
        case ("fly", int(seconds), float(push), bool(armed)):
            story.fly(seconds, push=push, armed=armed)
        case ("silence", int(seconds)):
            story.silence(seconds)
        case ("reboot",):
            story.reboots += 1
            story.fly(0.5)
        case ("learned", str(profile)):
            story.answer(baseline_for(profile))
        case ("failed",):
            story.answer("no")
        case ("ack", MavResult() as result):
            story.acknowledge(Ack(MavCmd.SET_MESSAGE_INTERVAL, result))
        case ("without", Signal() as signal):
            story.fly(3.0, without=(signal,))
        case ("slow", int(every)):
            story.fly(3.0, every=every)
        case ("garbage", int(seed)):
            story.give(Received(garbage(seed), alive=True, reboots=story.reboots))


@settings(max_examples=40)
@given(actions=ACTIONS, with_baseline=st.booleans())
@example(actions=[("fly", 5, 0.5, True), ("reboot",), ("silence", 5), ("reboot",)], with_baseline=True)
def test_whatever_happens_the_laws_hold(actions: list[tuple[object, ...]], with_baseline: bool) -> None:
    spec = SessionSpec(PROFILES["qdrone2"], baseline_for() if with_baseline else None, SessionSettings(learn=5.0))
    story = Story(spec, seconds=SECONDS)
    for action in actions:
        act(story, action)
        assert story.session.working == (not story.at(State.FAULTED))
    state, effects = State.WAITING, [effect for _, effect in story.log]
    for effect in effects:
        if isinstance(effect, StateChanged):  # one of the table's, and it begins where the one before ended
            assert effect.old is state
            assert effect.new in TABLE[state].values()
            state = effect.new
        if isinstance(effect, SendFloat):
            assert 0 < len(effect.name.encode()) <= 10
    said = [(at, effect) for at, effect in story.log if isinstance(effect, SendText)]
    for at, text in said:  # at most 50 bytes; at most 30 in any minute; never the same text twice within 2 s
        assert 0 < len(text.text.encode()) <= 50
        assert text.severity in (Severity.CRITICAL, Severity.WARNING, Severity.INFO)
        assert sum(at - 60 < when <= at for when, _ in said) <= 30
        again = [when for when, other in said if other.text == text.text and at < when < at + 2]
        assert not again, f"{text.text!r} at {at} and {again}"
    asked = [(at, effect.parameters[0]) for at, effect in story.log if isinstance(effect, SendCommand)]
    for msgid in {msgid for _, msgid in asked}:
        assert sum(one == msgid for _, one in asked) <= 1 + story.reboots + story.s / 2.0
    assert sum(isinstance(effect, Learn) for effect in effects) <= FITS * (1 + story.reboots)


def test_monitors_named_as_suspect_do_not_decide_as_long_as_another_does() -> None:
    baseline = baseline_for(names=("unbalance", "rotor_trim"))
    settings = SessionSettings(suspect=("rotor_trim",), threshold_scale=2.0)
    plain, chain = chain_of(baseline), chain_for(baseline, settings, 0)
    assert [slot.decides for slot in plain.slots] == [True, True]
    assert [slot.decides for slot in chain.slots] == [spec.decides for spec in chain.decision.slots] == [True, False]
    assert [b.threshold / a.threshold for a, b in zip(plain.slots, chain.slots, strict=True)] == [2.0, 2.0]
    with pytest.raises(BaselineError, match="suspect names every monitor that decides"):
        list(plan(Settings(baseline=Path("b"), suspect=("unbalance", "rotor_trim")), baseline, {}, None))


def test_a_flight_outside_of_the_envelope_says_which_condition_was_not_learnt() -> None:
    """And not that it waits for unbroken flight, nor a figure that changes with every look."""
    for rate, said in ((2.0, {"rotor trim": "yaw rate not learnt"}), (0.0, {})):
        telemetry = flying(3000, 5, turn=np.full(3000, rate))
        judge, streams = Judge(trim(), chain_of(trim()), Instant(0)), Streams()
        judge.step(telemetry, Instant(0))
        streams.observe(telemetry, Instant(0), PROFILES["qdrone2"])
        assert judge.not_judged(streams, Instant(30 * 10**9)) == said


def came(streams: Streams, t_s: FloatArray, now_s: float) -> None:
    t_ns = np.round(1e9 * t_s).astype(np.int64)
    gyro = Series(Signal.BODY_RATE, t_ns, t_ns, np.zeros((len(t_ns), 3)))
    streams.observe(Telemetry((gyro,)), Instant(round(now_s * 1e9)), PROFILES["ardupilot"])


def test_h5_a_link_that_stalls_changes_no_rate() -> None:
    """By arrival 0.2 s without data read 45 Hz, then 100 Hz: 204 requests in 718 s."""
    streams, seen = Streams(), []
    for k in range(100):  # 100 Hz by the vehicle's clock; every second look comes late, with all that waited
        stamps = 0.01 * np.arange(20.0 * k, 20.0 * (k + 1))
        first, rest = stamps[:3], stamps[3:]
        came(streams, first, 0.2 * k + 0.18)
        seen.append(streams.rate_hz(Signal.BODY_RATE, Instant(round((0.2 * k + 0.181) * 1e9))))
        came(streams, rest, 0.2 * k + 0.19)
    assert [one for one in seen if one is not None] == pytest.approx([100.0] * sum(one is not None for one in seen))
    came(streams, 20.0 + 0.25 * np.arange(1.0, 4.0), 21.0)
    assert streams.rate_hz(Signal.BODY_RATE, Instant(21 * 10**9)) == pytest.approx(4.0)  # and a lower one shows at once


@pytest.mark.parametrize(("many", "looks"), [(0, 1), (26, 1), (27, 2), (53, 2), (54, 3), (80, 3), (81, 4), (255, 4)])
def test_a_turn_brings_more_looks_where_there_are_many_vehicles(many: int, looks: int) -> None:
    fleet = Fleet(lambda sysid, profile: None, profile=None, only=None, datagrams=True)
    fleet.vehicles = dict.fromkeys(range(many), Vehicle(0, SessionSpec(PROFILES["qdrone2"]), Instant(0)))
    assert fleet.looks == looks


def test_a_fit_that_is_given_up_ends_its_process_and_ctrl_c_is_not_its_business() -> None:
    fitter = ProcessFitter()
    fitter.begin(1, Airframe(), Learn("qdrone2", Telemetry()))
    process = wait_for(lambda: fitter._process, "the fit begins")
    assert os.getsid(process.pid) == process.pid
    fitter.close()
    assert "exit code -9" in str(wait_for(fitter.poll, "it ends"))


@pytest.mark.parametrize("what", ["subprocess.Popen", "subprocess.Popen.communicate"])
def test_a_fitting_process_that_fails_is_an_outcome_and_nothing_waits_for_it(what: str) -> None:
    begun, fitter = threading.Event(), ProcessFitter()

    def fail(*_: object, **__: object) -> None:
        raise OSError(f"begun {begun.wait(10.0)}")

    with patch(what, fail):
        fitter.begin(1, Airframe(), Learn("qdrone2", Telemetry()))
        begun.set()
        [(vehicle, outcome)] = wait_for(fitter.poll, "it fails")
    fitter.close()
    assert (vehicle, "begun True" in outcome) == (1, True)


@dataclass
class Seen:
    """A stream that is wanted, as it comes; its own meter."""

    want: Want
    hz: float


@dataclass
class Talk:
    """A negotiation, and all that came of it with its time [s]."""

    negotiation: Negotiation = field(default_factory=lambda: Negotiation(Autopilot.ARDUPILOTMEGA))
    ticks: int = 0
    asked: list[tuple[float, int]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def wait(self, seconds: float, *seen: Seen, acks: tuple[Ack, ...] = ()) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.ticks += 1
            now = Instant(round(self.ticks * TICK_S * 1e9))
            by_signal = {stream.want.signal: stream for stream in seen}
            streams: Any = SimpleNamespace(rate_hz=lambda one, _, by=by_signal: by[one].hz)
            effects, _ = self.negotiation.step([stream.want for stream in seen], streams, acks, now)
            acks = ()
            self.asked += [(self.ticks * TICK_S, int(e.parameters[0])) for e in effects if isinstance(e, SendCommand)]
            self.notes += [one.text for one in effects if isinstance(one, Note)]


def test_a_drop_is_answered_at_once_each_time_the_rate_had_held() -> None:
    talk = Talk()
    for _ in range(20):
        talk.wait(9.0, Seen(GYRO, 100.0))
        talk.wait(0.2, Seen(GYRO, 4.0))
    assert [at for at, _ in talk.asked] == pytest.approx([9.0 + 9.2 * k for k in range(20)], abs=0.3)


@pytest.mark.parametrize("right_s", [0.2, 1.0, 2.5, 4.5])
def test_two_that_set_the_same_rate_do_not_fight(right_s: float) -> None:
    """Another one changes it before it holds: asked for ever more seldom, and never twice in 2 s."""
    talk = Talk()
    for _ in range(round(120.0 / (right_s + 0.5))):
        talk.wait(0.5, Seen(GYRO, 4.0))
        talk.wait(right_s, Seen(GYRO, 100.0))
    times = [at for at, _ in talk.asked]
    assert min(b - a for a, b in pairwise(times)) >= 2.0
    assert len(times) <= 10
    assert len([one for one in times if one > 60.0]) <= 2
    assert right_s < HELD_S


@pytest.mark.parametrize("result", [MavResult.DENIED, None])
def test_another_imu_message_is_asked_for_where_the_profiles_own_is_not_to_be_had(result: MavResult | None) -> None:
    talk = Talk()
    for _ in range(60):
        acks = () if result is None else (Ack(MavCmd.SET_MESSAGE_INTERVAL, result),)
        talk.wait(1.0, Seen(GYRO, 0.0), acks=acks)
    order = list(dict.fromkeys(msgid for _, msgid in talk.asked))
    assert order == [MessageId.RAW_IMU, MessageId.HIGHRES_IMU, LAST_RESORT]


@pytest.mark.parametrize("answers", [True, False])
def test_an_answer_counts_for_its_own_request_and_a_mute_autopilot_is_soon_asked_for_all(answers: bool) -> None:
    talk, acks, denied = Talk(), tuple[Ack, ...](), MessageId.ESC_TELEMETRY_1_TO_4
    wants = wants_of(PROFILES["ardupilot"], METERED, (100.0, 98.0, 102.0), 50.0)
    for _ in range(round(8.0 / TICK_S)):
        before = len(talk.asked)
        talk.wait(TICK_S, *(Seen(want, 0.0) for want in wants), acks=acks)
        came = [msgid for n, (_, msgid) in enumerate(talk.asked) if n >= before and n != 2]  # one is lost
        results = (MavResult.DENIED if msgid == denied else MavResult.ACCEPTED for msgid in came)
        acks = tuple(Ack(MavCmd.SET_MESSAGE_INTERVAL, result) for result in results if answers)
    times = {want.msgid: [at for at, msgid in talk.asked if msgid == want.msgid] for want in wants}
    assert max(first for first, *_ in times.values()) < 3.0
    assert [msgid for msgid, asked in times.items() if len(asked) == 1] == [denied] * answers
