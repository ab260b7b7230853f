"""CSV recordings, whatever wrote them: a column map says which column is what (`mavdiag.logs.csv_columns`).

No CSV file is recognised by its content; it takes the map.
"""

import csv
import io
import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mavdiag.errors import InputError
from mavdiag.logs.csv_columns import ColumnMap, SignalColumns
from mavdiag.logs.log import LogKind, read_bytes, sha256_of
from mavdiag.logs.records import recorded
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import FloatArray, IntArray, Log, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

__all__ = ["KIND", "PROFILE", "read_csv"]

PROFILE = "csv"
GATE = GateSpec(min_thrust=0.1, need_armed=True, trim_start_s=1.0, trim_end_s=0.6)  # as far as the columns tell
LATEST_NS = 2**62
_line_end = re.compile(rb"[\r\n]").search
LINE_BYTES = 64 << 10  # of a line, at most (our choice): a thousand columns have a quarter of it
DAMAGED_SHARE = 0.5  # of the rows: beyond it the map is wrong (our choice)


def read_csv(path: Path, columns: ColumnMap) -> Log:
    """A recording as a log of the profile "csv". A cell that is no number is unknown; a row without a time is left out.

    Times are the vehicle's and start where the column does. Raises InputError if the file cannot be read, a column is
    not there, or most rows have no time or no gyro.
    """
    data = read_bytes(path)
    if any(_line_end(data, at, at + LINE_BYTES) is None for at in range(0, len(data) - LINE_BYTES + 1, LINE_BYTES)):
        raise InputError(f"{path}: a line has over {LINE_BYTES // 1024} KiB: it is no CSV file, or damaged")
    text = data.decode("utf-8-sig", errors="replace")
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    lines = text.split("\n", columns.skip_lines)[-1] if columns.skip_lines else text
    try:
        table = _table(path, lines, columns)
    except csv.Error as error:
        raise InputError(f"{path}: is no sound CSV file ({error}); save it again") from error
    t_ns, known = _times(table[:, 0], columns)
    if not len(t_ns):
        raise InputError(f"{path}: no row has a time; check the column map")
    series, first = [], 1
    for one in columns.signals:
        values = table[known, first : first + len(one.columns)] * np.array(one.factors)
        first += len(one.columns)
        made = _series(one, t_ns, values)
        series += [made] if len(made) else []
    gyro = next((one for one in series if one.signal is Signal.BODY_RATE), None)
    if gyro is None or len(gyro) < DAMAGED_SHARE * len(table):
        raise InputError(f"{path}: most rows have no gyro; check the column map")
    left_out = len(table) - len(gyro)
    notes = (f"{left_out} of {len(table)} rows have no time or no gyro and were left out",) if left_out else ()
    return Log(path.name, sha256_of(data), PROFILE, Telemetry(tuple(series)), notes=notes, motor_order=True)


def _table(path: Path, text: str, columns: ColumnMap) -> FloatArray:
    """Time and the mapped columns in their order, (n, 1 + k); NaN for what is no number."""
    head, _, rest = text.partition("\n")
    names = [cell.strip() for cell in next(csv.reader([head], delimiter=columns.delimiter), [])]
    wanted = [*(() if columns.time_column is None else (columns.time_column,))]
    wanted += [column for one in columns.signals for column in one.columns]
    places = [_place(path, column, names, header=columns.header) for column in wanted]
    body = rest if columns.header else text
    if not body.strip():
        raise InputError(f"{path}: it has no rows; check skip_lines and header of the column map")
    try:
        found = np.loadtxt(io.StringIO(body), delimiter=columns.delimiter, usecols=places, ndmin=2, comments=None)
    except ValueError:
        found = _cell_by_cell(body, columns.delimiter, places)
    if columns.time_column is None:
        return np.column_stack([np.arange(len(found)) / columns.rate_hz, found])
    return np.asarray(found, dtype=np.float64)


def _cell_by_cell(body: str, delimiter: str, places: Sequence[int]) -> FloatArray:
    rows = [row for row in csv.reader(io.StringIO(body, newline=""), delimiter=delimiter) if row]
    cells = [[_number(row[place]) if place < len(row) else math.nan for place in places] for row in rows]
    return np.array(cells, dtype=np.float64).reshape(len(rows), len(places))


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _place(path: Path, column: str, names: Sequence[str], *, header: bool) -> int:
    """Number from 0 of a column. Raises InputError if there is none."""
    if header and column in names:
        return names.index(column)
    if not header and column.isdecimal() and 1 <= int(column) <= len(names):
        return int(column) - 1
    there = ", ".join(names[:20]) if header else f"1 to {len(names)}"
    raise InputError(f"{path}: no column {column!r}; there are {there}")


def _times(column: FloatArray, columns: ColumnMap) -> tuple[IntArray, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Time of each row that has one [ns], and which these are."""
    unit_ns = columns.time_ns if columns.time_column is not None else NS_PER_S
    known = np.isfinite(column) & (np.abs(column) * unit_ns < LATEST_NS)
    since = column[known][0] if known.any() else 0.0
    start_ns = round(float(since) * unit_ns)
    return start_ns + np.round((column[known] - since) * unit_ns).astype(np.int64), known


def _series(one: SignalColumns, t_ns: IntArray, values: FloatArray) -> Series:
    """The rows in which the signal is known."""
    known = np.isfinite(values).all(axis=1)
    return recorded(one.signal, t_ns[known], values[known])


KIND = LogKind(
    "CSV with a column map",
    lambda head: False,
    lambda path, vehicle, profile: _refused(path),
    PROFILE,
    GATE,
)


def _refused(path: Path) -> Log:
    raise InputError(f"{path}: a CSV file needs its column map; give --columns MAP.toml")
