"""What a session does in each state: one function a state, all of the same shape."""

from collections.abc import Mapping
from dataclasses import replace

from detector.alerts import Kind, Notice, figure
from detector.collect import Collection, collect
from detector.effects import BaselineLearned, Learn, Note
from detector.judge import Alarm, Judge, alarm_notice, alarmed, ended_notice, judge_step, names_of, recorded
from detector.negotiate import in_hand
from detector.states import State, Trigger
from detector.streams import Hindrance, Reason, hindrance, on_ground
from detector.twins import tell
from detector.values import Handler, Inbox, LearningFailed, Next, SessionSpec, SessionState, move
from mavdiag.baseline import RATE_TOLERANCE, Baseline, check_link
from mavdiag.chain import chain_of
from mavdiag.errors import BaselineError
from mavdiag.learning import gate_for
from mavdiag.link.samples import joined
from mavdiag.telemetry import Instant

__all__ = ["HANDLERS"]

WAITED_CHUNKS = 256  # kept while the streams are measured: some ten seconds (our choice)
IDLE_S = 3.0  # that nothing is judged is said after so long (our choice)
PROGRESS_STEP = 25  # percent of learning between two texts


def _waiting(spec: SessionSpec, state: SessionState, inbox: Inbox, now: Instant) -> Next:
    state = replace(state, waited=(*state.waited, inbox.telemetry)[-WAITED_CHUNKS:])
    baseline, lack = state.baseline, hindrance(state.streams, spec.min_rate_hz)
    refusal = None if baseline is None else _mismatch(spec, baseline, baseline.link.dt_s)
    if baseline is not None and refusal is None and lack is None:
        period_s = state.streams.gyro.period_s or 0.0
        refusal = _mismatch(spec, baseline, period_s)
        if refusal and spec.negotiate and in_hand(state.negotiation, spec.profile.imu):
            lack, refusal = Hindrance(Reason.OTHER_RATE, f"({1 / period_s:.0f} Hz)"), None
    if refusal is not None:
        return _off(state, Trigger.REFUSED, refusal)
    if lack is not None:
        return replace(state, reason=lack.text), (Notice(Kind.WAITING, (lack.text,), lack.reason),)
    if baseline is None:
        state, changed = move(replace(state, waited=()), Trigger.READY_TO_LEARN)
        return state, (changed,)
    return _begin(spec, state, baseline, now)


def _begin(spec: SessionSpec, state: SessionState, baseline: Baseline, now: Instant) -> Next:
    """Judge by the baseline, or go on with it."""
    judge = state.judge
    if judge is None or judge.baseline is not baseline:
        try:
            chain = chain_of(baseline)
        except BaselineError as error:
            return _off(state, Trigger.REFUSED, str(error))
        judge = Judge(baseline, chain, chain.start(), now)
    judge, findings = judge_step(replace(judge, judged=now), joined(state.waited), now)
    state, changed = move(replace(state, judge=judge, waited=()), Trigger.READY_TO_JUDGE)
    unknown = set(spec.suspect) - {name for watch in judge.chain.watches for name in names_of(watch)}
    notes = (Note(f"suspect: there is no monitor {name!r}") for name in sorted(unknown))
    return state, (changed, *recorded(findings), *notes)


def _mismatch(spec: SessionSpec, baseline: Baseline, period_s: float) -> str | None:
    """In what the link differs from the baseline's, if it does."""
    try:
        check_link(baseline, profile=spec.profile.name, dt_s=period_s)
    except BaselineError as error:
        return str(error)
    return None


def _off(state: SessionState, trigger: Trigger, reason: str) -> Next:
    state, changed = move(state, trigger, reason)
    return state, (changed, Notice(Kind.OFF, (reason,)))


def _learning(spec: SessionSpec, state: SessionState, inbox: Inbox, now: Instant) -> Next:
    lack = hindrance(state.streams, spec.min_rate_hz)
    if lack is not None:
        state, changed = move(state, Trigger.STREAMS_LOST, lack.text)
        return state, (changed,)
    ground = on_ground(state.streams, gate_for(spec.profile.name))
    if ground is None:
        period_s = state.streams.gyro.period_s or 0.0
        state = replace(state, collection=collect(state.collection, inbox.telemetry, period_s))
    if state.collection.seconds >= spec.learn_s:
        job = Learn(spec.profile.name, state.collection.telemetry)
        state, changed = move(replace(state, collection=Collection()), Trigger.COLLECTED)
        return state, (changed, job, Notice(Kind.FITTING))
    percent = int(100 * state.collection.seconds / spec.learn_s)
    shown, why = percent - percent % PROGRESS_STEP, f": {ground.text}" if ground else ""
    state = replace(state, reason=f"{percent} % of {spec.learn_s:g} s{why}")
    return state, (Notice(Kind.LEARNING, (str(shown), why), f"{shown}{why}"),)


