"""Judging in flight: the chain's findings, and the alert that they add up to.

A damaged propeller leaves the margin again and again, so the monitors' events come in bursts. An alert spans a burst:
it begins with the first event and ends when none was seen for a while. It shows the worst event so far, by the ratio of
statistic to threshold.
"""

from dataclasses import dataclass, replace

from detector.alerts import Cause, Kind, Notice, evidence, figure
from detector.effects import EventClosed, EventOpened
from mavdiag.baseline import Baseline
from mavdiag.diagnose.events import Event
from mavdiag.pipeline import Chain, ChainState, Findings, Watch
from mavdiag.quantities import Axis, Instant, Telemetry

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
    """An alert so far. seen: when an event was last seen; sure: whether a monitor that declares faults took part."""

    since: Instant
    seen: Instant
    worst: Event
    sure: bool


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
    worst = max(seen if alarm is None else (*seen, alarm.worst), key=_ratio)
    sure = not all(_suspicious(event, suspect) for event in seen) or (alarm is not None and alarm.sure)
    return Alarm(now if alarm is None else alarm.since, now, worst, sure)


def alarm_notice(alarm: Alarm) -> Notice:
    """The alert as it is said while it lasts."""
    who = Cause().who(alarm.worst)
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


def _ratio(event: Event) -> float:
    return event.statistic / event.threshold if event.threshold > 0 else float("inf")
