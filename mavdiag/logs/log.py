"""What the readers of logs share: kinds of logs, bytes out of a file, signals out of tables of records."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.errors import InputError
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.grid import well_dated
from mavdiag.storage import open_regular
from mavdiag.telemetry import FloatArray, IntArray, Log, Series, Signal

#: Logs of the big autopilots have both ends of a flight in them: as live, and its last 0.6 s are dropped (our choice).
RECORDED_GATE = GateSpec(min_thrust=0.1, need_armed=True, trim_start_s=5.0, trim_end_s=0.6)

LOG_BYTES = 2 << 30  # of a log, at most: what it records is held in memory (our choice; half a day at 1 kHz)
TLOG_BYTES = 8 << 30  # of a telemetry log, at most: about as much is held in memory (our choice; two days at 1 kHz)
WINDOW_BYTES = 2 << 20  # of a file that is read piece by piece: 8 MB take 50 MB more memory and no less time (measured)
MAX_TIME_US = 2**53  # 285 years: anything later is damage, and would not fit in nanoseconds

Conversion: TypeAlias = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class LogKind:
    """One kind of log; every reader module exposes its own as KIND."""

    name: str  # for messages
    recognise: Callable[[bytes], bool]  # whether a file's first bytes are of this kind
    read: Callable[[Path, int | None, str | None], Log]  # by path, MAVLink system id and profile, None if not given
    profiles: tuple[str, ...] = ()  # that of every such log, and others that can be asked for; () if messages show it
    gate: GateSpec | None = None  # what counts as flying in it; None where the profile's holds
    airframe_name: str | None = None  # of the one airframe that writes such logs; None if it may be any


@dataclass(frozen=True, slots=True)
class Row:
    """How one signal is made."""

    signal: Signal
    table: str  # by its name; empty for any
    fields: tuple[str | None, ...]  # one for each column; None: not logged, the column is NaN
    convert: Conversion = lambda stored: stored  # from the fields (n, k) to SI and FRD
    integer_unit: float = 1.0  # what a plain integer counts in, where the format of a field depends on the era


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Records of one kind, n of them in the order of the file."""

    name: str
    t_ns: IntArray | None  # (n,) vehicle clock; None if they carry no time
    fields: Mapping[str, NDArray[np.generic]]  # what is stored, (n,) by name
    units: Mapping[str, float] = field(default_factory=dict)  # of those whose format tells one
    starts: IntArray = field(default_factory=lambda: np.empty(0, np.int64))  # (n,) places in the file, if asked for

    def has(self, *names: str, kinds: str = "iuf") -> bool:
        """Whether all these fields are there, numbers of one column: damage can make a text or an array of one."""
        found = [self.fields.get(name) for name in names]
        return all(stored is not None and stored.ndim == 1 and stored.dtype.kind in kinds for stored in found)

    def column(self, name: str, integer_unit: float = 1.0) -> FloatArray:
        """A field as numbers, (n,). Damage can leave a signalling NaN, which becomes a quiet one."""
        stored = self.fields[name]
        unit = self.units.get(name, integer_unit if stored.dtype.kind in "iu" else 1.0)
        with np.errstate(invalid="ignore"):
            return stored.astype(np.float64) * unit

    def columns(self, names: Iterable[str], integer_unit: float = 1.0) -> FloatArray:
        """Several fields, (n, k)."""
        return np.column_stack([self.column(name, integer_unit) for name in names])

    def integers(self, name: str) -> IntArray | None:
        """A field of whole numbers, (n,); None if it is not there."""
        return self.fields[name].astype(np.int64) if self.has(name, kinds="iu") else None


def read_rows(rows: Sequence[Row], tables: Iterable[Table]) -> dict[Signal, Series]:
    """Every signal that the tables carry, by the first of its rows whose fields some table has."""
    found: dict[Signal, Series] = {}
    known = list(tables)
    for row in rows:
        names = [name for name in row.fields if name is not None]
        for table in known:
            suits = row.table in ("", table.name) and table.t_ns is not None and table.has(*names)
            if row.signal in found or not suits:
                continue
            stored = table.columns(names, row.integer_unit)
            if None in row.fields:
                whole = np.full((len(stored), len(row.fields)), np.nan)
                whole[:, [name is not None for name in row.fields]] = stored
                stored = whole
            with np.errstate(invalid="ignore", over="ignore"):  # damaged values become NaN or infinite
                values = row.convert(stored)
            if values.size and table.t_ns is not None:
                found[row.signal] = recorded(row.signal, table.t_ns, values)
    return found


def gather(data: bytes, layout: np.dtype[np.void], starts: IntArray) -> NDArray[np.void]:
    """The records of one layout that start at these bytes, copied into an array (n,). Each must be whole."""
    size = layout.itemsize
    if len(starts) == 0:
        return np.empty(0, layout)
    anywhere = np.ndarray((len(data) - size + 1,), f"V{size}", data, 0, (1,))  # a record at every byte, none copied
    records: NDArray[np.void] = anywhere[starts].view(layout)
    return records


def recorded(signal: Signal, t_ns: IntArray, values: FloatArray) -> Series:
    """A series of a log that only knows the vehicle's clock, (n,); values: (n, k), or (n,) for one column.

    Samples whose stamps leap, up to four in a row, are left out: logs have no checksum, and what follows would be late.
    """
    series = Series(signal, t_ns, t_ns, values.reshape(len(t_ns), -1) if values.ndim == 1 else values)
    return series if (t_ns[1:] >= t_ns[:-1]).all() else series.where(well_dated(t_ns))


@contextmanager
def usable_as(kind: str, path: Path) -> Iterator[None]:
    """Say of an InputError in the block which file cannot be used, and as what."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: not a usable {kind}: {error}") from error


def read_bytes(path: Path, limit: int = -1) -> bytes:
    """The content of a log, or its first `limit` bytes. Raises InputError as `windows_of`."""
    return next(windows_of(path, limit, LOG_BYTES if limit < 0 else TLOG_BYTES))


def windows_of(path: Path, size: int = WINDOW_BYTES, most: int = LOG_BYTES) -> Iterator[bytes]:
    """The content of a log piece by piece, in order. Raises InputError if it cannot be read, is empty or too large."""
    with open_regular(path, most) as file:
        window = file.read(size)
        if not window:
            raise InputError(f"{path}: the file is empty; record the flight again")
        while window:
            yield window
            window = file.read(size)
