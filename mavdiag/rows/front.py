"""Telemetry to rows of flight and their rates: alignment, gate and rate filters in a row, for judging and learning."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mavdiag.rows.align import AlignSpec, AlignState
from mavdiag.rows.block import Block
from mavdiag.rows.gate import Border, GateSpec, GateState
from mavdiag.rows.outputs import in_rotor_order
from mavdiag.rows.rates import RateBlock, RateSpec, RateState
from mavdiag.telemetry import BoolArray, IntArray, Telemetry

__all__ = ["Covered", "Front", "FrontState", "Rows", "everywhere"]

Covered: TypeAlias = Callable[[frozenset[str], float, IntArray], BoolArray]


def everywhere(conditions: frozenset[str], memory_s: float, t_ns: IntArray) -> BoolArray:
    """All of the times: nothing was learnt yet that they could be outside of."""
    return np.ones(len(t_ns), dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The next aligned rows of one segment, and the filtered rates that they complete (half a window later).

    covered: at which of some times (n,) [ns] the vehicle flew as the baseline's envelope covers it, of these conditions
        and over so many seconds before; everywhere while a baseline is learnt.
    """

    block: Block
    rates: RateBlock
    covered: Covered = everywhere


@dataclass(frozen=True, slots=True, eq=False)
class FrontState:
    """Memory of the alignment, the gate and the rate filters."""

    align: AlignState
    gate: GateState
    rates: RateState


@dataclass(frozen=True, slots=True, eq=False)
class Front:
    """The three steps. A `Border` follows the last rows of a flying span that ended; the end of a log gives none.

    outputs: the output, from 1, that drives each rotor; None where the rows have them in order as they come.
    """

    align: AlignSpec
    gate: GateSpec
    rates: RateSpec
    outputs: tuple[int, ...] | None = None

    def start(self) -> FrontState:
        """Nothing taken in yet."""
        return FrontState(self.align.start(), self.gate.start(), self.rates.start())

    def step(self, state: FrontState, telemetry: Telemetry) -> tuple[FrontState, tuple[Rows | Border, ...]]:
        """Take in a chunk of telemetry; return the rows that it completes."""
        aligned, blocks = self.align.step(state.align, telemetry)
        gated, parts = self.gate.step(state.gate, blocks)
        return self._rows(aligned, gated, state.rates, parts)

    def finish(self, state: FrontState) -> tuple[FrontState, tuple[Rows | Border, ...]]:
        """The end of a log: the rows that were waiting."""
        aligned, blocks = self.align.finish(state.align)
        gated, parts = self.gate.step(state.gate, blocks)
        gated, rest = self.gate.finish(gated)
        return self._rows(aligned, gated, state.rates, (*parts, *rest))

    def settle(self, state: FrontState) -> tuple[FrontState, tuple[Rows | Border, ...]]:
        """Nothing more comes for now: the rows that the gate held back. Rows may go on later, as another span."""
        gated, rest = self.gate.finish(state.gate)
        return self._rows(state.align, gated, state.rates, rest)

    def whole(self, telemetry: Telemetry) -> tuple[Rows | Border, ...]:
        """All that a whole flight gives."""
        state, first = self.step(self.start(), telemetry)
        return (*first, *self.finish(state)[1])

    def pieces(self, telemetry: Telemetry, most: int) -> Iterator[Rows | Border]:
        """The same of what is believed, in pieces of about `most` rows, made one at a time: what a long log needs."""
        state = self.start()
        for block in self.align.whole(telemetry, most):
            gated, parts = self.gate.step(state.gate, (block,))
            state, rows = self._rows(state.align, gated, state.rates, parts)
            yield from rows
        gated, rest = self.gate.finish(state.gate)
        yield from self._rows(state.align, gated, state.rates, rest)[1]

    def _rows(
        self, aligned: AlignState, gated: GateState, filtered: RateState, parts: tuple[Block | Border, ...]
    ) -> tuple[FrontState, tuple[Rows | Border, ...]]:
        out: list[Rows | Border] = []
        for part in parts:
            if isinstance(part, Border):
                out.append(part)
            else:
                filtered, rates = self.rates.step(filtered, part)
                out.append(Rows(in_rotor_order(part, self.outputs), rates))
        return FrontState(aligned, gated, filtered), tuple(out)
