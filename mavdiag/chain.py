"""The chain put together: telemetry in, findings out; the same for a log and for a live link.

    telemetry ─ align ─ gate ─ rates ─▶ rows ─ monitors ─▶ readings ─ events ─▶ findings

`Front` is the part up to the rows, which learning shares; `Chain` adds the monitors of a baseline. Both are values;
all memory is in their states.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mavdiag.baseline import Baseline, MonitorEntry
from mavdiag.decision import diagnosis
from mavdiag.decision import events as event_step
from mavdiag.decision.diagnosis import DiagnosisSpec, DiagnosisState, Opinion, opinion_at
from mavdiag.decision.events import Event, EventSpec, EventState, Reading
from mavdiag.decision.fusion import Channel, FusionSpec
from mavdiag.decision.grading import known_fault_types
from mavdiag.identify import ArxModel, Method
from mavdiag.monitors.base import Monitor, Rows
from mavdiag.monitors.innovation import Innovation, InnovationSpec
from mavdiag.monitors.rotor_signature import RotorSignature, RotorSignatureSpec
from mavdiag.monitors.rotor_trim import RotorTrim, RotorTrimSpec
from mavdiag.monitors.run_length import RunLength, RunLengthSpec
from mavdiag.monitors.unbalance import Unbalance, UnbalanceSpec
from mavdiag.monitors.vibration_level import VibrationLevel, VibrationLevelSpec
from mavdiag.rows import align as align_step
from mavdiag.rows import gate as gate_step
from mavdiag.rows import rates as rate_step
from mavdiag.rows.align import AlignSpec, AlignState
from mavdiag.rows.block import Block
from mavdiag.rows.gate import GateSpec, GateState
from mavdiag.rows.rates import RateSpec, RateState
from mavdiag.telemetry import Axis, Telemetry

__all__ = [
    "Chain",
    "ChainState",
    "Findings",
    "Front",
    "FrontState",
    "Level",
    "Watch",
    "chain_of",
    "front_of",
    "model_of",
]


FEATURES = ("vibration", "energy", "effort")
NO_DIAGNOSIS = DiagnosisSpec(FusionSpec(()), {})
CLEAR_S = 2.0  # how long a windowed statistic must have been back before its event is over (our choice)


@dataclass(frozen=True, slots=True, eq=False)
class FrontState:
    """Memory of the alignment, the gate and the rate filters."""

    align: AlignState
    gate: GateState
    rates: RateState


@dataclass(frozen=True, slots=True, eq=False)
class Front:
    """Telemetry to uniform rows of flight and their rates."""

    align: AlignSpec
    gate: GateSpec
    rates: RateSpec

    def start(self) -> FrontState:
        """Nothing heard yet."""
        return FrontState(align_step.start(), gate_step.start(), rate_step.start(self.rates))

    def step(self, state: FrontState, telemetry: Telemetry) -> tuple[FrontState, tuple[Rows, ...]]:
        """Take in a chunk of telemetry; return the rows that it completes."""
        aligned, blocks = align_step.align(self.align, state.align, telemetry)
        gated, blocks = gate_step.gate(self.gate, state.gate, blocks)
        return self._rows(aligned, gated, state.rates, blocks)

    def finish(self, state: FrontState) -> tuple[FrontState, tuple[Rows, ...]]:
        """The end of a log: the rows that were waiting."""
        aligned, blocks = align_step.finish(self.align, state.align)
        gated, blocks = gate_step.gate(self.gate, state.gate, blocks)
        gated, rest = gate_step.finish(self.gate, gated)
        return self._rows(aligned, gated, state.rates, (*blocks, *rest))

    def _rows(
        self, aligned: AlignState, gated: GateState, filtered: RateState, blocks: tuple[Block, ...]
    ) -> tuple[FrontState, tuple[Rows, ...]]:
        out: list[Rows] = []
        for block in blocks:
            filtered, rate_block = rate_step.rates(self.rates, filtered, block)
            out.append(Rows(block, rate_block))
        return FrontState(aligned, gated, filtered), tuple(out)


@dataclass(frozen=True, slots=True, eq=False)
class Watch:
    """A monitor and the threshold it is held against.

    reference: what its signal is held against, if anything (for the thesis rule the margin [rad/s]); clear_s: how
    long the statistic must have been back before an event closes. decides: its event is a fault by itself; else it is
    a suspicion that others must confirm.
    """

    monitor: Monitor[Any]
    threshold: float
    reference: float = 0.0
    clear_s: float = 0.0
    decides: bool = True

    @property
    def events(self) -> EventSpec:
        """When an event of this monitor opens and closes."""
        return EventSpec(self.monitor.name, self.monitor.axis, self.threshold, self.clear_s)


@dataclass(frozen=True, slots=True)
class Level:
    """The latest reading of one watch, for a display or a telemetry twin; fields as in `Reading` and `Watch`."""

    monitor: str
    axis: Axis | None
    statistic: float
    threshold: float
    signal: float
    reference: float


@dataclass(frozen=True, slots=True)
class Findings:
    """What one chunk brought.

    judged_s: new judged time. now_ns: vehicle time of the latest row, None if none came. peaks: one figure a watch, the
    highest judged statistic, 0 if none was.
    """

    events: tuple[Event, ...] = ()
    levels: tuple[Level, ...] = ()
    judged_s: float = 0.0
    now_ns: int | None = None
    peaks: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ChainState:
    """Memory of the front, of every watch, and of what they add up to."""

    front: FrontState
    monitors: tuple[Any, ...]
    events: tuple[EventState, ...]
    diagnosis: DiagnosisState

    @property
    def opinion(self) -> Opinion | None:
        """What is held of the fault that is declared now; None while there is none."""
        return opinion_at(self.diagnosis, None)


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Front, watches and diagnosis: the whole way from telemetry to events.

    diagnosis: its channels are the deciding watches, in their order; without one, events name no rotor.
    """

    front: Front
    watches: tuple[Watch, ...]
    diagnosis: DiagnosisSpec = NO_DIAGNOSIS

    def start(self) -> ChainState:
        """Nothing heard yet."""
        monitors = tuple(watch.monitor.start() for watch in self.watches)
        events = tuple(event_step.start() for _ in self.watches)
        return ChainState(self.front.start(), monitors, events, diagnosis.start(self.diagnosis))

    def step(self, state: ChainState, telemetry: Telemetry) -> tuple[ChainState, Findings]:
        """Take in a chunk of telemetry; return what it brought."""
        front, rows = self.front.step(state.front, telemetry)
        return self._watch(state, front, rows)

    def finish(self, state: ChainState) -> Findings:
        """The end of a log: the last rows, and events that are still open with their highest figures."""
        front, rows = self.front.finish(state.front)
        state, findings = self._watch(state, front, rows)
        still_open = tuple(
            diagnosis.named(state.diagnosis, event) for one in state.events for event in event_step.finish(one)
        )
        return replace(findings, events=(*findings.events, *still_open))

    def _watch(self, state: ChainState, front: FrontState, all_rows: tuple[Rows, ...]) -> tuple[ChainState, Findings]:
        monitors, event_states, opinions = list(state.monitors), list(state.events), state.diagnosis
        channels = {channel.monitor for channel in self.diagnosis.fusion.channels}
        found: list[Event] = []
        levels: list[Level] = []
        judged, peaks = 0, [0.0] * len(self.watches)
        now_ns: int | None = None
        for rows in all_rows:
            levels.clear()
            readings: list[Reading] = []
            fresh: list[Event] = []
            for i, watch in enumerate(self.watches):
                monitors[i], reading = watch.monitor.step(monitors[i], rows)
                event_states[i], seen = event_step.events(watch.events, event_states[i], reading)
                fresh += seen
                if watch.decides and watch.monitor.name in channels:
                    readings.append(reading)
                peaks[i] = max(peaks[i], float(reading.statistic.max(where=reading.valid, initial=0.0)))
                if len(reading.t_ns):
                    levels.append(_level(watch, reading))
            opinions = diagnosis.step(self.diagnosis, opinions, readings)
            found += [diagnosis.named(opinions, event) for event in fresh]
            judged += int(rows.rates.valid.sum())
            now_ns = int(rows.block.t_ns[-1])
        state = ChainState(front, tuple(monitors), tuple(event_states), opinions)
        return state, Findings(tuple(found), tuple(levels), judged * self.front.align.dt_s, now_ns, tuple(peaks))


