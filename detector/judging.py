"""Judging in flight: the chain at work, which monitors do not judge, and whether it flies although none does."""

from collections.abc import Hashable
from dataclasses import replace

from detector.alerts import Kind, Notice
from detector.config import SessionSettings
from detector.streams import Streams
from detector.values import EventClosed, EventOpened, Note, Record
from mavdiag.baseline import Baseline, without_mute
from mavdiag.chain import Chain, ChainOutput, chain_of
from mavdiag.decision.alarm import NOTHING_SEEN, Change, Diagnosis, Stage, landed
from mavdiag.errors import BaselineError
from mavdiag.kernel import Account, Piece, Slot
from mavdiag.link.samples import joined
from mavdiag.link.wants import LABELS
from mavdiag.monitors import NEED_LAYOUT
from mavdiag.rows.gate import HIDDEN_S, SHOWS_FLIGHT, hidden_flight
from mavdiag.telemetry import Instant, Telemetry
from mavdiag.units import NS_PER_S

WARM_S = 20.0  # flight in which a monitor ought to have judged something (our choice: twice the longest warm-up)
ASK_S = 1.0  # between two looks at what the monitors do not judge: accounts cost more than a step (our choice)
STREAM_S = 5.0  # how long a stream may take to come before its absence is reported (our choice)
FLOWN_NS = 20 * NS_PER_S  # of what flew last, which shows what is usual in flight (our choice)
LATEST_NS = 6 * NS_PER_S  # of what came last: twice `HIDDEN_S`, and no touch-down takes so long (our choice)
LOOK_NS = 2 * NS_PER_S  # between two looks for a hidden flight (our choice)
CHAINS_MOST = 4  # that are kept: vehicles with one baseline and the same settings share a chain (our choice)
_CHAINS: dict[tuple[Hashable, ...], tuple[Baseline, Chain]] = {}


class Judge:
    """A baseline and its chain at work."""

    def __init__(self, baseline: Baseline, chain: Chain, now: Instant, held: Diagnosis = NOTHING_SEEN) -> None:
        self.baseline, self.chain = baseline, chain
        self.judged = now  # when anything was judged last (host)
        self.judged_s = self.flight_s = 0.0  # flight time in which a deciding monitor judged, and all, so far
        self.pieces: tuple[Piece, ...] = ()  # what the latest step gave, for a display
        self._asked, self._unjudged = now, dict[str, str]()  # monitors that do not judge, as asked for last
        self.memory = chain.start(held)
        self.sight = _Sight(chain)  # its `hidden` says why nothing is judged although it flies

    def step(self, telemetry: Telemetry, now: Instant) -> ChainOutput:
        """Judge the next telemetry."""
        output = self.chain.step(self.memory, telemetry)
        self.judged = now if output.judged_s > 0 else self.judged
        self._count(output)
        self.pieces = output.pieces
        self.sight.step(telemetry, output)
        return output

    def end_flight(self, *, landed: bool) -> ChainOutput:
        """The flight cannot be followed any longer: what is open is closed. landed: else a fault stays."""
        output = self.chain.end_flight(self.memory, landed=landed)
        self.pieces = ()
        return output

    def finish(self) -> tuple[Record, ...]:
        """The watch ends: judge the rows that waited, and record the open events with their end not seen."""
        output = self.chain.finish(self.memory)
        self._count(output)
        diagnosis, held = self.memory.diagnosis, self.landed()
        changes = output.changes
        if diagnosis.stage is Stage.FAULT:
            changes = (*changes, Change.of(held, self.memory.now_ns or 0))
        self.chain.renew(self.memory, held)
        latest = {(event.monitor, event.axis, event.start_ns): event for event in output.events}
        return (*(EventClosed(event) for event in latest.values()), *changes)

    def landed(self) -> Diagnosis:
        """What outlasts the flight: an open inspection."""
        open_ = self.memory.diagnosis.stage in (Stage.FAULT, Stage.INSPECT)
        return landed(self.memory.diagnosis, self.memory.now_ns or 0) if open_ else NOTHING_SEEN

    def acknowledge(self) -> tuple[Change, ...]:
        """Somebody has looked at the vehicle."""
        return self.chain.acknowledge(self.memory).changes

    def not_judged(self, streams: Streams, now: Instant) -> dict[str, str]:
        """Reason by label of the monitors that do not judge: their streams do not come, or in flight they never judged.

        A condition outside of the envelope is named without its figures: these move, and a text that moves is news.
        """
        if streams.began is None or now - streams.began < STREAM_S or now - self._asked < ASK_S:
            return self._unjudged
        self._asked, self._unjudged = now, {}
        warm = self.flight_s > WARM_S
        for slot, account in zip(self.chain.slots, self.memory.accounts, strict=True):
            label = slot.monitor.label
            if missing := streams.missing(slot.monitor.signals):
                self._unjudged[label] = f"no {LABELS[missing]}"
            elif warm and account.judged_s == 0 and (reasons := unjudged_s(account)):
                self._unjudged[label] = max(reasons, key=lambda reason: reasons[reason])
        return self._unjudged

    def _count(self, output: ChainOutput) -> None:
        self.judged_s, self.flight_s = self.judged_s + output.judged_s, self.flight_s + output.flight_s


