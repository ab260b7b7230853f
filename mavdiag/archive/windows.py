"""A judged log in windows of equal length: since when is it as it is? From the one pass that judged it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.chain import Chain
from mavdiag.decision.alarm import Stage
from mavdiag.judging import JUDGED_SHARE, MIN_JUDGED_S, JudgedFlight, Verdict
from mavdiag.kernel import Piece
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.units import NS_PER_S


@dataclass(frozen=True, slots=True)
class WindowMonitor:
    """One monitor in a window.

    judged_s: time that it judged, on the axis where it judged longest [s].
    ratio: its highest judged statistic over the threshold, of all axes; None if it did not judge.
    """

    name: str
    judged_s: float
    ratio: float | None


@dataclass(frozen=True, slots=True)
class Window:
    """A part of a flight.

    from_s, to_s: of the vehicle's clock [s]; windows begin at multiples of their length.
    verdict: fault while one was declared, suspected while one was; healthy if enough of what was flown in it was
        judged, as of a whole log; else not judgeable.
    flown_s: time in the air, without take-offs and landings [s].
    judged_s: how much of it any monitor that decides about propellers judged [s].
    ratio, monitor: the highest ratio of a deciding monitor to its threshold, and whose it is; None if none judged.
    monitors: all of them.
    """

    from_s: float
    to_s: float
    verdict: Verdict
    flown_s: float
    judged_s: float
    ratio: float | None
    monitor: str | None
    monitors: tuple[WindowMonitor, ...]


def windows_of(flight: JudgedFlight, span_s: float, judged_share: float = JUDGED_SHARE) -> tuple[Window, ...]:
    """The windows in which the vehicle flew, in order of time.

    span_s: their length, 1 s or more [s]. judged_share: as for a whole log.
    """
    pieces = [piece for piece in flight.pieces if len(piece.rows.block)]
    if flight.chain is None or not pieces:
        return ()
    span_ns, blocks = round(span_s * NS_PER_S), [piece.rows.block for piece in pieces]
    t_ns = np.concatenate([block.t_ns for block in blocks])
    settled = np.concatenate([block.t_ns >= block.settled_ns for block in blocks])
    judged = settled.copy()
    for begin_ns, end_ns in flight.unjudged:
        judged[t_ns.searchsorted(begin_ns) : t_ns.searchsorted(end_ns, side="right")] = False
    changes = flight.verdict.changes
    ends_ns = [*(change.t_ns for change in changes[1:]), int(t_ns[-1])]
    looks = [_looks(pieces, number, slot.threshold) for number, slot in enumerate(flight.chain.slots)]
    found = []
    for k in np.unique(t_ns // span_ns).tolist():
        edges = (k * span_ns, (k + 1) * span_ns)
        rows = slice(*t_ns.searchsorted(edges))
        flown_s, covered_s = (blocks[0].dt_s * int(kind[rows].sum()) for kind in (settled, judged))
        held = {
            change.stage
            for change, end_ns in zip(changes, ends_ns, strict=False)
            if change.t_ns < edges[1] and max(end_ns, change.t_ns) >= edges[0]
        }
        least_s = max(min(MIN_JUDGED_S, span_s / 2), judged_share * flown_s)
        verdict = Verdict.HEALTHY if covered_s >= least_s else Verdict.NOT_JUDGEABLE
        if held & {Stage.FAULT, Stage.SUSPECTED}:
            verdict = Verdict.FAULT if Stage.FAULT in held else Verdict.SUSPECTED
        shown = [_shown(slot_looks, edges) for slot_looks in looks]
        found.append(Window(k * span_s, (k + 1) * span_s, verdict, flown_s, covered_s, *_highest(flight.chain, shown)))
    return tuple(found)


def _looks(pieces: Sequence[Piece], number: int, threshold: float) -> tuple[IntArray, FloatArray, float]:
    """When a slot judged, its ratio to the threshold, and the time that one look stands for [s]."""
    found = [piece.found[number] for piece in pieces]
    t_ns = np.concatenate([part.t_ns[part.valid] for part in found])
    return t_ns, np.concatenate([part.value[part.valid] for part in found]) / threshold, found[0].period_s


def _shown(looks: tuple[IntArray, FloatArray, float], edges: tuple[int, int]) -> tuple[float, float | None]:
    """Judged time [s] and highest ratio between two times."""
    t_ns, ratio, period_s = looks
    part = ratio[slice(*t_ns.searchsorted(edges))]
    return len(part) * period_s, float(part.max()) if len(part) else None


def _highest(
    chain: Chain, shown: Sequence[tuple[float, float | None]]
) -> tuple[float | None, str | None, tuple[WindowMonitor, ...]]:
    """The highest ratio of a deciding monitor, whose it is, and all monitors, each by its longest and highest axis."""
    pairs = list(zip(chain.slots, shown, strict=True))
    deciding = [(r, slot.monitor.name) for slot, (_, r) in pairs if slot.decides and r is not None and np.isfinite(r)]
    monitors = []
    for name in dict.fromkeys(slot.monitor.name for slot in chain.slots):
        own = [figures for slot, figures in pairs if slot.monitor.name == name]
        peak = max((r for _, r in own if r is not None), default=None)
        monitors.append(WindowMonitor(name, max(judged_s for judged_s, _ in own), peak))
    return *max(deciding, default=(None, None)), tuple(monitors)
