"""From a judged flight to what is kept of it: the figures of a history, and windows of equal length. Pure."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import Stage
from mavdiag.judging import JUDGED_SHARE, MIN_JUDGED_S, JudgedFlight, Verdict
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.printable import printable
from mavdiag.telemetry import Axis, Log
from mavdiag.traces import SlotTrace, slot_traces
from mavdiag.units import NS_PER_S


@dataclass(frozen=True, slots=True)
class SlotFigures:
    """One monitor over a flight, on one axis (None: the whole vehicle), with the threshold that judged it.

    median, peak: where it is valid, or None; the peak of `fsd` is the longest run [s]. judged_s: that it judged [s].
    """

    monitor: str
    axis: Axis | None
    unit: str
    threshold: float
    median: float | None
    peak: float | None
    judged_s: float


@dataclass(frozen=True, slots=True)
class FlightRecord:
    """What is kept of a judged flight; verdict, reason, judged_s as in `LogVerdict`.

    content: the hash of its file, and the vehicle in it. baseline: digest of the one that judged it.
    started_ns, added_ns: of its first sample (0 if unknown) and of its judging, unix epoch [ns].
    rotor_trim: rise of each rotor's command, median over the flight [fraction of hover]; empty where it was not judged.
    trim: of the whole flight by roll, pitch and yaw (`TrimMonitor.whole`) [fraction of hover]; empty if unknown.
    """

    airframe: str
    log: str
    content: str
    started_ns: int
    added_ns: int
    baseline: str
    verdict: Verdict
    reason: str
    judged_s: float
    slots: tuple[SlotFigures, ...] = ()
    rotor_trim: tuple[float, ...] = ()
    trim: tuple[float, ...] = ()

    @property
    def t_ns(self) -> int:
        """When it is taken to have been flown, unix epoch [ns]."""
        return self.started_ns or self.added_ns


@dataclass(frozen=True, slots=True)
class WindowMonitor:
    """One monitor in a window: time that it judged, on the axis where it judged longest [s], and its highest judged
    statistic over the threshold, of all axes; None if it did not judge."""

    name: str
    judged_s: float
    ratio: float | None


@dataclass(frozen=True, slots=True)
class Window:
    """A part of a flight, by the vehicle's clock [s]; windows begin at multiples of their length.

    flown_s, judged_s: time in the air, and how much of it any monitor that decides about propellers judged [s].
    ratio, monitor: the highest ratio of a deciding monitor to its threshold, and whose it is; None if none judged.
    """

    from_s: float
    to_s: float
    verdict: Verdict
    flown_s: float
    judged_s: float
    ratio: float | None
    monitor: str | None
    monitors: tuple[WindowMonitor, ...]


def record_of(log: Log, judged: JudgedFlight, baseline: Baseline) -> FlightRecord:
    """What is kept of a flight, without its airframe and the time at which a history takes it in."""
    traces = () if judged.chain is None else slot_traces(judged.chain, judged.pieces)
    content = log.sha256 if log.vehicle is None else f"{log.sha256}:{log.vehicle}"
    of_trim = [(trace.slot.monitor, trace.found) for trace in traces if isinstance(trace.slot.monitor, RotorTrim)]
    rises = [found.rotors[found.valid] for _, found in of_trim if found.rotors.shape[1] and found.valid.any()]
    flown, verdict = [piece.rows for piece in judged.pieces if len(piece.rows.block)], judged.verdict
    return FlightRecord(
        "",
        printable(log.name),
        content,
        log.started_ns,
        0,
        baseline.digest,
        verdict.verdict,
        verdict.reason,
        verdict.judged_s,
        tuple(_slot_figures(trace) for trace in traces),
        tuple(np.median(rises[0], axis=0).tolist()) if rises else (),
        of_trim[0][0].whole(flown) if of_trim else (),
    )


def _slot_figures(trace: SlotTrace) -> SlotFigures:
    slot, found = trace.slot, trace.found
    value = found.value[found.valid & np.isfinite(found.value)]
    median, peak = (float(np.median(value)), float(value.max())) if len(value) else (None, None)
    return SlotFigures(*slot.key, slot.monitor.unit, slot.threshold, median, peak, found.judged_s)


def windows_of(flight: JudgedFlight, span_s: float, judged_share: float = JUDGED_SHARE) -> tuple[Window, ...]:
    """The windows of so many seconds (1 or more) in which the vehicle flew, in order of time."""
    pieces = [piece for piece in flight.pieces if len(piece.rows.block)]
    if flight.chain is None or not pieces:
        return ()
    blocks, traces = [piece.rows.block for piece in pieces], slot_traces(flight.chain, pieces)
    names = dict.fromkeys(trace.slot.monitor.name for trace in traces)
    of_name = {name: [one for one in traces if one.slot.monitor.name == name] for name in names}
    deciding = {trace.slot.monitor.name for trace in traces if trace.slot.decides}
    t_ns = np.concatenate([block.t_ns for block in blocks])
    settled = np.concatenate([block.t_ns >= block.settled_ns for block in blocks])
    judged = settled.copy()
    for begin_ns, end_ns in flight.unjudged:
        judged[t_ns.searchsorted(begin_ns) : t_ns.searchsorted(end_ns, side="right")] = False
    span_ns, found = round(span_s * NS_PER_S), []
    for k in np.unique(t_ns // span_ns).tolist():
        edges = (k * span_ns, (k + 1) * span_ns)
        rows = slice(*t_ns.searchsorted(edges))
        flown_s, judged_s = (blocks[0].dt_s * int(kind[rows].sum()) for kind in (settled, judged))
        flown_s += sum(max(min(end, edges[1]) - max(begin, edges[0]), 0) for begin, end in flight.hidden) / NS_PER_S
        enough = judged_s >= max(min(MIN_JUDGED_S, span_s / 2), judged_share * flown_s)
        held = set(_held(flight, edges, int(t_ns[-1])))
        verdict = Verdict.HEALTHY if enough else Verdict.NOT_JUDGEABLE
        if held & {Stage.FAULT, Stage.SUSPECTED}:
            verdict = Verdict.FAULT if Stage.FAULT in held else Verdict.SUSPECTED
        monitors = tuple(_shown(name, own, edges) for name, own in of_name.items())
        ratios = [(one.ratio, one.name) for one in monitors if one.name in deciding and one.ratio is not None]
        ratio, whose = max((pair for pair in ratios if np.isfinite(pair[0])), default=(None, None))
        figures = (verdict, flown_s, judged_s, ratio, whose)
        found.append(Window(k * span_s, (k + 1) * span_s, *figures, monitors))
    return tuple(found)


def _held(flight: JudgedFlight, edges: tuple[int, int], last_ns: int) -> Iterator[Stage]:
    changes = flight.verdict.changes
    for change, end_ns in zip(changes, [*(change.t_ns for change in changes[1:]), last_ns], strict=False):
        if change.t_ns < edges[1] and max(end_ns, change.t_ns) >= edges[0]:
            yield change.stage


def _shown(name: str, traces: Sequence[SlotTrace], edges: tuple[int, int]) -> WindowMonitor:
    spans_s, ratios = list[float](), list[float]()
    for trace in traces:
        rows = slice(*trace.found.t_ns.searchsorted(edges))
        ratio = trace.found.value[rows][trace.found.valid[rows]] / trace.slot.threshold
        spans_s.append(len(ratio) * trace.found.period_s)
        ratios += [float(ratio.max())] if len(ratio) else []
    return WindowMonitor(name, max(spans_s), max(ratios, default=None))
