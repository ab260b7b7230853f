"""A judged log in windows of equal length: since when is it as it is? From the one pass that judged it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.chain import Chain, Piece
from mavdiag.decision.alarm import Change, Stage
from mavdiag.judging import MIN_JUDGED_S, JudgedFlight, Verdict
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

__all__ = ["Window", "WindowMonitor", "windows_of"]


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
    verdict: fault while one was declared; healthy if a monitor that decides about propellers judged for a second, or
        half of a window that is shorter than two; else not judgeable.
    judged_s: judged time of the monitor that decides about propellers and judged for longest [s].
    ratio, monitor: the highest ratio of a deciding monitor to its threshold, and whose it is; None if none judged.
    monitors: all of them.
    """

    from_s: float
    to_s: float
    verdict: Verdict
    judged_s: float
    ratio: float | None
    monitor: str | None
    monitors: tuple[WindowMonitor, ...]


def windows_of(flight: JudgedFlight, span_s: float) -> tuple[Window, ...]:
    """The windows in which the vehicle flew, in order of time. span_s: their length, 1 s or more [s]."""
    if flight.chain is None or not any(len(piece.rows.block) for piece in flight.pieces):
        return ()
    span_ns = round(span_s * NS_PER_S)
    pieces = [piece for piece in flight.pieces if len(piece.rows.block)]
    flown = np.unique(np.concatenate([piece.rows.block.t_ns // span_ns for piece in pieces]))
    first, count = int(flown[0]), int(flown[-1] - flown[0]) + 1
    judged_s, ratio = _figures(flight.chain, pieces, span_ns, first, count)
    last_ns = max(int(piece.rows.block.t_ns[-1]) for piece in pieces)
    faulty = _faulty(flight.verdict.changes, span_ns, last_ns)
    return tuple(
        _window(flight.chain, int(k) * span_s, span_s, int(k) in faulty, judged_s[:, k - first], ratio[:, k - first])
        for k in flown
    )


def _figures(
    chain: Chain, pieces: Sequence[Piece], span_ns: int, first: int, count: int
) -> tuple[FloatArray, FloatArray]:
    """Judged time [s] and highest ratio (-inf if none) of each slot in each window, (slots, count) both."""
    judged_s = np.zeros((len(chain.slots), count))
    ratio = np.full((len(chain.slots), count), -np.inf)
    for piece in pieces:
        for number, (slot, found) in enumerate(zip(chain.slots, piece.found, strict=True)):
            at = (found.t_ns[found.valid] // span_ns - first).clip(0, count - 1)
            judged_s[number] += np.bincount(at, minlength=count) * found.period_s
            np.maximum.at(ratio[number], at, found.value[found.valid] / slot.threshold)
    return judged_s, ratio


def _faulty(changes: Sequence[Change], span_ns: int, last_ns: int) -> frozenset[int]:
    """Numbers of the windows in which a fault was held at any time."""
    ends = [*(change.t_ns for change in changes[1:]), last_ns]
    found: set[int] = set()
    for change, end_ns in zip(changes, ends, strict=False):
        if change.stage is Stage.FAULT:
            found.update(range(change.t_ns // span_ns, max(end_ns, change.t_ns) // span_ns + 1))
    return frozenset(found)


def _window(
    chain: Chain, from_s: float, span_s: float, faulty: bool, judged_s: FloatArray, ratio: FloatArray
) -> Window:
    """One window. judged_s, ratio: (slots,) of each slot in it."""
    of_propellers = [s for slot, s in zip(chain.slots, judged_s, strict=True) if slot.of_propellers]
    judged = float(max(of_propellers, default=0.0))
    deciding = [
        (float(r), slot.monitor.name)
        for slot, r in zip(chain.slots, ratio, strict=True)
        if slot.decides and np.isfinite(r)
    ]
    highest, whose = max(deciding, default=(None, None))
    enough = judged >= min(MIN_JUDGED_S, span_s / 2)
    verdict = Verdict.FAULT if faulty else Verdict.HEALTHY if enough else Verdict.NOT_JUDGEABLE
    monitors = []
    for name in dict.fromkeys(slot.monitor.name for slot in chain.slots):
        own = [i for i, slot in enumerate(chain.slots) if slot.monitor.name == name]
        peak = float(ratio[own].max())
        monitors.append(WindowMonitor(name, float(judged_s[own].max()), peak if np.isfinite(peak) else None))
    return Window(from_s, from_s + span_s, verdict, judged, highest, whose, tuple(monitors))
