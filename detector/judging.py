"""Judging in flight: the chain at work, and which monitors do not judge."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from detector.alerts import label_of
from detector.config import SessionSettings
from detector.sight import Sight
from detector.streams import METERED, Streams
from detector.values import EventClosed, EventOpened, Note, Record
from mavdiag.baseline import Baseline, without_mute
from mavdiag.chain import Chain, ChainOutput, ChainState, chain_of
from mavdiag.errors import BaselineError
from mavdiag.kernel import Account, Gauge, Piece
from mavdiag.link.wants import LABELS
from mavdiag.monitors.base import Monitor
from mavdiag.telemetry import Instant, Telemetry

__all__ = ["Judge", "chain_for", "not_judged", "records_of", "rescaled", "words_of"]

WARM_S = 10.0  # flight in which a monitor ought to have judged something (our choice: twice the longest warm-up)
STREAM_S = 5.0  # how long a stream may take to come before its absence is reported (our choice)


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """A baseline and its chain at work.

    judged: when anything was judged last (host).
    judged_s: flight time in which a deciding monitor judged, so far.
    flight_s: flight time so far.
    pieces: what the latest step gave, for a display. latest: the same of the latest one that gave any.
    sight: whether it flies although nothing is judged.
    """

    baseline: Baseline
    chain: Chain
    memory: ChainState
    judged: Instant
    judged_s: float = 0.0
    flight_s: float = 0.0
    pieces: tuple[Piece, ...] = ()
    latest: tuple[Piece, ...] = ()
    sight: Sight = field(default_factory=Sight)

    def step(self, telemetry: Telemetry, now: Instant) -> tuple["Judge", ChainOutput]:
        """Judge the next telemetry."""
        memory, output = self.chain.step(self.memory, telemetry)
        judged = now if output.judged_s > 0 else self.judged
        judged_s, flight_s = self.judged_s + output.judged_s, self.flight_s + output.flight_s
        latest = output.pieces[-1:] or self.latest
        counts = (judged, judged_s, flight_s)
        sight = self.sight.step(self.chain, telemetry, output)
        return Judge(self.baseline, self.chain, memory, *counts, output.pieces, latest, sight), output

    @property
    def gauges(self) -> tuple[Gauge, ...]:
        """The latest value of every monitor that has one."""
        return self.latest[-1].gauges if self.latest else ()

    def end_flight(self) -> tuple["Judge", ChainOutput]:
        """The flight cannot be followed any longer: what is open is closed."""
        memory, output = self.chain.end_flight(self.memory)
        return replace(self, memory=memory, pieces=(), latest=()), output


def rescaled(baseline: Baseline, scale: float) -> Baseline:
    """The baseline with all thresholds times a factor, without monitors that could not reach theirs then.

    Its digest stays that of the file. Raises BaselineError if no monitor is left.
    """
    if scale == 1.0:
        return baseline
    monitors = []
    for entry in baseline.monitors:
        old = entry.threshold
        new = replace(old, value=scale * old.value, session_allowance=scale * old.session_allowance)
        monitors.append(entry.model_copy(update={"threshold": new}))
    judging, refusals = without_mute(monitors, f"thresholds are taken times {scale:g}")
    if not judging:
        raise BaselineError(f"no monitor can judge: {refusals[0].monitor}: {refusals[0].reason}")
    return baseline.model_copy(update={"monitors": judging, "not_judgeable": (*baseline.not_judgeable, *refusals)})


def chain_for(baseline: Baseline, settings: SessionSettings, started_ns: int) -> Chain:
    """The chain of a baseline as the settings have it: its thresholds, and the monitors that only raise a suspicion.

    started_ns: as in `chain_of`. Raises BaselineError if no monitor is left that decides.
    """
    chain = chain_of(rescaled(baseline, settings.threshold_scale), started_ns)
    suspect = set(settings.suspect)
    slots = tuple(replace(one, decides=one.decides and not _names(one.monitor) & suspect) for one in chain.slots)
    if chain.slots and not any(slot.decides for slot in slots):
        raise BaselineError("suspect names every monitor that decides")
    return replace(chain, decision=replace(chain.decision, slots=slots))


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
    accounts: tuple[Account, ...] = ()
    for number, (slot, silent) in enumerate(zip(judge.chain.slots, judge.memory.silent, strict=True)):
        missing = [one for one in METERED if one in slot.monitor.signals and streams.meter(one).latest is None]
        if missing:
            found[label_of(slot.monitor.name)] = f"no {LABELS[missing[0]]}"
        elif judge.flight_s > WARM_S and silent:
            accounts = accounts or judge.memory.accounts
            account = accounts[number]
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


def _names(monitor: Monitor[Any]) -> frozenset[str]:
    return frozenset((monitor.name, f"{monitor.name}.{monitor.axis}"))
