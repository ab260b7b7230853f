"""Judging in flight: the chain's findings, and the alert that they add up to.

A damaged propeller leaves the margin again and again, so the monitors' events come in bursts. An alert spans a burst:
it begins with the first event and ends when none was seen for a while. It shows the worst event so far, by the ratio of
statistic to threshold.
"""

from dataclasses import dataclass, replace

from detector.alerts import Cause, Kind, Notice, evidence, figure
from detector.effects import EventClosed, EventOpened
from mavdiag.baseline import Baseline
from mavdiag.chain import Chain, ChainState, Findings, Watch
from mavdiag.decision.diagnosis import Opinion
from mavdiag.decision.events import Event
from mavdiag.telemetry import Axis, Instant, Telemetry

__all__ = [
    "Alarm",
    "Judge",
    "alarm_notice",
    "alarmed",
    "ended_notice",
    "judge_step",
    "names_of",
    "open_events",
    "recorded",
]


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """A baseline, its chain at work, and when anything was last judged (host)."""

    baseline: Baseline
    chain: Chain
    memory: ChainState
    judged: Instant
    judged_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Alarm:
    """An alert so far.

    seen: when an event was last seen. worst: by the ratio of statistic to threshold, of the events that decide if there
    are any. sure: whether there are. opinion: the latest of rotor, type and severity.
    """

    since: Instant
    seen: Instant
    worst: Event
    sure: bool
    opinion: Opinion | None = None


def judge_step(judge: Judge, telemetry: Telemetry, now: Instant) -> tuple[Judge, Findings]:
    """Judge the next telemetry."""
    memory, findings = judge.chain.step(judge.memory, telemetry)
    judged = now if findings.judged_s > 0 else judge.judged
    return replace(judge, memory=memory, judged=judged, judged_s=judge.judged_s + findings.judged_s), findings


def open_events(judge: Judge | None) -> tuple[Event, ...]:
    """Events that last, with their highest figures so far."""
    if judge is None:
        return ()
    return tuple(state.open for state in judge.memory.events if state.open is not None)


def recorded(findings: Findings) -> tuple[EventOpened | EventClosed, ...]:
    """The events of a step, for the journal."""
    return tuple(EventOpened(e) if e.end_ns is None else EventClosed(e) for e in findings.events)


def alarmed(
    alarm: Alarm | None, judge: Judge, findings: Findings, suspect: tuple[str, ...], now: Instant
) -> Alarm | None:
    """The alert after a step's findings; None if there is none yet. Without new rows nothing is seen."""
    seen = findings.events if findings.now_ns is None else (*findings.events, *open_events(judge))
    if not seen:
        return alarm
    deciding = tuple(event for event in seen if _decides(event, judge.chain) and not _suspicious(event, suspect))
    opinion = judge.memory.opinion or (None if alarm is None else alarm.opinion)
    since = now if alarm is None else alarm.since
    if alarm is None or (deciding and not alarm.sure):
        return Alarm(since, now, max(deciding or seen, key=_ratio), bool(deciding), opinion)
    news = deciding if alarm.sure else seen
    return Alarm(since, now, max((*news, alarm.worst), key=_ratio), alarm.sure, opinion)


def alarm_notice(alarm: Alarm) -> Notice:
    """The alert as it is said while it lasts."""
    held = alarm.opinion
    fault_type = None if held is None or held.fault_type is None else held.fault_type.value
    cause = Cause() if held is None else Cause(held.rotor, fault_type, held.severity)
    who = cause.who(alarm.worst)
    return Notice(Kind.FAULT if alarm.sure else Kind.SUSPECT, (who, evidence(alarm.worst)), who)


def ended_notice(alarm: Alarm, judge: Judge) -> Notice:
    """The alert is over: cleared if flight was judged since, else it only could not be watched any longer."""
    if judge.judged > alarm.seen:
        return Notice(Kind.CLEARED, (figure(alarm.seen - alarm.since, 1), evidence(alarm.worst)))
    return Notice(Kind.UNSETTLED, (evidence(alarm.worst),))


def names_of(watch: Watch) -> tuple[str, str]:
    """How settings may call a watch: by its monitor, or by its monitor and axis."""
    monitor = watch.monitor
    return _names(monitor.name, monitor.axis)


def _names(monitor: str, axis: Axis | None) -> tuple[str, str]:
    return monitor, f"{monitor}.{axis}"


def _suspicious(event: Event, suspect: tuple[str, ...]) -> bool:
    return any(name in suspect for name in _names(event.monitor, event.axis))


def _decides(event: Event, chain: Chain) -> bool:
    return any(
        watch.decides
        for watch in chain.watches
        if (watch.monitor.name, watch.monitor.axis) == (event.monitor, event.axis)
    )


def _ratio(event: Event) -> float:
    return event.statistic / event.threshold if event.threshold > 0 else float("inf")
