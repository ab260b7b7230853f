"""Judge a whole log by a baseline: one verdict, with its reason, for every log that can be opened."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mavdiag.baseline import Baseline, check_link
from mavdiag.chain import Chain, Watch, chain_of
from mavdiag.decision.events import Event
from mavdiag.errors import BaselineError, InputError
from mavdiag.logs import Log
from mavdiag.rows.align import measure_grid
from mavdiag.telemetry import NS_PER_S, Axis, Series, Signal, Telemetry

__all__ = ["JudgedEvent", "LogVerdict", "MonitorSummary", "Verdict", "between", "exit_code", "judge"]

MIN_JUDGED_S = 1.0  # less airborne flight than this supports no verdict (our choice)


class Verdict(StrEnum):
    """What can be said of a log."""

    HEALTHY = "healthy"
    FAULT = "fault"
    NOT_JUDGEABLE = "not_judgeable"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class MonitorSummary:
    """One monitor over the whole log, on the axis where it came nearest to its threshold."""

    name: str
    axis: Axis | None
    maximum: float
    threshold: float
    unit: str
    alarms: int


@dataclass(frozen=True, slots=True)
class JudgedEvent:
    """An event in seconds of the vehicle's clock. end_s is None if it lasted to the end of the log."""

    t_s: float
    end_s: float | None
    event: Event


@dataclass(frozen=True, slots=True)
class LogVerdict:
    """The verdict on one log. judged_s: airborne time that was judged; rate_hz: of the gyro stream."""

    log: str
    verdict: Verdict
    reason: str
    judged_s: float = 0.0
    profile: str = ""
    rate_hz: float = 0.0
    monitors: tuple[MonitorSummary, ...] = ()
    events: tuple[JudgedEvent, ...] = ()


def judge(log: Log, baseline: Baseline) -> LogVerdict:
    """Run the chain over a log. A log that the baseline cannot judge is `not_judgeable`, with the reason."""
    try:
        log.telemetry.need(Signal.ATTITUDE_SETPOINT)
        dt_s, _ = measure_grid(log.telemetry)
    except InputError as error:
        return LogVerdict(log.name, Verdict.NOT_JUDGEABLE, str(error), profile=log.profile)
    try:
        check_link(baseline, profile=log.profile, dt_s=dt_s)
    except BaselineError as error:
        return LogVerdict(
            log.name, Verdict.NOT_JUDGEABLE, f"another link: {error}", profile=log.profile, rate_hz=1 / dt_s
        )
    return _run(log, chain_of(baseline), 1 / dt_s)


def between(telemetry: Telemetry, from_s: float | None, to_s: float | None) -> Telemetry:
    """The part of a log between two times of the vehicle's clock [s]. Raises InputError if it is empty."""
    if from_s is None and to_s is None:
        return telemetry
    low = np.iinfo(np.int64).min if from_s is None else round(from_s * NS_PER_S)
    high = np.iinfo(np.int64).max if to_s is None else round(to_s * NS_PER_S)
    kept = tuple(_cut(series, int(low), int(high)) for series in telemetry.series)
    if not any(len(series) for series in kept):
        times = [int(t) for series in telemetry.series if len(series) for t in (series.t_ns.min(), series.t_ns.max())]
        span = f"it goes from {min(times) / NS_PER_S:.1f} to {max(times) / NS_PER_S:.1f} s" if times else "it is empty"
        raise InputError(f"no data between {from_s} s and {to_s} s of the vehicle's clock; {span}")
    return Telemetry(kept)


def exit_code(verdicts: Sequence[Verdict]) -> int:
    """Exit code of a scan: the first of 2 error, 1 fault, 3 not judgeable that occurs, else 0."""
    order = ((Verdict.ERROR, 2), (Verdict.FAULT, 1), (Verdict.NOT_JUDGEABLE, 3))
    return next((code for verdict, code in order if verdict in verdicts), 0)


def _cut(series: Series, low_ns: int, high_ns: int) -> Series:
    keep = (series.t_ns >= low_ns) & (series.t_ns < high_ns)
    return Series(series.signal, series.t_ns[keep], series.host_ns[keep], series.values[keep])


def _run(log: Log, chain: Chain, rate_hz: float) -> LogVerdict:
    state, first = chain.step(chain.start(), log.telemetry)
    last = chain.finish(state)
    judged_s = first.judged_s + last.judged_s
    if judged_s < MIN_JUDGED_S:
        reason = "never airborne: no armed flight with thrust" if judged_s == 0 else f"only {judged_s:.1f} s airborne"
        return LogVerdict(log.name, Verdict.NOT_JUDGEABLE, reason, judged_s, log.profile, rate_hz)
    events = _merged((*first.events, *last.events))
    peaks = tuple(max(a, b) for a, b in zip(first.peaks, last.peaks, strict=True))
    monitors = _summaries(chain.watches, peaks, events)
    judged = tuple(JudgedEvent(e.start_ns / NS_PER_S, _seconds(e.end_ns), e) for e in events)
    deciding = {(watch.monitor.name, watch.monitor.axis) for watch in chain.watches if watch.decides}
    faults = [event for event in events if (event.monitor, event.axis) in deciding]
    verdict = Verdict.FAULT if faults else Verdict.HEALTHY
    return LogVerdict(log.name, verdict, _reason(faults, events), judged_s, log.profile, rate_hz, monitors, judged)


def _merged(found: Sequence[Event]) -> tuple[Event, ...]:
    """Each event once, as it was last told, in order of time."""
    latest = {(event.monitor, event.axis, event.start_ns): event for event in found}
    return tuple(sorted(latest.values(), key=lambda event: (event.start_ns, event.monitor, str(event.axis))))


def _summaries(watches: Sequence[Watch], peaks: Sequence[float], events: Sequence[Event]) -> tuple[MonitorSummary, ...]:
    nearest: dict[str, MonitorSummary] = {}
    for watch, peak in zip(watches, peaks, strict=True):
        monitor = watch.monitor
        alarms = sum(event.monitor == monitor.name for event in events)
        one = MonitorSummary(monitor.name, monitor.axis, peak, watch.threshold, monitor.unit, alarms)
        old = nearest.get(one.name)
        if old is None or one.maximum * old.threshold > old.maximum * one.threshold:
            nearest[one.name] = one
    return tuple(nearest.values())


def _seconds(t_ns: int | None) -> float | None:
    return None if t_ns is None else t_ns / NS_PER_S


def _reason(faults: Sequence[Event], events: Sequence[Event]) -> str:
    """The worst evidence in one line; a suspicion that nothing confirmed is said to be one."""
    if not events:
        return "no monitor above its threshold"
    worst = max(faults or events, key=lambda event: event.statistic / event.threshold if event.threshold else 0.0)
    axis = f" on {worst.axis}" if worst.axis is not None else ""
    rotor = f"; rotor {worst.rotor}" if worst.rotor is not None else ""
    kind = f"; {worst.fault_type}" if worst.fault_type is not None else ""
    count = f"{len(faults or events)} alarm{'s' if len(faults or events) > 1 else ''}"
    evidence = f"{worst.monitor}{axis} {worst.statistic:.3g} > {worst.threshold:.3g}{rotor}{kind}, {count}"
    return evidence if faults else f"only suspected: {evidence}"
