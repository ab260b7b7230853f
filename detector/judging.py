"""Judging in flight: the chain at work, the alert that its stages add up to, and which monitors do not judge.

A damaged propeller leaves the margin again and again, so the decision's stage comes and goes. An alert spans a burst:
it begins with the first suspicion or fault and ends when there was none for a while.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from detector.alerts import Notice, alert_notice, label_of
from detector.streams import METERED, Streams
from detector.values import EventClosed, EventOpened, Note, Record
from mavdiag.baseline import Baseline
from mavdiag.chain import Chain, ChainOutput, ChainState, Gauge, Piece
from mavdiag.decision.alarm import Change, Diagnosis, Stage
from mavdiag.link.wants import LABELS
from mavdiag.telemetry import Instant, Telemetry

__all__ = ["Alert", "Judge", "alert_after", "not_judged", "records_of", "rescaled", "words_of"]

WARM_S = 10.0  # flight in which a monitor ought to have judged something (our choice: twice the longest warm-up)
STREAM_S = 5.0  # how long a stream may take to come before its absence is reported (our choice)
ALERTING = (Stage.SUSPECTED, Stage.FAULT)

Finding: TypeAlias = Change | Diagnosis


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """A baseline and its chain at work.

    judged: when anything was judged last (host).
    judged_s: flight time in which a deciding monitor judged, so far.
    flight_s: flight time so far.
    gauges: the latest value of every monitor that has one.
    pieces: what the latest step gave, for a display.
    """

    baseline: Baseline
    chain: Chain
    memory: ChainState
    judged: Instant
    judged_s: float = 0.0
    flight_s: float = 0.0
    gauges: tuple[Gauge, ...] = ()
    pieces: tuple[Piece, ...] = ()

    def step(self, telemetry: Telemetry, now: Instant) -> tuple["Judge", ChainOutput]:
        """Judge the next telemetry."""
        memory, output = self.chain.step(self.memory, telemetry)
        judged = now if output.judged_s > 0 else self.judged
        judged_s, flight_s = self.judged_s + output.judged_s, self.flight_s + output.flight_s
        gauges = output.gauges or self.gauges
        counts = (judged, judged_s, flight_s)
        return Judge(self.baseline, self.chain, memory, *counts, gauges, output.pieces), output

    def end_flight(self) -> tuple["Judge", ChainOutput]:
        """The flight cannot be followed any longer: what is open is closed."""
        memory, output = self.chain.end_flight(self.memory)
        return replace(self, memory=memory, gauges=(), pieces=()), output


@dataclass(frozen=True, slots=True)
class Alert:
    """An alert so far.

    since: when it began (host).
    latest: when there was a suspicion or a fault last (host).
    finding: the latest of them.
    confirmed: whether a fault was declared, not only suspected.
    active: whether the finding is above its threshold at this moment; the stage lasts somewhat longer.
    waned: whether the stage was left at some moment; what comes after is the fault going, and no news.
    named: whether a rotor was named; it is news once.
    """

    since: Instant
    latest: Instant
    finding: Finding
    confirmed: bool
    active: bool = True
    waned: bool = False
    named: bool = False

    @property
    def notice(self) -> Notice:
        """What is said of it while it lasts: nothing new while its finding does not hold."""
        return alert_notice(
            self.finding, fault=self.confirmed, key="named" if self.named else "", silent=not self.active
        )


def rescaled(baseline: Baseline, scale: float) -> Baseline:
    """The baseline with all thresholds times a factor; its digest stays that of the file."""
    if scale == 1.0:
        return baseline
    monitors = []
    for entry in baseline.monitors:
        old = entry.threshold
        new = replace(old, value=scale * old.value, session_allowance=scale * old.session_allowance)
        monitors.append(entry.model_copy(update={"threshold": new}))
    return baseline.model_copy(update={"monitors": tuple(monitors)})


def alert_after(
    alert: Alert | None, output: ChainOutput, diagnosis: Diagnosis, suspect: frozenset[str], now: Instant
) -> Alert | None:
    """The alert after a step's output; None if there is none yet. Without new rows nothing changes."""
    if output.now_ns is None:
        return alert
    latest: tuple[Finding, ...] = (*output.changes, diagnosis)
    found = [one for one in latest if one.stage in ALERTING]
    faults = [one for one in found if one.stage is Stage.FAULT and not suspect & _names(one)]
    if not found or (alert is not None and alert.confirmed and not faults):
        return alert and replace(alert, active=False, waned=True, latest=now if found else alert.latest)
    above = [one for one in faults if one.statistic > one.threshold]
    finding, active = (above or faults or found)[-1], bool(above) or not faults
    if alert is None:
        return Alert(now, now, finding, bool(faults), active, named=finding.rotor is not None)
    named = alert.named or (not alert.waned and finding.rotor is not None)
    return replace(alert, latest=now, finding=finding, confirmed=bool(faults), active=active, named=named)


def records_of(output: ChainOutput, whose: str) -> tuple[Record, ...]:
    """The events and changes of a step, for the journal, and how the vehicle differs. whose: the baseline's vehicle."""
    events = (EventOpened(event) if event.end_ns is None else EventClosed(event) for event in output.events)
    differs = "" if output.likeness is None else output.likeness.sentence(whose)
    return (*events, *output.changes, *((Note(differs),) if differs else ()))


def not_judged(judge: Judge, streams: Streams, now: Instant) -> tuple[tuple[str, str], ...]:
    """Label and reason of the monitors that do not judge: their streams do not come, or in flight they never judged.

    A condition outside of the envelope is named without its figures: these move, and a text that moves is news.
    """
    if streams.began is None or now - streams.began < STREAM_S:
        return ()
    found: dict[str, str] = {}
    for slot, account in zip(judge.chain.slots, judge.memory.accounts, strict=True):
        missing = [one for one in METERED if one in slot.monitor.signals and streams.meter(one).latest is None]
        if missing:
            found[label_of(slot.monitor.name)] = f"no {LABELS[missing[0]]}"
        elif judge.flight_s > WARM_S and not account.judged_s:
            outside = {f"{condition} not learnt": one.span_s for condition, one in account.outside.items()}
            reasons = {**account.not_judged, **outside}
            if reasons:
                found[label_of(slot.monitor.name)] = max(reasons, key=lambda reason: reasons[reason])
    return tuple(found.items())


def words_of(unjudged: Sequence[tuple[str, str]]) -> tuple[str, str]:
    """What is said of monitors that do not judge, in full and for a text. unjudged: as `not_judged` has them."""
    label, reason = unjudged[0]
    short = f"; {label}: {reason}" if len(unjudged) == 1 else f"; not {', '.join(one for one, _ in unjudged)}"
    return "".join(f"; {one} not judged: {why}" for one, why in unjudged), short


def _names(finding: Finding) -> frozenset[str]:
    return frozenset((str(finding.monitor), f"{finding.monitor}.{finding.axis}"))