def _level(watch: Watch, reading: Reading) -> Level:
    monitor, statistic, signal = watch.monitor, float(reading.statistic[-1]), float(reading.signal[-1])
    return Level(monitor.name, monitor.axis, statistic, watch.threshold, signal, watch.reference)


def front_of(baseline: Baseline) -> Front:
    """The front that a baseline was made with."""
    link, limits = baseline.link, baseline.link.gate
    return Front(
        AlignSpec(link.dt_s, link.grid, link.max_gap_s),
        GateSpec(limits.min_height_m, limits.min_thrust, limits.need_armed, limits.trim_start_s, limits.trim_end_s),
        RateSpec.of(link.dt_s, baseline.window.samples, baseline.window.order),
    )


def chain_of(baseline: Baseline) -> Chain:
    """The chain that judges by a baseline. Raises BaselineError if it does not hold together.

    The thesis's rule decides only where it stands alone: it alarms on trajectories that its flights did not have.
    """
    watches = tuple(_watch_of(baseline, entry) for entry in baseline.monitors)
    others = [watch for watch in watches if watch.monitor.name != "latency"]
    if not others:
        return Chain(front_of(baseline), watches)
    watches = tuple(replace(watch, decides=watch in others) for watch in watches)
    names = [watch.monitor.name for watch in others]
    unbalance = any(watch.monitor.name == "vibration" and watch.monitor.unit == "g mm" for watch in others)
    feature = {name: names.index(name) for name in FEATURES if name in names and (name != "vibration" or unbalance)}
    half_window_s = baseline.window.samples // 2 * baseline.link.dt_s  # readings of filtered rates are known that late
    channels = tuple(
        Channel(
            watch.monitor.name,
            watch.monitor.unit,
            watch.threshold,
            half_window_s if watch.monitor.name == "innovation" else 0.0,
        )
        for watch in others
    )
    known = known_fault_types() if "energy" in feature else ()
    return Chain(front_of(baseline), watches, DiagnosisSpec(FusionSpec(channels), feature, known))


