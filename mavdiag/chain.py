"""The chain put together: telemetry in, alarms and the decision out; the same for a log and for a live link.

    telemetry ─ front ─▶ rows ─ kernel ─▶ looks ─ decision ─▶ events, changes

Chunks wait in the front until they bring the rows of the next look (`LOOK_NS`). The first 2 s wait until the gyro's
rate is measured: a link that is not the baseline's is refused (`Chain.refusal`), and measured again every 2 s.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from mavdiag.airframe.fingerprint import LEAST_OUTPUTS, Beginning, Likeness
from mavdiag.baseline import Baseline, check_link
from mavdiag.decision.alarm import NOTHING_SEEN, DecisionSpec, DecisionState
from mavdiag.decision.diagnosis import Change, Diagnosis, Event
from mavdiag.decision.grading import known_fault_types
from mavdiag.errors import BaselineError, InputError
from mavdiag.kernel import LOOK_NS, Account, Kernel, Memory, Piece, Slot
from mavdiag.kernel import warm as warm_kernel
from mavdiag.link.samples import joined
from mavdiag.link.samples import warm as warm_samples
from mavdiag.monitors import MONITORS, monitor_of
from mavdiag.rows.align import BREAK_S, AlignSpec
from mavdiag.rows.front import Front, FrontState, Rows
from mavdiag.rows.front import warm as warm_rows
from mavdiag.rows.gate import Border
from mavdiag.rows.grid import LEAST_SAMPLES, measure_grid, steps_of
from mavdiag.rows.rates import RateSpec
from mavdiag.telemetry import Log, Signal, Telemetry
from mavdiag.thresholds.rule import TINY
from mavdiag.units import NS_PER_S

MOST_WAITING = 32  # chunks that may wait: time that stands still must not fill the memory (our choice)
MOST_UNMEASURED = 128  # the same while the rate is not measured: then they are joined (our choice)
MOST_GYRO = 1 << 16  # samples in them: above 2 s at any rate, or their time stands still (our choice)
MEASURED_S = 2.0  # of gyro samples that a live link's rate is measured by (our choice)


class ChainOutput(NamedTuple):
    """What one chunk brought.

    events: alarms that opened (end_ns None) or closed. changes: of the decision. flight_s, judged_s: that came.
    now_ns: vehicle time of the latest row; None if none came. pieces: the rows with their statistics.
    likeness: whether it is the baseline's vehicle, when 20 s of flight are there, and link; None at other times.
    """

    events: tuple[Event, ...] = ()
    changes: tuple[Change, ...] = ()
    flight_s: float = 0.0
    judged_s: float = 0.0
    now_ns: int | None = None
    likeness: Likeness | None = None
    pieces: tuple[Piece, ...] = ()


NOTHING = ChainOutput()


@dataclass(slots=True, eq=False)
class ChainState:
    """Memory of the front, the kernel and the decision; a step changes it in place.

    beginning: what compares the vehicle; None where nothing does, or it is another one.
    waiting: telemetry that came before the rate was measured. measured: whether it is known to be the baseline's.
    chunks: since the last rows. now_ns: of the latest row.
    refused: why the link or the vehicle is not the baseline's; empty if it is, or is not measured yet.
    """

    kernel: Kernel
    front: FrontState
    memory: Memory
    decision: DecisionState
    now_ns: int | None = None
    beginning: Beginning | None = None
    waiting: list[Telemetry] = field(default_factory=list)
    measured: bool = False
    chunks: int = 0
    refused: str = ""

    @property
    def diagnosis(self) -> Diagnosis:
        """What is held of the vehicle now."""
        held = self.decision.diagnosis
        return replace(held, reason=self.refused) if self.refused else held

    @property
    def ratios(self) -> tuple[tuple[Slot, float], ...]:
        """Latest statistic over its threshold of each slot that judges now."""
        return self.kernel.ratios(self.memory)

    @property
    def accounts(self) -> tuple[Account, ...]:
        """How long each slot judged since the start, and why it did not."""
        return self.kernel.accounts(self.memory)


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """The whole way from telemetry to alarms. profile: of the data, if known."""

    front: Front
    decision: DecisionSpec
    baseline: Baseline
    profile: str | None = None
    kernel: Kernel = field(init=False, repr=False)

    def __post_init__(self) -> None:
        dt_s = self.front.align.dt_s
        kernel = Kernel(self.slots, self.baseline.envelope, dt_s, self.front.rates.window // 2 * dt_s)
        front = replace(self.front, align=replace(self.front.align, before=kernel.back))
        object.__setattr__(self, "kernel", kernel)
        object.__setattr__(self, "front", front)  # with the room that the kernel's columns of before need

    @property
    def slots(self) -> tuple[Slot, ...]:
        """The monitors with their thresholds."""
        return self.decision.slots

    def start(self, held: Diagnosis = NOTHING_SEEN) -> ChainState:
        """Nothing seen yet. held: what is known from before, as `landed` has it."""
        learnt, layout = self.baseline.fingerprint, self.baseline.airframe.layout
        beginning = None if learnt is None else Beginning(learnt, layout)
        return ChainState(self.kernel, self.front.start(), self.kernel.start(), DecisionState(held), None, beginning)

    def step(self, state: ChainState, telemetry: Telemetry) -> ChainOutput:
        """Take in a chunk of telemetry; return what it brought."""
        if not telemetry.series:
            return NOTHING
        state.waiting.append(telemetry)
        if not state.measured:
            if len(state.waiting) > MOST_UNMEASURED:
                whole = joined(state.waiting)
                gyro = whole.get(Signal.BODY_RATE)
                state.waiting = [whole] if gyro is not None and len(gyro) <= MOST_GYRO else []
            if _gyro_s(state.waiting) < MEASURED_S:
                return NOTHING
            rates = (tuple(one for one in chunk if one.signal is Signal.BODY_RATE) for chunk in state.waiting)
            refused = self.refusal(joined(map(Telemetry, rates)), MEASURED_S)
            if refused is not None:
                state.refused, state.measured = refused, not refused
            if not state.measured:
                state.waiting = [] if refused else state.waiting
                return NOTHING
        state.chunks += 1
        align, gyro, may_wait = state.front.align, telemetry.get(Signal.BODY_RATE), state.chunks < MOST_WAITING
        next_ns = (align.last_ns // LOOK_NS + 1) * LOOK_NS
        if may_wait and gyro is not None and len(gyro) and gyro.t_ns[-1] < next_ns:
            return NOTHING  # nothing can be decided before the rows of the next look
        self._append(state)
        if may_wait and self.front.align.reached_ns(align) < next_ns:
            return NOTHING
        return self.judge(state, self._taken(state))

    def missing_ns(self, state: ChainState) -> int:
        """How much of the gyro is missing until the next look is whole [ns], two looks at most; 0 if it is overdue."""
        align = state.front.align
        if state.measured:
            self._append(state)
        next_ns = (align.last_ns // LOOK_NS + 1) * LOOK_NS
        return min(self.front.align.missing_ns(align, next_ns), 2 * LOOK_NS)

    def end_flight(self, state: ChainState, *, landed: bool = True) -> ChainOutput:
        """It cannot be followed any longer: close what is open. Rows may go on later. landed: else a fault stays."""
        parts = (*self._taken(state), *self.front.settle(state.front))
        ends = [int(part.block.t_ns[-1]) for part in parts if isinstance(part, Rows) and len(part.block)]
        end_ns = ends[-1] if ends else state.now_ns
        return self.judge(state, parts if end_ns is None else (*parts, Border(end_ns, landed)))

    def acknowledge(self, state: ChainState) -> ChainOutput:
        """Somebody has looked at the vehicle: an open inspection is closed."""
        state.decision, _, changes = self.decision.acknowledge(state.decision, state.now_ns or 0)
        return ChainOutput(changes=changes)

    def finish(self, state: ChainState) -> ChainOutput:
        """The end of a log: the last rows, and events that are still open, with end_ns None."""
        output = self.judge(state, (*self._taken(state), *self.front.finish(state.front)))
        if state.now_ns is None:
            return output
        last = self.kernel.close(state.memory, state.now_ns)
        state.decision, events, changes = self.decision.step(state.decision, last)
        lasting = self.decision.named(state.decision, self.kernel.open_alarms(state.memory))
        events, changes = (*output.events, *events, *lasting), (*output.changes, *changes)
        return output._replace(events=events, changes=changes)

    def renew(self, state: ChainState, held: Diagnosis) -> None:
        """After `finish`, for what may follow. held: what is known from before."""
        self.kernel.restart(state.memory)
        state.decision = DecisionState(held)

    def refusal(self, telemetry: Telemetry, least_s: float = 0.0, mean_s: float | None = None) -> str | None:
        """Why data do not suit the baseline; empty if they do, None if too few (below `least_s` of gyro) to tell.

        Streams may be irregular, or lose much: neither mean nor median of another rate is the baseline's.
        mean_s: the period of their grid, where it is measured already.
        """
        series = telemetry.get(Signal.BODY_RATE)
        steps = steps_of(np.empty(0, dtype=np.int64) if series is None else series.t_ns) / NS_PER_S
        steps = steps[steps <= BREAK_S]
        if len(steps) + 1 < LEAST_SAMPLES or float(np.sum(steps)) < least_s:
            return None
        try:
            mean_s = measure_grid(telemetry)[0] if mean_s is None else mean_s
        except InputError:  # too few whose stamps do not leap
            return None
        found = ""
        for dt_s in (mean_s, float(np.median(steps))):
            try:
                check_link(self.baseline, profile=self.profile or self.baseline.link.profile, dt_s=dt_s)
                return ""
            except BaselineError as error:
                found = found or f"another link: {error}"
        return found

    def judge(self, state: ChainState, parts: Sequence[Rows | Border]) -> ChainOutput:
        """Take in rows that its front made."""
        events: list[Event] = []
        changes: list[Change] = []
        pieces: list[Piece] = []
        rows, judged, memory, now_ns, likeness = state.memory.rows, state.memory.judged, state.memory, None, None
        for part in parts:
            if isinstance(part, Border):
                left, ended = self.kernel.close(memory, part.t_ns), self.kernel.open_alarms(memory, ended=True)
                state.decision, told, changed = self.decision.end_segment(
                    state.decision, left, ended, part.t_ns, flies=not part.landed
                )
                self.kernel.restart(memory)
            elif len(part.block):
                looked, piece = self.kernel.step(memory, part)
                state.decision, told, changed = self.decision.step(state.decision, looked)
                state.now_ns = now_ns = int(part.block.t_ns[-1])
                likeness = self._compared(state, part) or likeness
                pieces.append(piece)
            else:
                continue
            events += told
            changes += changed
        spans_s = (memory.rows - rows) * self.kernel.dt_s, (memory.judged - judged) * self.kernel.dt_s
        return ChainOutput(tuple(events), tuple(changes), *spans_s, now_ns, likeness, tuple(pieces))

    def _compared(self, state: ChainState, rows: Rows) -> Likeness | None:
        found = None if state.beginning is None else state.beginning.take(rows)
        if found is None or state.beginning is None:
            return None
        if found.late or not state.beginning.whole:
            state.refused, state.beginning = found.sentence(self.baseline.airframe.name), None
        return found

    def _append(self, state: ChainState) -> None:
        waiting, state.waiting = state.waiting, []
        self.front.align.append(state.front.align, waiting)

    def _taken(self, state: ChainState) -> tuple[Rows | Border, ...]:
        waiting, state.waiting, state.chunks = state.waiting, [], 0
        return self.front.step(state.front, *waiting) if state.measured else ()


def _gyro_s(pieces: Sequence[Telemetry]) -> float:
    """How far the gyro's samples reach at most, by the first and the last of each piece [s]."""
    series = [gyro for one in pieces if (gyro := one.get(Signal.BODY_RATE)) is not None and len(gyro)]
    ends_ns = [int(gyro.t_ns[at]) for gyro in series for at in (0, -1)]
    return (max(ends_ns) - min(ends_ns)) / NS_PER_S if ends_ns else 0.0


