"""What a page draws of a flight, thinned while it is judged: none of its rows is kept but the first, and ten seconds.

All times are of the flight: seconds since the first sample of the gyro.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from mavdiag.airframe.fingerprint import joined
from mavdiag.chain import Chain
from mavdiag.kernel import Piece, Slot
from mavdiag.look.figures import Spectrum, spectrum_of
from mavdiag.report.chart import Thinned
from mavdiag.rows.block import Block
from mavdiag.rows.front import Rows
from mavdiag.rows.windows import spans
from mavdiag.telemetry import Axis, FloatArray, Log, Series, Signal
from mavdiag.traces import RateTrace, rate_traces, slot_traces
from mavdiag.units import NS_PER_S

SHOWN_S = 10.0  # of flight beside the model: more of it and the three lines cannot be told apart (our choice)
BEFORE = 0.6  # of that before the end of the longest run
MOST_ROWS = 8000  # of the flight that are kept, for fits at several windows: about a second (our choice)
WELCH_S = 20.0  # of rows that a spectrum is made of at a time (our choice)


@dataclass(frozen=True, slots=True, eq=False)
class SlotSketch:
    """One slot: its judged values, the squares of their levels, and its evidence of each rotor."""

    slot: Slot
    value: Thinned
    squares: Thinned
    rotors: tuple[Thinned, ...]


@dataclass(slots=True, eq=False)
class RateSketch:
    """One axis beside its model. runs: (4, k), as `runs_of` gives them."""

    axis: Axis
    margin_rad_s: float
    fml_s: float
    residual: Thinned
    runs: FloatArray = field(default_factory=lambda: np.empty((4, 0)))
    judged: int = 0  # rows
    outside: int = 0  # of them beyond the margin
    squares: float = 0.0
    open: tuple[int, bool] = (-1, False)  # segment of the last row, and whether it was outside

    def take(self, trace: RateTrace, t_s: FloatArray) -> None:
        """Take in the next rows."""
        if not len(t_s):
            return
        self.residual.add(t_s, np.where(trace.judged, trace.residual, np.nan))
        known, fresh = trace.residual[trace.judged], runs_of(trace, t_s)
        outside = trace.judged & (np.abs(trace.residual) > self.margin_rad_s)
        if self.open == (trace.segment[0], True) and outside[0]:  # the last run goes on
            fresh[0, 0], fresh[3, 0] = self.runs[0, -1], max(fresh[3, 0], self.runs[3, -1])
            fresh[2, 0] = max(fresh[2, 0], self.runs[2, -1])
            self.runs = self.runs[:, :-1]
        self.runs = np.concatenate((self.runs, fresh), axis=1)
        self.open = (int(trace.segment[-1]), bool(outside[-1]))
        self.judged, self.outside = self.judged + len(known), self.outside + int(outside.sum())
        self.squares += float(np.square(known).sum())

    @property
    def longest(self) -> FloatArray:
        """Start and end [s], FSD [s] and height [rad/s] of the longest run; zeros without one."""
        return self.runs[:, self.runs[2].argmax()] if self.runs.size else np.zeros(4)


def runs_of(trace: RateTrace, t_s: FloatArray) -> FloatArray:
    """Start and end [s], FSD [s], highest |r| - margin [rad/s] of each run outside of the margin, (4, k)."""
    excess = np.abs(trace.residual) - trace.margin_rad_s
    outside = trace.judged & (excess > 0)
    edges = [0, *(np.flatnonzero(np.diff(trace.segment)) + 1).tolist(), len(outside)]
    pieces = [(low + first, low + stop) for low, high in pairwise(edges) for first, stop in spans(outside[low:high])]
    found = [(t_s[a], t_s[b - 1], trace.fsd_s[a:b].max(), excess[a:b].max()) for a, b in pieces]
    return np.array(found, dtype=np.float64).reshape(-1, 4).T


class Sketch:
    """What a page draws of a flight; `take` is what `judging.judge_in_full` shows its pieces to."""

    def __init__(self, log: Log, columns: int) -> None:
        gyro = log.telemetry.get(Signal.BODY_RATE)
        t_ns = np.zeros(1, dtype=np.int64) if gyro is None or not len(gyro) else gyro.t_ns
        self.begin_ns, self.columns = int(t_ns.min()), columns
        self.span = (0.0, max((int(t_ns.max()) - self.begin_ns) / NS_PER_S, 1e-3))
        self.slots, self.rates = dict[int, SlotSketch](), dict[Axis, RateSketch]()
        self.shown, self.beginning, self.dt_s = list[tuple[RateTrace, ...]](), list[Rows](), math.nan
        self._rows, self._power, self._averaged, self._hz = list[Rows](), np.empty(0), 0, np.empty(0)

    def s(self, t_ns: int) -> float:
        """A time of the vehicle's clock as one of the flight."""
        return (t_ns - self.begin_ns) / NS_PER_S

    def series(self, series: Series, column: int) -> Thinned:
        """One column of a signal."""
        found, order = Thinned(self.span, self.columns), np.argsort(series.t_ns, kind="stable")
        found.add((series.t_ns[order] - self.begin_ns) / NS_PER_S, series.values[order, column])
        return found

    def take(self, chain: Chain, pieces: Sequence[Piece]) -> None:
        """Take in the next pieces."""
        for piece in pieces:
            self._take_slots(chain, piece)
            self._take_rates(rate_traces(chain, (piece,)))
            self._take_rows(piece.rows)

    def _take_slots(self, chain: Chain, piece: Piece) -> None:
        for number, trace in enumerate(slot_traces(chain, (piece,))):
            found = trace.found
            if number not in self.slots:
                many = range(2 + trace.slot.monitor.rotors)
                value, squares, *rotors = (Thinned(self.span, self.columns) for _ in many)
                self.slots[number] = SlotSketch(trace.slot, value, squares, tuple(rotors))
            sketch, t_s = self.slots[number], (found.t_ns[found.valid] - self.begin_ns) / NS_PER_S
            sketch.value.add(t_s, found.value[found.valid])
            if trace.slot.monitor.name == "unbalance":
                sketch.squares.add(t_s, np.square(found.level[found.valid]))
            for thinned, evidence in zip(sketch.rotors, found.rotors[found.valid].T, strict=False):
                thinned.add(t_s, evidence)

    def _take_rates(self, traces: tuple[RateTrace, ...]) -> None:
        """The residuals; and of the rates what may lie about the longest run, or else the latest."""
        for trace in traces:
            if trace.axis not in self.rates:
                empty = Thinned(self.span, self.columns)
                self.rates[trace.axis] = RateSketch(trace.axis, trace.margin_rad_s, trace.fml_s, empty)
            self.rates[trace.axis].take(trace, (trace.t_ns - self.begin_ns) / NS_PER_S)
        if not traces or not len(traces[0].t_ns):
            return
        self.shown.append(traces)
        (start_s, stop_s), now_s = self.moment, self.s(int(traces[0].t_ns[-1]))

        def near(first_s: float, last_s: float) -> bool:
            return last_s >= now_s - SHOWN_S or (last_s >= start_s and first_s <= stop_s)

        self.shown = [one for one in self.shown if near(*map(self.s, one[0].t_ns[[0, -1]].tolist()))]

    @property
    def moment(self) -> tuple[float, float]:
        """The stretch of `SHOWN_S` about the longest run [s]; the latest of the flight if there is none."""
        runs = [(rate.longest[2] / rate.fml_s, rate.longest[1]) for rate in self.rates.values() if rate.runs.size]
        latest_s = max((self.s(int(parts[0].t_ns[-1])) for parts in self.shown), default=0.0)
        start_s = max(0.0, max(runs)[1] - BEFORE * SHOWN_S if runs else latest_s - SHOWN_S)
        return start_s, start_s + SHOWN_S

    def _take_rows(self, rows: Rows) -> None:
        if not len(rows.block):
            return
        self.dt_s = rows.block.dt_s
        kept = sum(len(one.block) for one in self.beginning)
        if kept < MOST_ROWS:
            self.beginning.append(replace(rows, block=rows.block.rows(0, min(len(rows.block), MOST_ROWS - kept))))
        if self._rows and self._rows[0].block.segment != rows.block.segment:
            self._average()
        self._rows.append(rows)
        if sum(len(one.block) for one in self._rows) * self.dt_s > WELCH_S:
            self._average()

    def _average(self) -> None:
        found, self._rows = spectrum_of(joined(self._rows)), []
        if found is not None:
            more = found.averaged * found.power
            self._power = self._power + more if self._averaged else more
            self._averaged, self._hz = self._averaged + found.averaged, found.frequency_hz

    @property
    def spectrum(self) -> Spectrum | None:
        """Of the whole flight."""
        if self._rows:
            self._average()
        return Spectrum(self._hz, self._power / self._averaged, self._averaged) if self._averaged else None

    @property
    def blocks(self) -> list[Block]:
        """The first rows of the flight, one block a segment."""
        return joined(self.beginning)
