"""Telemetry to rows of flight and their rates: alignment, gate and rate filters in a row, for judging and learning."""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from mavdiag.rows.align import NEVER_NS, AlignSpec, AlignState
from mavdiag.rows.block import Block
from mavdiag.rows.block import Rows as Rows
from mavdiag.rows.gate import Border, GateSpec, GateState
from mavdiag.rows.grid import measure_grid, usual_times
from mavdiag.rows.quality import LinkQuality, believed
from mavdiag.rows.rates import RateSpec, RateState
from mavdiag.telemetry import IntArray, Series, Signal, Telemetry


@dataclass(frozen=True, slots=True, eq=False)
class FrontState:
    """Memory of the three steps, each changed in place."""

    align: AlignState
    gate: GateState
    rates: RateState


@dataclass(frozen=True, slots=True, eq=False)
class Front:
    """The three steps. A `Border` follows the last rows of a flying span that ended; the end of a log gives none."""

    align: AlignSpec
    gate: GateSpec
    rates: RateSpec

    def start(self) -> FrontState:
        """Nothing taken in yet."""
        return FrontState(self.align.start(), self.gate.start(), self.rates.start())

    def step(self, state: FrontState, *telemetry: Telemetry) -> tuple[Rows | Border, ...]:
        """Take in chunks of telemetry; return the rows that they complete."""
        return tuple(self._rows(state, self.align.step(state.align, *telemetry)))

    def finish(self, state: FrontState) -> tuple[Rows | Border, ...]:
        """The end of a log: the rows that were waiting."""
        return tuple(self._ended(state))

    def settle(self, state: FrontState) -> tuple[Rows | Border, ...]:
        """Nothing more comes for now: the rows that the gate held back. Rows may go on later, as another span."""
        return tuple(self._told(state, self.gate.finish(state.gate)))

    def pieces(self, parts: Iterable[Telemetry]) -> Iterator[Rows | Border]:
        """All that a whole flight gives, of which these are the parts (`in_pieces`)."""
        state, until_ns = self.start(), -NEVER_NS
        for part in parts:
            yield from self._rows(state, self.align.rows(state.align, until_ns))
            self.align.append(state.align, (part,))
            until_ns = self.align.take(state.align, live=False)
        yield from self._ended(state)  # with the rows of the last part

    def _ended(self, state: FrontState) -> Iterator[Rows | Border]:
        yield from self._rows(state, self.align.finish(state.align))
        yield from self._told(state, self.gate.finish(state.gate))

    def _rows(self, state: FrontState, blocks: Iterable[Block]) -> Iterator[Rows | Border]:
        for block in blocks:
            yield from self._told(state, self.gate.step(state.gate, block))

    def _told(self, state: FrontState, parts: Iterable[Block | Border]) -> Iterator[Rows | Border]:
        for part in parts:
            yield part if isinstance(part, Border) else self.rates.step(state.rates, part)


def in_pieces(telemetry: Telemetry, most: int) -> Iterator[Telemetry]:
    """A log cut by the vehicle's time, each piece with so many samples of the gyro; none is left behind."""
    times = [_usual_times(series.t_ns) for series in telemetry.series]
    gyro = next(
        (t_ns for series, t_ns in zip(telemetry, times, strict=True) if series.signal is Signal.BODY_RATE), None
    )
    edges = np.empty(0, dtype=np.int64) if gyro is None else gyro[most::most]
    cuts = [[0, *t_ns.searchsorted(edges).tolist(), len(t_ns)] for t_ns in times]
    for bounds in zip(*map(itertools.pairwise, cuts), strict=True):
        yield Telemetry(tuple(one.where(slice(*ends)) for one, ends in zip(telemetry, bounds, strict=True)))


def _usual_times(t_ns: IntArray) -> IntArray:
    """Times that never go back, in the order of the samples; a few stamps that leap do not count."""
    if not (t_ns[1:] < t_ns[:-1]).any():
        return t_ns
    return np.minimum.accumulate(usual_times(t_ns)[::-1])[::-1]


def warm() -> None:
    """Compile what makes rows, or load it from where it is kept, by a second of a gyro."""
    t_ns = 10_000_000 * np.arange(100)
    telemetry = Telemetry((Series(Signal.BODY_RATE, t_ns, t_ns, np.zeros((100, 3))),))
    measure_grid(telemetry)
    believed(LinkQuality(), telemetry)  # as the first landing asks for
    front = Front(AlignSpec(0.01), GateSpec(), RateSpec.of(0.01, 5))
    front.step(front.start(), telemetry)