def warm() -> None:
    """Compile what judges (about a minute of processor time), or load it from where it is kept (half a second)."""
    warm_rows()
    warm_samples()
    warm_kernel()


def suited(baseline: Baseline, log: Log) -> Baseline:
    """The baseline as it judges a log: without the order of outputs where those of the log are by motor already."""
    if not log.motor_order:
        return baseline
    return baseline.model_copy(update={"airframe": replace(baseline.airframe, outputs=None)})


def front_of(baseline: Baseline) -> Front:
    """The front that a baseline was made with; what nothing reads is left out."""
    link, whose, needed = baseline.link, baseline.airframe, {one for monitor in MONITORS for one in monitor.needs}
    takes: dict[Signal, tuple[int, ...]] = {} if Signal.RATE_SETPOINT in needed else {Signal.RATE_SETPOINT: ()}
    if whose.outputs is not None:
        by_rotor = tuple(output - 1 for output in whose.outputs)
        takes |= {Signal.ACTUATOR: by_rotor, Signal.ROTOR_SPEED: by_rotor}
    elif whose.layout is not None:
        rotors = tuple(range(whose.layout.rotors))
        takes |= {Signal.ACTUATOR: tuple(range(max(len(rotors), LEAST_OUTPUTS))), Signal.ROTOR_SPEED: rotors}
    rates = RateSpec.of(link.dt_s, baseline.window.samples, baseline.window.order)
    align = AlignSpec(link.dt_s, link.grid, link.max_gap_s, quality=baseline.link_quality, takes=takes)
    return Front(align, link.gate, rates)


