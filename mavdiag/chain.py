"""The chain put together: telemetry in, alarms and the decision out; the same for a log and for a live link.

    telemetry ─ front ─▶ rows ─ monitors ─▶ statistics ─ envelope ─▶ statistics ─ decision ─▶ events, changes

One pass: each step is entered once for a chunk. All memory is in the state.

Chunks wait until they bring the rows of the decision's next look, every 0.1 s, for until then nothing can be decided.
So a chain that is fed more often costs what one does that is fed ten times a second, and decides as early.

The first 2 s wait until the gyro's rate is measured: a link that is not the baseline's is refused, by one rule for a
log and a live vehicle (`Chain.refusal`), and is measured again every 2 s.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from mavdiag.airframe.fingerprint import FIRST_S, Fingerprint, Likeness, compare
from mavdiag.airframe.layout import RotorLayout
from mavdiag.baseline import Baseline, check_link
from mavdiag.decision.account import WAITING, Account, Coverage
from mavdiag.decision.alarm import LOOK_NS, NOTHING_SEEN, DecisionSpec, DecisionState, Event, SlotSpec
from mavdiag.decision.diagnosis import Change, Diagnosis
from mavdiag.decision.events import EventSpec
from mavdiag.decision.grading import known_fault_types
from mavdiag.errors import BaselineError
from mavdiag.link.samples import joined
from mavdiag.link.samples import warm as warm_samples
from mavdiag.monitors import MONITORS, monitor_of
from mavdiag.monitors.base import FaultKind, Monitor
from mavdiag.monitors.columns import COVERED, OUTPUTS, SIGNAL, columns_of
from mavdiag.rows.align import AlignSpec, measure_grid
from mavdiag.rows.block import Block
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Front, FrontState, Rows
from mavdiag.rows.front import warm as warm_rows
from mavdiag.rows.gate import Border
from mavdiag.rows.grid import LEAST_SAMPLES
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, BoolArray, FloatArray, Signal, Telemetry
from mavdiag.thresholds.envelope import Dependence, Envelope, EnvelopeState, Outside
from mavdiag.units import NS_PER_S

__all__ = ["WAITING", "Account", "Chain", "ChainOutput", "ChainState", "Gauge", "Piece", "Slot", "chain_of", "front_of"]

MOST_WAITING = 32  # chunks that may wait: time that stands still must not fill the memory (our choice)
MOST_UNMEASURED = 1024  # the same while the rate is not measured: 2 s of small chunks (our choice)
MEASURED_S = 2.0  # of gyro samples that a live link's rate is measured by (our choice)


@dataclass(frozen=True, slots=True, eq=False)
class Slot:
    """A monitor and its threshold.

    decides: its alarm is a fault by itself; else it is a suspicion.
    """

    monitor: Monitor[Any]
    threshold: float
    decides: bool

    @property
    def key(self) -> tuple[str, Axis | None]:
        """Name and axis of the monitor."""
        return self.monitor.name, self.monitor.axis

    @property
    def of_propellers(self) -> bool:
        """It decides about propellers; "healthy" rests on such slots alone."""
        return self.decides and self.monitor.kind is FaultKind.PROPELLER


@dataclass(frozen=True, slots=True)
class Gauge:
    """The latest value of one slot, for a display; fields as in `Slot` and `Statistic`."""

    monitor: str
    axis: Axis | None
    unit: str
    statistic: float
    threshold: float
    signal: float
    reference: float
    valid: bool


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """What was made of some rows. found: the statistic of each slot, as the envelope lets it count."""

    rows: Rows
    found: tuple[Statistic, ...]


@dataclass(frozen=True, slots=True)
class ChainOutput:
    """What one chunk brought.

    events: alarms of monitors that opened (end_ns None) or closed.
    changes: of the decision.
    gauges: the latest value of every slot that has one.
    flight_s: new flight time, take-offs and all.
    judged_s: by how much `ChainState.judged_s` grew; a value may judge what was flown before it.
    now_ns: vehicle time of the latest row; None if none came.
    likeness: whether it is the baseline's vehicle, once, when 20 s of flight are there; None at other times.
    pieces: the rows with their statistics, for figures and displays (`mavdiag.traces`).
    """

    events: tuple[Event, ...] = ()
    changes: tuple[Change, ...] = ()
    gauges: tuple[Gauge, ...] = ()
    flight_s: float = 0.0
    judged_s: float = 0.0
    now_ns: int | None = None
    likeness: Likeness | None = None
    pieces: tuple[Piece, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ChainState:
    """Memory of the front, the envelope, the monitors and the decision.

    accounts: of each slot, since the start.
    coverage: how much of the flight any slot that decides about propellers judged.
    now_ns: vehicle time of the latest row.
    beginning: rows until there are enough to compare the vehicle; None afterwards.
    begun_s: valid time in them.
    waiting: telemetry that does not reach the next look yet.
    measured: the rate of the live link is known to be the baseline's.
    refused: why the link is not the baseline's; empty if it is, or is not measured yet.
    """

    front: FrontState
    envelope: EnvelopeState
    monitors: tuple[Any, ...]
    decision: DecisionState
    accounts: tuple[Account, ...]
    coverage: Coverage = field(default_factory=Coverage)
    now_ns: int | None = None
    beginning: tuple[Rows, ...] | None = ()
    begun_s: float = 0.0
    waiting: tuple[Telemetry, ...] = ()
    measured: bool = False
    refused: str = ""

    @property
    def diagnosis(self) -> Diagnosis:
        """What is held of the vehicle now."""
        held = self.decision.diagnosis
        return replace(held, reason=self.refused) if self.refused else held

    @property
    def judged_s(self) -> float:
        """Flown time that any slot that decides about propellers judged, since the start [s]."""
        return self.coverage.judged_s

    def fed(self, front: FrontState, waiting: tuple[Telemetry, ...]) -> "ChainState":
        """With another front and other telemetry that waits; quicker than `replace`, for every step does it."""
        told = (self.accounts, self.coverage, self.now_ns, self.beginning, self.begun_s)
        return ChainState(front, self.envelope, self.monitors, self.decision, *told, waiting, self.measured)


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Front, slots, envelope and decision: the whole way from telemetry to alarms.

    fingerprint, layout: of the baseline's vehicle, to compare the flight with; None to compare nothing.
    baseline: whose it is; None where no link is refused.
    profile: of the data; None if it is not known.
    """

    front: Front
    slots: tuple[Slot, ...]
    decision: DecisionSpec
    envelope: Envelope = field(default_factory=Envelope)
    fingerprint: Fingerprint | None = None
    layout: RotorLayout | None = None
    baseline: Baseline | None = None
    profile: str | None = None

    def start(self, held: Diagnosis = NOTHING_SEEN) -> ChainState:
        """Nothing seen yet. held: what is known from before, as `landed` has it."""
        accounts, decision = (Account(),) * len(self.slots), self.decision.start(held)
        return ChainState(self.front.start(), self.envelope.start(), self._fresh(), decision, accounts)

    def step(self, state: ChainState, telemetry: Telemetry) -> tuple[ChainState, ChainOutput]:
        """Take in a chunk of telemetry; return what it brought."""
        waiting = (*state.waiting, telemetry) if telemetry.series else state.waiting
        if not waiting:
            return state, ChainOutput()
        if not state.measured:
            state = self._measured(replace(state, waiting=waiting[-MOST_UNMEASURED:]))
            waiting = state.waiting
            if not state.measured:
                return state, ChainOutput()
        state = state.fed(state.front, waiting)
        return self.judge(*self._taken(state)) if self._due(state) else (state, ChainOutput())

    def end_flight(self, state: ChainState) -> tuple[ChainState, ChainOutput]:
        """The link was lost or the watch ends: close what is open. Rows may go on later."""
        state, parts = self._taken(state)
        front, rest = self.front.settle(state.front)
        state, parts = state.fed(front, state.waiting), (*parts, *rest)
        ends = [int(part.block.t_ns[-1]) for part in parts if isinstance(part, Rows) and len(part.block)]
        end_ns = ends[-1] if ends else state.now_ns
        return self.judge(state, parts if end_ns is None else (*parts, Border(end_ns)))

    def acknowledge(self, state: ChainState) -> tuple[ChainState, ChainOutput]:
        """Somebody has looked at the vehicle: an open inspection is closed."""
        decision, _, changes = self.decision.acknowledge(state.decision, state.now_ns or 0)
        return replace(state, decision=decision), ChainOutput(changes=changes)

    def finish(self, state: ChainState) -> tuple[ChainState, ChainOutput]:
        """The end of a log: the last rows, and events that are still open, with end_ns None."""
        state, parts = self._taken(state)
        front, rest = self.front.finish(state.front)
        state, output = self.judge(replace(state, front=front), (*parts, *rest))
        if state.now_ns is None:
            return state, output
        decision, events, changes = self.decision.step(state.decision, (), state.now_ns, final=True)
        events = (*output.events, *events, *self.decision.open_events(decision))
        state = replace(state, decision=decision)
        return state, replace(output, events=events, changes=(*output.changes, *changes))

    def refusal(self, telemetry: Telemetry, least_s: float = 0.0) -> str | None:
        """Why data do not suit the baseline, a sentence; empty if they do, None if they are too few to tell.

        least_s: gyro samples must reach over so long. Some streams are irregular, or lose much: a rate is another one
        if neither its mean nor its median is the baseline's.
        """
        series = telemetry.get(Signal.BODY_RATE)
        stamps = np.empty(0) if series is None else np.unique(series.t_ns).astype(np.float64)
        steps: FloatArray = np.diff(stamps) / NS_PER_S
        steps = steps[steps <= self.front.align.break_s]
        if len(steps) + 1 < LEAST_SAMPLES or float(np.sum(steps)) < least_s:
            return None
        if self.baseline is None:
            return ""
        found = ""
        for dt_s in (measure_grid(telemetry)[0], float(np.median(steps))):
            try:
                check_link(self.baseline, profile=self.profile or self.baseline.link.profile, dt_s=dt_s)
                return ""
            except BaselineError as error:
                found = found or f"another link: {error}"
        return found

    def _measured(self, state: ChainState) -> ChainState:
        """Whether what waits is of the baseline's link; of another one it is dropped."""
        refused = self.refusal(joined(state.waiting), MEASURED_S)
        if refused is None:
            return state
        return replace(state, measured=not refused, refused=refused, waiting=() if refused else state.waiting)

    def _due(self, state: ChainState) -> bool:
        """Whether what waits may bring rows up to the next look, or more of it must not wait."""
        row_ns = state.front.align.last_ns
        if len(state.waiting) >= MOST_WAITING:
            return True
        newest_ns = self.front.align.reached_ns(state.front.align, state.waiting)
        return newest_ns is not None and newest_ns // LOOK_NS > row_ns // LOOK_NS

    def _taken(self, state: ChainState) -> tuple[ChainState, tuple[Rows | Border, ...]]:
        """The rows that all that waits makes."""
        if not state.waiting:
            return state, ()
        front, parts = self.front.step(state.front, joined(state.waiting))
        return state.fed(front, ()), parts

    def _fresh(self) -> tuple[Any, ...]:
        return tuple(slot.monitor.start() for slot in self.slots)

    def judge(self, state: ChainState, parts: Sequence[Rows | Border]) -> tuple[ChainState, ChainOutput]:
        """Take in rows that its front made."""
        output = ChainOutput()
        for part in parts:
            if isinstance(part, Border):
                decision, events, changes = self.decision.end_flight(state.decision, part.t_ns)
                fresh = replace(state, envelope=self.envelope.start(), monitors=self._fresh(), decision=decision)
                state = replace(fresh, coverage=state.coverage.closed())
            elif len(part.block) == 0:
                continue
            else:
                state, events, changes, output = self._rows(state, part, output)
            if events or changes:
                output = replace(output, events=(*output.events, *events), changes=(*output.changes, *changes))
        return state, output

    def _rows(
        self, state: ChainState, rows: Rows, output: ChainOutput
    ) -> tuple[ChainState, tuple[Event, ...], tuple[Change, ...], ChainOutput]:
        monitors, found, outside = [], [], []
        envelope = self.envelope.step(state.envelope, rows)
        flown = replace(rows, covered=partial(self.envelope.covers, envelope))
        columns = columns_of(flown)
        for number, (slot, memory) in enumerate(zip(self.slots, state.monitors, strict=True)):
            after, statistic = slot.monitor.judge(memory, flown, columns)
            statistic, denied = self.envelope.apply(number, statistic, envelope)
            monitors.append(after)
            found.append(statistic)
            outside.append(denied)
        now_ns = int(rows.block.t_ns[-1])
        decision, events, changes = self.decision.step(state.decision, found, now_ns)
        flight_s = len(rows.block) * rows.block.dt_s
        accounts = self._accounts(state.accounts, found, outside, rows.block, flight_s)
        coverage = self._covered(state.coverage, rows.block, found)
        beginning, begun_s, likeness = self._compared(state, rows)
        output = ChainOutput(
            output.events,
            output.changes,
            tuple(_gauge(slot, one) for slot, one in zip(self.slots, found, strict=True) if len(one)),
            output.flight_s + flight_s,
            output.judged_s + coverage.judged_s - state.judged_s,
            now_ns,
            likeness or output.likeness,
            (*output.pieces, Piece(rows, tuple(found))),
        )
        told = (accounts, coverage, now_ns, beginning, begun_s, state.waiting, state.measured)
        return ChainState(state.front, envelope, tuple(monitors), decision, *told), events, changes, output

    def _compared(self, state: ChainState, rows: Rows) -> tuple[tuple[Rows, ...] | None, float, Likeness | None]:
        """The rows to compare the vehicle by, their valid time, and the answer as soon as there are enough."""
        if state.beginning is None or self.fingerprint is None:
            return None, state.begun_s, None
        count = int(np.count_nonzero(rows.block.valid))
        if count == 0 and not (state.beginning and state.beginning[-1].block.valid.any()):
            return state.beginning, state.begun_s, None  # nothing is measured in it; one such block parts the others
        beginning, begun_s = (*state.beginning, rows), state.begun_s + count * rows.block.dt_s
        if begun_s < FIRST_S:
            return beginning, begun_s, None
        return None, state.begun_s, compare(self.fingerprint, beginning, self.layout)

    def _covered(self, coverage: Coverage, block: Block, found: Sequence[Statistic]) -> Coverage:
        """How much any slot that decides about propellers judged, after the next rows."""
        own = [(slot, one) for slot, one in zip(self.slots, found, strict=True) if slot.of_propellers]
        able = np.ones((len(own), len(block)), dtype=np.bool_)
        for known, (slot, _) in zip(able, own, strict=True):
            for signal in slot.monitor.signals:
                known &= slot.monitor.known(block, signal)
        reach_s = [max(slot.monitor.memory_s, one.period_s) for slot, one in own]
        return coverage.add(block, able, [one for _, one in own], reach_s)

    def _accounts(
        self,
        accounts: Sequence[Account],
        found: Sequence[Statistic],
        outside: Sequence[Mapping[Condition, Outside]],
        block: Block,
        flight_s: float,
    ) -> tuple[Account, ...]:
        counts: dict[int, tuple[BoolArray, int]] = {}  # valid rows without a signal, of each array of flags
        out, none = [], block.doubted_s()
        for slot, account, one, denied in zip(self.slots, accounts, found, outside, strict=True):
            missing = none
            for signal in slot.monitor.signals:
                there = slot.monitor.known(block, signal)
                if id(there) not in counts:
                    whole = np.count_nonzero(there) == len(there)
                    counts[id(there)] = there, 0 if whole else int(np.count_nonzero(block.valid & ~there))
                if count := counts[id(there)][1]:
                    missing = {**missing, signal: count * block.dt_s}
            out.append(account.add(one, flight_s, missing, denied))
        return tuple(out)


