"""A judged log in windows of equal length: since when is it as it is? From the one pass that judged it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.chain import Chain, Piece
from mavdiag.decision.account import Stretch
from mavdiag.decision.alarm import Change, Stage
from mavdiag.judging import JUDGED_SHARE, MIN_JUDGED_S, JudgedFlight, Verdict
from mavdiag.telemetry import FloatArray
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
    if flight.chain is None or not any(len(piece.rows.block) for piece in flight.pieces):
        return ()
    span_ns = round(span_s * NS_PER_S)
    pieces = [piece for piece in flight.pieces if len(piece.rows.block)]
    flown = np.unique(np.concatenate([piece.rows.block.t_ns // span_ns for piece in pieces]))
    first, count = int(flown[0]), int(flown[-1] - flown[0]) + 1
    spans = _spans(flight.unjudged, pieces, span_ns, first, count)
    judged_s, ratio = _figures(flight.chain, pieces, span_ns, first, count)
    last_ns = max(int(piece.rows.block.t_ns[-1]) for piece in pieces)
    held = {stage: _held(flight.verdict.changes, stage, span_ns, last_ns) for stage in (Stage.FAULT, Stage.SUSPECTED)}
    found = []
    for k in flown.tolist():
        flown_s, covered_s = spans[:, k - first].tolist()
        verdict = Verdict.FAULT if k in held[Stage.FAULT] else Verdict.SUSPECTED if k in held[Stage.SUSPECTED] else None
        if verdict is None:
            least_s = max(min(MIN_JUDGED_S, span_s / 2), judged_share * flown_s)
            verdict = Verdict.HEALTHY if covered_s >= least_s else Verdict.NOT_JUDGEABLE
        highest = _highest(flight.chain, judged_s[:, k - first], ratio[:, k - first])
        found.append(Window(k * span_s, (k + 1) * span_s, verdict, flown_s, covered_s, *highest))
    return tuple(found)


def _spans(unjudged: Sequence[Stretch], pieces: Sequence[Piece], span_ns: int, first: int, count: int) -> FloatArray:
    """(2, count) flown and judged time of each window [s]."""
    blocks = [piece.rows.block for piece in pieces]
    t_ns = np.concatenate([block.t_ns[block.t_ns >= block.settled_ns] for block in blocks])
    judged = np.ones(len(t_ns), dtype=np.bool_)
    for begin_ns, end_ns in unjudged:
        judged[t_ns.searchsorted(begin_ns) : t_ns.searchsorted(end_ns, side="right")] = False
    number = t_ns // span_ns - first
    counts = [np.bincount(number[rows], minlength=count) for rows in (slice(None), judged)]
    return np.asarray(blocks[0].dt_s * np.stack(counts), dtype=np.float64)


def _figures(
    chain: Chain, pieces: Sequence[Piece], span_ns: int, first: int, count: int
) -> tuple[FloatArray, FloatArray]:
    """(slots, count) judged time [s] and highest ratio, -inf if none."""
    judged_s = np.zeros((len(chain.slots), count))
    ratio = np.full((len(chain.slots), count), -np.inf)
    for piece in pieces:
        for number, (slot, found) in enumerate(zip(chain.slots, piece.found, strict=True)):
            at = (found.t_ns[found.valid] // span_ns - first).clip(0, count - 1)
            judged_s[number] += np.bincount(at, minlength=count) * found.period_s
            np.maximum.at(ratio[number], at, found.value[found.valid] / slot.threshold)
    return judged_s, ratio


def _held(changes: Sequence[Change], stage: Stage, span_ns: int, last_ns: int) -> frozenset[int]:
    """Numbers of the windows in which a stage was held at any time."""
    ends = [*(change.t_ns for change in changes[1:]), last_ns]
    found: set[int] = set()
    for change, end_ns in zip(changes, ends, strict=False):
        if change.stage is stage:
            found.update(range(change.t_ns // span_ns, max(end_ns, change.t_ns) // span_ns + 1))
    return frozenset(found)


def _highest(
    chain: Chain, judged_s: FloatArray, ratio: FloatArray
) -> tuple[float | None, str | None, tuple[WindowMonitor, ...]]:
    """The highest ratio of a deciding monitor, whose it is, and all monitors. judged_s, ratio: (slots,)."""
    deciding = [
        (float(r), slot.monitor.name)
        for slot, r in zip(chain.slots, ratio, strict=True)
        if slot.decides and np.isfinite(r)
    ]
    highest, whose = max(deciding, default=(None, None))
    monitors = []
    for name in dict.fromkeys(slot.monitor.name for slot in chain.slots):
        own = [i for i, slot in enumerate(chain.slots) if slot.monitor.name == name]
        peak = float(ratio[own].max())
        monitors.append(WindowMonitor(name, float(judged_s[own].max()), peak if np.isfinite(peak) else None))
    return highest, whose, tuple(monitors)
