"""One vehicle's session, sans I/O: `step(spec, state, inbox, now) -> (state, effects)`.

What may follow what is in `states`, what is done in each state in `handlers`, what is said of it in `alerts`. `now` is
the host's clock and rules what is said and given up; the judgement itself runs on the vehicle's clock.
"""

from dataclasses import replace

from detector.alerts import Kind, Notice, Speaker, figure, speak
from detector.collect import Collection
from detector.effects import Effect, EventClosed
from detector.handlers import HANDLERS
from detector.negotiate import Negotiation, Want, negotiate
from detector.states import TABLE, State, Trigger
from detector.streams import Streams, observe, rate_hz
from detector.twins import Twins
from detector.values import Inbox, Learned, LearningFailed, Next, Out, SessionSpec, SessionState, move
from mavdiag.baseline import RATE_TOLERANCE, Baseline
from mavdiag.telemetry import Instant

__all__ = ["Inbox", "Learned", "LearningFailed", "SessionSpec", "SessionState", "finish", "healthy", "start", "step"]


def start(spec: SessionSpec, now: Instant) -> SessionState:
    """A vehicle was heard for the first time."""
    speaker, twins = Speaker(spec.texts_per_minute), Twins(1.0 / spec.twins_hz, spec.twins_axis)
    return SessionState(State.WAITING, "just heard", now, spec.baseline, speaker, twins)


def step(spec: SessionSpec, state: SessionState, inbox: Inbox, now: Instant) -> tuple[SessionState, tuple[Effect, ...]]:
    """Take in what came since the last step. Call it regularly, with an empty inbox too: time alone changes things."""
    out: list[Out] = []
    for phase in (_link, _reboot, _streams, _work):
        state, more = phase(spec, state, inbox, now)
        out += more
    speaker, said = speak(state.speaker, tuple(one for one in out if isinstance(one, Notice)), now)
    return replace(state, speaker=speaker), (*(one for one in out if not isinstance(one, Notice)), *said)


def finish(state: SessionState) -> tuple[Effect, ...]:
    """The daemon stops, or the vehicle started anew: the rows that waited are judged, and events that are still open
    are told with the end not seen."""
    if state.judge is None:
        return ()
    findings = state.judge.chain.finish(state.judge.memory)
    latest = {(event.monitor, event.axis, event.start_ns): event for event in findings.events}
    return tuple(EventClosed(event) for event in latest.values())


def healthy(state: SessionState) -> bool:
    """Whether the session does its work or still hopes to: only then its heartbeat goes out."""
    return state.state is not State.FAULTED


def _link(spec: SessionSpec, state: SessionState, inbox: Inbox, now: Instant) -> Next:
    if inbox.heard:
        away_s = now - state.heard
        state = replace(state, heard=now)
        if state.state is State.LOST:
            state, changed = move(state, Trigger.LINK_BACK)
            return state, (changed, Notice(Kind.LINK_BACK, (figure(away_s, 1),)))
    elif now - state.heard > spec.link_lost_s and Trigger.LINK_LOST in TABLE[state.state]:
        lost = replace(state, alarm=None, streams=Streams(), negotiation=Negotiation())
        state, changed = move(lost, Trigger.LINK_LOST, f"nothing heard for {spec.link_lost_s:g} s")
        return state, (changed, Notice(Kind.LINK_LOST))
    return state, ()


def _reboot(spec: SessionSpec, state: SessionState, inbox: Inbox, now: Instant) -> Next:
    """What was measured, collected or judged belongs to the time before; the baseline stays."""
    if inbox.reboots == state.reboots or Trigger.REBOOT not in TABLE[state.state]:
        return state, ()
    ended = finish(state)
    state, changed = move(state, Trigger.REBOOT)
    fresh = replace(
        state,
        reboots=inbox.reboots,
        streams=Streams(),
        negotiation=Negotiation(),
        collection=Collection(),
        judge=None,
        alarm=None,
    )
    return fresh, (*ended, changed, Notice(Kind.REBOOT))


def _streams(spec: SessionSpec, state: SessionState, inbox: Inbox, now: Instant) -> Next:
    """Watch the streams, and ask for what they lack."""
    if state.state is State.LOST:
        return state, ()
    streams = observe(state.streams, inbox.telemetry, now)
    state = replace(state, streams=streams)
    if not spec.negotiate or state.state in (State.FITTING, State.FAULTED):
        return state, ()
    setpoint, imu = _wants(spec, state.baseline)
    wants = ((setpoint, rate_hz(streams, streams.setpoint, now)), (imu, rate_hz(streams, streams.gyro, now)))
    negotiation, effects, notices = negotiate(state.negotiation, wants, inbox.acks, now)
    return replace(state, negotiation=negotiation), (*effects, *notices)


def _wants(spec: SessionSpec, baseline: Baseline | None) -> tuple[Want, Want]:
    """Set-points and IMU: at the baseline's rate, or at any that will do to learn."""
    profile, least_hz = spec.profile, spec.min_rate_hz
    if baseline is None:
        ask_hz = spec.ask_hz or profile.rate_hz
        return Want(profile.setpoint, ask_hz, least_hz), Want(profile.imu, ask_hz, least_hz)
    exact_hz = 1.0 / baseline.link.dt_s
    imu = Want(profile.imu, exact_hz, exact_hz / (1.0 + RATE_TOLERANCE), exact_hz / (1.0 - RATE_TOLERANCE))
    return Want(profile.setpoint, exact_hz, min(least_hz, imu.least_hz)), imu


def _work(spec: SessionSpec, state: SessionState, inbox: Inbox, now: Instant) -> Next:
    return HANDLERS[state.state](spec, state, inbox, now)