def _fitting(spec: SessionSpec, state: SessionState, inbox: Inbox, now: Instant) -> Next:
    outcome = inbox.outcome
    if outcome is None:
        return state, ()
    if isinstance(outcome, LearningFailed):
        return _off(state, Trigger.NOT_FITTED, f"cannot learn: {outcome.reason}")
    baseline = outcome.baseline
    fml_s = max((limit.value for _, limit in baseline.latency), default=0.0)
    state, changed = move(replace(state, baseline=baseline), Trigger.FITTED)
    return state, (changed, BaselineLearned(baseline), Notice(Kind.LEARNED, (figure(fml_s),)))


def _judging(spec: SessionSpec, state: SessionState, inbox: Inbox, now: Instant) -> Next:
    judge, lack = state.judge, _unfit(spec, state)
    if judge is None or lack is not None:
        alarm = state.alarm
        state, changed = move(replace(state, alarm=None), Trigger.STREAMS_LOST, lack.text if lack else "")
        return state, (changed, *(() if alarm is None or judge is None else (ended_notice(alarm, judge),)))
    judge, findings = judge_step(judge, inbox.telemetry, now)
    alarm = alarmed(state.alarm, judge, findings, spec.suspect, now)
    twins, floats = tell(state.twins, judge.chain.watches, findings, now)
    state = replace(state, judge=judge, twins=twins, alarm=alarm)
    state, more = _alert(spec, state, judge, alarm, now) if alarm else _quiet(state, judge, now)
    return state, (*recorded(findings), *floats, *more)


def _unfit(spec: SessionSpec, state: SessionState) -> Hindrance | None:
    """Why the streams cannot be judged any longer. The rate may wander a little more than when it was accepted."""
    lack, period_s, judge = hindrance(state.streams, spec.min_rate_hz), state.streams.gyro.period_s, state.judge
    if lack is not None or period_s is None or judge is None:
        return lack
    if abs(period_s / judge.baseline.link.dt_s - 1.0) > 2.0 * RATE_TOLERANCE:
        return Hindrance(Reason.OTHER_RATE, f"({1 / period_s:.0f} Hz)")
    return None


def _alert(spec: SessionSpec, state: SessionState, judge: Judge, alarm: Alarm, now: Instant) -> Next:
    notice, out = alarm_notice(alarm), []
    if state.state is State.MONITORING:
        state, changed = move(state, Trigger.ALARM, notice.text)
        out.append(changed)
    if now - alarm.seen >= spec.clear_s:
        notice = ended_notice(alarm, judge)
        state, changed = move(replace(state, alarm=None), Trigger.QUIET, notice.text)
        out.append(changed)
    else:
        state = replace(state, reason=notice.text)
    return state, (*out, notice)


def _quiet(state: SessionState, judge: Judge, now: Instant) -> Next:
    """Nothing found: say what is watched, and why nothing is judged if nothing is."""
    why = ""
    if now - judge.judged >= IDLE_S:
        gate = judge.chain.front.gate
        why = f": {(on_ground(state.streams, gate) or Hindrance(Reason.GAPS)).text}"
    watched = (watch.monitor.axis for watch in judge.chain.watches)
    axes = ", ".join(dict.fromkeys(axis.value for axis in watched if axis is not None))
    return replace(state, reason=f"{axes}{why}"), (Notice(Kind.MONITORING, (axes, why), why),)


HANDLERS: Mapping[State, Handler] = {
    State.WAITING: _waiting,
    State.LEARNING: _learning,
    State.FITTING: _fitting,
    State.MONITORING: _judging,
    State.ALERT: _judging,
    State.LOST: lambda spec, state, inbox, now: (state, ()),
    State.FAULTED: lambda spec, state, inbox, now: (state, (Notice(Kind.OFF, (state.reason,)),)),
}
