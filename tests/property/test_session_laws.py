"""Laws of a session, whatever comes in, in whatever order."""

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from made_session import Story, baseline_for

from detector.config import SessionSettings
from detector.session import FITS
from detector.states import TABLE, State
from detector.values import (
    AskInterval,
    Effect,
    Inbox,
    Learn,
    LearningFailed,
    SendFloat,
    SendText,
    SessionSpec,
    StateChanged,
)
from mavdiag.link.messages import MavCmd, MavResult, Severity
from mavdiag.link.profiles import PROFILES
from mavdiag.link.vehicles import Ack
from mavdiag.telemetry import Series, Signal, Telemetry

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
            story.answer(LearningFailed("no"))
        case ("ack", MavResult() as result):
            story.acknowledge(Ack(MavCmd.SET_MESSAGE_INTERVAL, result))
        case ("without", Signal() as signal):
            story.fly(3.0, without=(signal,))
        case ("slow", int(every)):
            story.fly(3.0, every=every)
        case ("garbage", int(seed)):
            story.give(Inbox(garbage(seed), alive=True, reboots=story.reboots))


@settings(max_examples=40)
@given(actions=ACTIONS, with_baseline=st.booleans())
@example(actions=[("fly", 5, 0.5, True), ("reboot",), ("silence", 5), ("reboot",)], with_baseline=True)
def test_whatever_happens_the_laws_hold(actions: list[tuple[object, ...]], with_baseline: bool) -> None:
    spec = SessionSpec(PROFILES["qdrone2"], baseline_for() if with_baseline else None, SessionSettings(learn=5.0))
    story = Story(spec, seconds=SECONDS)
    for action in actions:
        act(story, action)
        assert story.session.working == (not story.at(State.FAULTED))
    effects = [effect for _, effect in story.log]
    check_transitions(effects)
    check_texts(story)
    for effect in effects:
        if isinstance(effect, SendFloat):
            assert 0 < len(effect.name.encode()) <= 10
    asked = [(at, effect.msgid) for at, effect in story.log if isinstance(effect, AskInterval)]
    for msgid in {msgid for _, msgid in asked}:
        assert sum(one == msgid for _, one in asked) <= 1 + story.reboots + story.s / 2.0
    assert sum(isinstance(effect, Learn) for effect in effects) <= FITS * (1 + story.reboots)


def check_transitions(effects: list[Effect]) -> None:
    """Each change is one of the table's, and begins where the one before ended."""
    at = State.WAITING
    for effect in effects:
        if isinstance(effect, StateChanged):
            assert effect.old is at
            assert effect.new in TABLE[at].values()
            at = effect.new


def check_texts(story: Story) -> None:
    """At most 50 bytes; at most 30 in any minute; never the same text twice within 2 s."""
    said = [(at, effect) for at, effect in story.log if isinstance(effect, SendText)]
    for at, effect in said:
        assert 0 < len(effect.text.encode()) <= 50
        assert effect.severity in (Severity.CRITICAL, Severity.WARNING, Severity.INFO)
        minute = [other for when, other in said if at - 60 < when <= at]
        assert len(minute) <= 30
        again = [when for when, other in said if other.text == effect.text and at < when < at + 2]
        assert not again, f"{effect.text!r} at {at} and {again}"
