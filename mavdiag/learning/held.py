"""Healthy flights put aside on a shelf, so that of many flights only one is in memory at a time.

    a log, once read          -> Measure (its link and rate), and a HeldLog: its signals on the shelf
    a HeldLog and the front   -> rows of flight, as HeldRows on the shelf

A flight is read once. Its rows are looked at several times (guards, fits, scores); each look maps them from the shelf,
which costs less than to make them again, and what was mapped is given back when the look is over.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import overload

import numpy as np

from mavdiag.errors import InputError
from mavdiag.rows.align import USED, Grid, measure_grid
from mavdiag.rows.block import COLUMNS, Block
from mavdiag.rows.front import Rows
from mavdiag.rows.outputs import in_rotor_order
from mavdiag.rows.rates import RateBlock
from mavdiag.storage import Kept, Shelf
from mavdiag.telemetry import IntArray, Log, Series, Signal, Telemetry

__all__ = ["HeldLog", "HeldRows", "Measure", "held", "measured", "of_memory"]


@dataclass(frozen=True, slots=True, eq=False)
class Measure:
    """What a log says of its link.

    dt_s, grid: mean gyro period [s], and how rows are placed.
    steps_ns, counts: (k,) the periods of its set-points that occur, and how often each.
    """

    dt_s: float
    grid: Grid
    steps_ns: IntArray
    counts: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class HeldLog:
    """A log whose signals are aside.

    label: the log without its signals.
    measure: of its link.
    kept: times and values of the signals. signals: which they are.
    """

    label: Log
    measure: Measure
    kept: Kept
    signals: tuple[Signal, ...]

    def open(self) -> Log:
        """The log with its signals. The recorder's clock is not kept; the vehicle's stands for it."""
        arrays = self.kept.get()
        pairs = zip(self.signals, arrays[::2], arrays[1::2], strict=True)
        return replace(self.label, telemetry=Telemetry(tuple(Series(one, t, t, values) for one, t, values in pairs)))


def measured(log: Log) -> Measure:
    """What a log says of its link. Raises InputError, naming it, if it lacks the gyro."""
    try:
        dt_s, grid = measure_grid(log.telemetry)
    except InputError as error:
        raise InputError(f"{log.name}: {error}") from error
    series = log.telemetry.get(Signal.ATTITUDE_SETPOINT)
    steps_ns, counts = np.unique(np.diff(np.unique([] if series is None else series.t_ns)), return_counts=True)
    return Measure(dt_s, grid, steps_ns.astype(np.int64), counts.astype(np.int64))


def held(log: Log, shelf: Shelf, measure: Measure | None = None) -> HeldLog:
    """The log, its signals put aside. measure: of its link, where it is known. Raises InputError as `measured`."""
    kept = [one for one in log.telemetry.series if one.signal in USED]
    arrays = [array for one in kept for array in (one.t_ns, one.values)]
    label = replace(log, telemetry=Telemetry())
    return HeldLog(label, measure or measured(log), shelf.put(arrays), tuple(one.signal for one in kept))


def of_memory(log: Log) -> HeldLog:
    """The log, its signals where they are."""
    return held(log, Shelf(most_bytes=1 << 62))


@dataclass(frozen=True, slots=True, eq=False)
class _Chunk:
    """Rows on a shelf: segment and period, and the arrays of their block and rates."""

    segment: int
    dt_s: float
    kept: Kept

    def rows(self, outputs: tuple[int, ...] | None) -> Rows:
        arrays = self.kept.get()
        block = Block(self.segment, self.dt_s, *arrays[: len(COLUMNS)])
        return Rows(in_rotor_order(block, outputs), RateBlock(self.segment, self.dt_s, *arrays[len(COLUMNS) :]))


@dataclass(frozen=True, slots=True, eq=False)
class HeldRows(Sequence[Rows]):
    """The rows of a flight on a shelf. Each look gives new ones, that take memory only as long as they are held.

    outputs: the output, from 1, that drives each rotor; None where the rows have them in order as they come.
    """

    chunks: tuple[_Chunk, ...]
    outputs: tuple[int, ...] | None = field(default=None)

    @classmethod
    def of(cls, flight: Sequence[Rows], shelf: Shelf) -> "HeldRows":
        """These rows, put aside."""
        names = [one.name for one in fields(RateBlock)[2:]]
        chunks = []
        for rows in flight:
            arrays = [getattr(rows.block, name) for name in COLUMNS] + [getattr(rows.rates, name) for name in names]
            chunks.append(_Chunk(rows.block.segment, rows.block.dt_s, shelf.put(arrays)))
        return cls(tuple(chunks))

    def by_rotor(self, outputs: tuple[int, ...]) -> "HeldRows":
        """The same rows, their outputs in the order of the rotors."""
        return HeldRows(self.chunks, outputs)

    def __len__(self) -> int:
        return len(self.chunks)

    @overload
    def __getitem__(self, at: int) -> Rows: ...

    @overload
    def __getitem__(self, at: slice) -> Sequence[Rows]: ...

    def __getitem__(self, at: int | slice) -> Rows | Sequence[Rows]:
        if isinstance(at, slice):
            return HeldRows(self.chunks[at], self.outputs)
        return self.chunks[at].rows(self.outputs)

    def __iter__(self) -> Iterator[Rows]:
        return (chunk.rows(self.outputs) for chunk in self.chunks)