def _gauge(slot: Slot, found: Statistic) -> Gauge:
    monitor = slot.monitor
    return Gauge(
        monitor=monitor.name,
        axis=monitor.axis,
        unit=monitor.unit,
        statistic=float(found.value[-1]),
        threshold=slot.threshold,
        signal=float(found.signal[-1]),
        reference=monitor.reference,
        valid=bool(found.valid[-1]),
    )


def warm() -> None:
    """Compile what judges, or load it from where it is kept, before time counts.

    The first time after an installation it takes some 20 s of processor time, later half a second.
    """
    warm_rows()
    warm_samples()
    none, nothing = np.zeros(64), np.empty((0, 0))
    for monitor in MONITORS:
        x, flags, at = np.empty((OUTPUTS, 0)), np.empty((COVERED + 1, 0)), np.empty(0, dtype=np.int64)
        monitor.run(none.copy(), none.copy(), x, flags, 0, np.empty((SIGNAL + 1, 0)), nothing, at)


def front_of(baseline: Baseline) -> Front:
    """The front that a baseline was made with."""
    link = baseline.link
    rates = RateSpec.of(link.dt_s, baseline.window.samples, baseline.window.order)
    align = AlignSpec(link.dt_s, link.grid, link.max_gap_s, quality=baseline.link_quality)
    return Front(align, link.gate, rates, baseline.airframe.outputs)