def _watch_of(baseline: Baseline, entry: MonitorEntry) -> Watch:
    limit = entry.threshold.value
    match entry.spec:
        case RunLengthSpec() as spec:
            monitor = RunLength(model_of(baseline, spec.axis), spec.axis, spec.margin_rad_s)
            return Watch(monitor, limit, spec.margin_rad_s)
        case InnovationSpec() as spec:
            return Watch(Innovation(spec), limit, clear_s=CLEAR_S)
        case RotorSignatureSpec() as spec:
            return Watch(RotorSignature(spec), limit, clear_s=CLEAR_S)
        case UnbalanceSpec() as spec:
            return Watch(Unbalance(spec), limit, clear_s=CLEAR_S)
        case RotorTrimSpec() as spec:
            return Watch(RotorTrim(spec), limit, clear_s=CLEAR_S)
        case VibrationLevelSpec() as spec:
            return Watch(VibrationLevel(spec), limit, clear_s=CLEAR_S)


def model_of(baseline: Baseline, axis: Axis) -> ArxModel:
    """The identified model of one axis, ready to simulate. Raises BaselineError if the baseline has none."""
    found = baseline.model_of(axis)
    return ArxModel(np.array(found.a), np.array(found.b), baseline.link.dt_s, found.order, Method(found.method))
