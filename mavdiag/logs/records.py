"""What the readers of binary logs share: packed records out of raw bytes, and signals out of tables of records."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.telemetry import FloatArray, IntArray, Series, Signal

Conversion: TypeAlias = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class Row:
    """How one signal is made.

    signal: what is made.
    table: name of the table; empty for any.
    fields: one for each column; None: not logged, the column is NaN.
    convert: from the fields (n, k) to SI and FRD.
    integer_unit: what a field counts that is a plain integer, where the format of a field depends on the era.
    delay: a field with the sample's time after the time stamp [us].
    """

    signal: Signal
    table: str
    fields: tuple[str | None, ...]
    convert: Conversion = lambda stored: stored
    integer_unit: float = 1.0
    delay: str | None = None


class Table(Protocol):
    """Records of one kind, in the order of the file."""

    @property
    def name(self) -> str:
        """By which rows call it."""

    def read(self, row: Row) -> tuple[IntArray, FloatArray] | None:
        """Times (n,) [ns] and stored values (n, k) of a row's fields; None if it has not all of them, or no time."""


def read_rows(rows: Sequence[Row], tables: Iterable[Table]) -> dict[Signal, Series]:
    """Every signal that the tables carry, by the first of its rows that some table has."""
    found: dict[Signal, Series] = {}
    known = list(tables)
    for row in rows:
        for table in known:
            if row.signal in found or row.table not in ("", table.name):
                continue
            stored = table.read(row)
            if stored is None:
                continue
            with np.errstate(invalid="ignore", over="ignore"):  # damaged values become NaN or infinite
                values = row.convert(stored[1])
            if values.size:
                found[row.signal] = recorded(row.signal, stored[0], values)
    return found


def scaled(*factors: float) -> Conversion:
    """Fields times a factor for each column, or one for all.

    >>> scaled(1.0, -1.0)(np.array([[2.0, 3.0]])).tolist()
    [[2.0, -3.0]]
    """
    return lambda stored: stored * np.array(factors)


def gather(data: bytes, layout: np.dtype[np.void], starts: Sequence[int] | IntArray) -> NDArray[np.void]:
    """The records of one layout that start at these bytes, copied into one structured array of shape (n,).

    Every start must leave room for a whole record.

    >>> gather(b"-\\x01\\x02--\\x03\\x04", np.dtype([("a", "u1"), ("b", "u1")]), [1, 5])["b"].tolist()
    [2, 4]
    """
    if len(starts) == 0:
        return np.empty(0, layout)
    size = layout.itemsize
    anywhere = np.ndarray((len(data) - size + 1,), f"V{size}", data, 0, (1,))  # a record at every byte, none copied
    records: NDArray[np.void] = anywhere[np.asarray(starts)].view(layout)
    return records


def as_floats(stored: NDArray[np.generic]) -> FloatArray:
    """Stored numbers as floats, the same shape. Damage can leave a signalling NaN, which becomes a quiet one."""
    with np.errstate(invalid="ignore"):
        return stored.astype(np.float64)


def recorded(signal: Signal, t_ns: IntArray, values: FloatArray) -> Series:
    """A series of a log that only knows the vehicle's clock: the recorder's clock is taken to be the same.

    t_ns: (n,). values: (n, k), or (n,) for a signal of one column.
    """
    return Series(signal, t_ns, t_ns, values.reshape(len(t_ns), -1) if values.ndim == 1 else values)