def chain_of(baseline: Baseline, started_ns: int = 0, profile: str | None = None) -> Chain:
    """The chain that judges by a baseline.

    started_ns: wall-clock time of the flight, unix epoch [ns]; 0 if not known. profile: of the data, if known. A
    monitor that does not decide (the thesis's rule) does so where it stands alone.
    """
    order = [monitor.name for monitor in MONITORS]
    entries = sorted(baseline.monitors, key=lambda entry: order.index(entry.spec.kind))
    monitors = [monitor_of(entry.spec) for entry in entries]
    alone = not any(monitor.decides for monitor in monitors)
    same, link, whose = baseline.same_session(started_ns), baseline.link, baseline.airframe
    arms = whose.layout.arms if whose.layout is not None and whose.layout.coaxial else ()
    slots = tuple(
        Slot(
            one,
            max(entry.threshold.within(same_session=same), TINY),  # of which there are ratios
            one.decides or alone,
            one.evidence and replace(one.evidence, arms=arms),
            entry.threshold.suspected[same],
        )
        for one, entry in zip(monitors, entries, strict=True)
    )
    moves = any(monitor.feature == "motion" for monitor in monitors)
    known = known_fault_types(whose.classifier, link.profile, 1.0 / link.dt_s) if moves else ()
    return Chain(front_of(baseline), DecisionSpec(slots, known), baseline, profile)