class _Sight:
    """Whether a vehicle flies although the gate passes no rows: `hidden_flight` of a log, for the latest flight."""

    def __init__(self, chain: Chain) -> None:
        self.hidden = ""
        self._chain = chain
        self._fresh: list[Telemetry] = []  # what tells flight from ground, since the last look
        self._pieces: list[tuple[int, Telemetry]] = []  # before it, with its newest time [ns]
        self._spans: list[tuple[int, int]] = []  # first and last row of each part of them that flew [ns]
        self._looked_ns = 0

    def step(self, telemetry: Telemetry, output: ChainOutput) -> None:
        shows = tuple(part for part in telemetry.series if part.signal in SHOWS_FLIGHT and len(part))
        if not shows:
            return
        now_ns = max(part.t_ns.item(-1) for part in shows)
        self._fresh.append(Telemetry(shows))
        if output.flight_s > 0 and output.now_ns is not None:
            self._spans.append((output.now_ns - round(output.flight_s * NS_PER_S), output.now_ns))
        if now_ns - self._looked_ns < LOOK_NS:
            return
        self._looked_ns, self._fresh, fresh = now_ns, [], self._fresh
        self._pieces.append((now_ns, joined(fresh)))
        flown_ns = self._spans[-1][1] if self._spans else now_ns
        since_ns = flown_ns - FLOWN_NS
        self._spans = [span for span in self._spans if span[1] >= since_ns]
        self._pieces = [one for one in self._pieces if since_ns <= one[0] <= flown_ns or one[0] >= now_ns - LATEST_NS]
        self.hidden, front = "", self._chain.front
        if now_ns - flown_ns >= HIDDEN_S * NS_PER_S:
            telemetry = joined([piece for _, piece in self._pieces])
            found = hidden_flight(telemetry, front.gate, front.align.quality, self._spans)
            if found and self._pieces[-1][0] / NS_PER_S - found[-1].end_s < 1.0:
                self.hidden = found[-1].reason


def unjudged_s(account: Account) -> dict[str, float]:
    """Time without a judgement by its reason [s]."""
    outside = {f"{condition} not learnt": reach.span_s for condition, reach in account.outside.items()}
    return {**account.not_judged, **outside}


def rescaled(baseline: Baseline, scale: float) -> Baseline:
    """The baseline with all thresholds times a factor, without monitors that could not reach theirs then.

    Raises BaselineError if no monitor is left.
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
        raise BaselineError(
            f"no monitor can judge: {refusals[0].monitor}: {refusals[0].reason}", "no monitor can judge"
        )
    return baseline.model_copy(update={"monitors": judging, "not_judgeable": (*baseline.not_judgeable, *refusals)})


def chain_for(baseline: Baseline, settings: SessionSettings, started_ns: int) -> Chain:
    """The chain of a baseline as the settings have it: its thresholds, and the monitors that only raise a suspicion.

    started_ns: as in `chain_of`. Raises BaselineError if no monitor is left that decides.
    """
    key = id(baseline), settings.threshold_scale, tuple(settings.suspect), baseline.same_session(started_ns)
    if key not in _CHAINS:
        if len(_CHAINS) >= CHAINS_MOST:
            del _CHAINS[next(iter(_CHAINS))]
        chain, suspect = chain_of(rescaled(baseline, settings.threshold_scale), started_ns), set(settings.suspect)
        slots = tuple(replace(slot, decides=slot.decides and not _names(slot) & suspect) for slot in chain.slots)
        if chain.slots and not any(slot.decides for slot in slots):
            raise BaselineError("suspect names every monitor that decides")
        _CHAINS[key] = baseline, replace(chain, decision=replace(chain.decision, slots=slots))
    return _CHAINS[key][1]


def records_of(output: ChainOutput, whose: str) -> tuple[Record, ...]:
    """The events and changes of a step, for the journal, and how the vehicle differs. whose: the baseline's vehicle."""
    events = (EventOpened(event) if event.end_ns is None else EventClosed(event) for event in output.events)
    differs = "" if output.likeness is None else output.likeness.sentence(whose)
    return (*events, *output.changes, *((Note(differs),) if differs else ()))


def beginning(baseline: Baseline, chain: Chain, settings: SessionSettings) -> tuple[list[Note], list[Notice]]:
    """What is recorded and said as judging begins: monitors that the settings silence, doubts about the rotor layout,
    and names in `suspect` that no monitor has."""
    lost = chain.baseline.not_judgeable[len(baseline.not_judgeable) :]
    known = frozenset[str]().union(*(_names(slot) for slot in chain.slots))
    notes = [Note(f"{refusal.monitor} not judged: {refusal.reason}") for refusal in lost]
    notes += [Note(f"suspect: the baseline has no monitor {name!r}") for name in settings.suspect if name not in known]
    if not baseline.layout_doubt:
        return notes, []
    notes.append(Note(baseline.layout_doubt))
    if baseline.airframe.layout is not None:
        return notes, [Notice(Kind.OTHER_LAYOUT, (baseline.airframe.layout.name,))]
    off = sum(refusal.monitor in NEED_LAYOUT for refusal in baseline.not_judgeable)
    return notes, [Notice(Kind.NO_LAYOUT, (str(off),))]


def words_of(unjudged: dict[str, str]) -> tuple[str, str]:
    """What is said of monitors that do not judge, in full and for a text. unjudged: as `Judge.not_judged` has them."""
    (label, reason), *others = unjudged.items()
    short = f"; not {', '.join(unjudged)}" if others else f"; {label}: {reason}"
    return "".join(f"; {label} not judged: {why}" for label, why in unjudged.items()), short


def _names(slot: Slot) -> frozenset[str]:
    return frozenset((slot.monitor.name, f"{slot.monitor.name}.{slot.monitor.axis}"))