def chain_of(baseline: Baseline, started_ns: int = 0, profile: str | None = None) -> Chain:
    """The chain that judges by a baseline.

    profile: of the data, if it is known.

    started_ns: wall-clock time of the flight, unix epoch [ns]; 0 if it is not known. In a session of the healthy
    flights nothing is allowed for what another session may shift.

    A monitor that does not decide (the thesis's rule, which alarms on trajectories that its flights did not have) does
    so where it stands alone.
    """
    order = [monitor.name for monitor in MONITORS]
    entries = sorted(baseline.monitors, key=lambda entry: order.index(entry.spec.kind))
    monitors = [monitor_of(entry.spec) for entry in entries]
    alone = not any(monitor.decides for monitor in monitors)
    same = baseline.same_session(started_ns)
    coaxial = baseline.airframe.layout is not None and baseline.airframe.layout.coaxial  # the arm is told, no rotor
    slots = tuple(
        Slot(monitor, entry.threshold.within(same_session=same), monitor.decides or alone)
        for monitor, entry in zip(monitors, entries, strict=True)
    )
    specs = tuple(
        SlotSpec(
            EventSpec(*slot.key, slot.threshold, slot.monitor.clear_s),
            slot.monitor.unit,
            slot.decides,
            slot.monitor.delay_s,
            None if coaxial else slot.monitor.evidence,
            slot.monitor.feature,
            slot.monitor.kind,
        )
        for slot in slots
    )
    features = {spec.feature for spec in specs}
    link, classifier = baseline.link, baseline.airframe.classifier
    known = known_fault_types(classifier, link.profile, 1.0 / link.dt_s) if "motion" in features else ()
    depends = tuple(
        Dependence(slot.monitor.depends, slot.monitor.memory_s, grows=slot.monitor.unit != "s") for slot in slots
    )
    envelope = Envelope(baseline.envelope, depends, baseline.window.samples // 2 * baseline.link.dt_s)
    decision, whose = DecisionSpec(specs, known), baseline.airframe
    return Chain(front_of(baseline), slots, decision, envelope, baseline.fingerprint, whose.layout, baseline, profile)
