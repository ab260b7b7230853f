"""CSV recordings, whatever wrote them: a column map, a TOML file, says which column is which signal, in which unit.

It has a table for each signal (columns, with a minus where one turns the other way in FRD, and unit), one for the time
(column and unit, or rate_hz), and maybe one for the file. No CSV file is recognised by its content; it takes the map.
"""

import csv
import hashlib
import io
import math
import re
from collections.abc import Mapping, Sequence
from itertools import compress
from pathlib import Path
from typing import Annotated, Literal, Self, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from mavdiag.errors import InputError
from mavdiag.logs.log import LogKind, read_bytes, recorded
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.grid import LEAST_SAMPLES
from mavdiag.storage import read_toml
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Log, Signal, Telemetry
from mavdiag.units import DEG, NS_PER_MS, NS_PER_S, NS_PER_US, RPM, G

PROFILE = "csv"
GATE = GateSpec(min_thrust=0.1, need_armed=True, trim_start_s=1.0, trim_end_s=0.6)  # as far as the columns tell
LATEST_NS = 2**62
TURN = 2.0**32  # of a counter of 32 bits
_line_end = re.compile(rb"[\r\n]").search
LINE_BYTES = 64 << 10  # of a line, at most (our choice): a thousand columns have a quarter of it
DAMAGED_SHARE = 0.5  # of the rows: beyond it the map is wrong (our choice)
STEPS_S = (1e-5, 1.0)  # between rows; others are of another unit than the map says (our choice)
_decimal_comma = re.compile(r"\s*[+-]?\d+,\d+\s*").fullmatch

_TIME_NS = {"s": NS_PER_S, "ms": NS_PER_MS, "us": NS_PER_US, "ns": 1}
#: By the SI unit of a signal, what a column may be in instead.
_UNITS: Mapping[str, Mapping[str, float]] = {
    "rad": {"rad": 1.0, "deg": DEG},
    "rad/s": {"rad/s": 1.0, "deg/s": DEG, "mrad/s": 1e-3, "rpm": RPM, "Hz": 60 * RPM},
    "m/s^2": {"m/s^2": 1.0, "g": G, "mg": 1e-3 * G},
    "m": {"m": 1.0},
    "V": {"V": 1.0, "mV": 1e-3},
    "": {"": 1.0, "percent": 0.01, "per mille": 1e-3},
}

Column: TypeAlias = Annotated[str, Field(min_length=1, max_length=200)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Time(_Part):
    column: Column | None = None
    unit: Literal["s", "ms", "us", "ns"] = "s"
    rate_hz: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] | None = None


class _File(_Part):
    delimiter: Annotated[str, Field(min_length=1, max_length=1)] = ","
    skip_lines: Annotated[int, Field(ge=0, le=1000)] = 0
    header: bool = True


class _Columns(_Part):
    columns: Annotated[tuple[Column, ...], Field(min_length=1, max_length=16)]
    unit: str = ""


class ColumnMap(_Part):
    """How a CSV file is read: its tables, those of signals as one."""

    time: _Time = _Time()
    file: _File = _File()
    signals: Mapping[Signal, _Columns]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.time.column is None) == (self.time.rate_hz is None):
            raise ValueError("time: give the column of the time, or rate_hz")
        if Signal.BODY_RATE not in self.signals:
            raise ValueError("body_rate is missing; nothing works without the gyro")
        for signal, part in self.signals.items():
            width, units = signal.width, _UNITS[signal.unit]
            if part.unit not in units:
                raise ValueError(f"{signal}.unit: {part.unit!r} is none of {', '.join(map(repr, units))}")
            if width is not None and len(part.columns) != width:
                raise ValueError(f"{signal}.columns: it has {width} columns, not {len(part.columns)}")
        return self


def is_csv(path: Path) -> bool:
    """Whether a file of a folder may be such a recording, by its name: its content does not tell."""
    return path.suffix.lower() in (".csv", ".tsv", ".txt")


def load_column_map(path: Path) -> ColumnMap:
    """A column map from its file. Raises InputError, naming file and field."""
    content = read_toml(path)
    tables = {key: content[key] for key in ("time", "file") if key in content}
    signals = {signal: content[signal] for signal in Signal if signal in content}
    if unknown := sorted(set(content) - set(tables) - set(signals)):
        raise InputError(f"{path}: {unknown[0]}: no such table; there are time, file, {', '.join(Signal)}")
    try:
        return ColumnMap.model_validate({**tables, "signals": signals})
    except ValidationError as error:
        first = error.errors()[0]
        place = "".join(f"{part}: " for part in first["loc"] if part != "signals")
        words = first["msg"].removeprefix("Value error, ")
        raise InputError(f"{path}: {place}{words[0].lower()}{words[1:]}") from error


def read_csv(path: Path, columns: ColumnMap) -> Log:
    """A recording as a log of the profile "csv". A cell that is no number is unknown; a row without a time is left out.
    Rows that are newest first are read from the last one on.

    Times are the vehicle's and start where the column does. Raises InputError if the file cannot be read, a column is
    not there, or most rows have no time or no gyro.
    """
    data = read_bytes(path)
    if any(_line_end(data, at, at + LINE_BYTES) is None for at in range(0, len(data) - LINE_BYTES + 1, LINE_BYTES)):
        raise InputError(f"{path}: a line has over {LINE_BYTES // 1024} KiB: it is no CSV file, or damaged")
    if b"\0" in data[:LINE_BYTES].split(b"\n", 1)[0]:
        raise InputError(f"{path}: is no CSV text in UTF-8; save it as such, or leave out --columns for a flight log")
    text = data.decode("utf-8-sig", errors="replace")
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    lines = text.split("\n", columns.file.skip_lines)[-1]
    try:
        table = _table(path, lines, columns)
    except csv.Error as error:
        raise InputError(f"{path}: is no sound CSV file ({error}); save it again") from error
    steps = np.diff(table[np.isfinite(table[:, 0]), 0])
    newest_first = 2 * np.count_nonzero(steps < 0) > len(steps)
    table = table[::-1] if newest_first else table
    t_ns, known = _times(table[:, 0], columns)
    if not len(t_ns):
        raise InputError(f"{path}: no row has a time; check the column map")
    step_s = float(np.median(np.diff(t_ns))) / NS_PER_S if len(t_ns) >= LEAST_SAMPLES else 0.01
    if step_s > 0 and not STEPS_S[0] <= step_s <= STEPS_S[1]:
        raise InputError(f"{path}: by the column map its rows are {step_s:.3g} s apart; check the unit of the time")
    series, first = {}, 1
    for signal, part in columns.signals.items():
        signs = np.array([-1.0 if column.startswith("-") else 1.0 for column in part.columns])
        values = table[known, first : first + len(part.columns)] * (signs * _UNITS[signal.unit][part.unit])
        first += len(part.columns)
        sound = np.isfinite(values).all(axis=1)
        if sound.any():
            series[signal] = recorded(signal, t_ns[sound], values[sound])
    left_out = len(table) - (len(series[Signal.BODY_RATE]) if Signal.BODY_RATE in series else 0)
    if left_out > (1 - DAMAGED_SHARE) * len(table):
        raise InputError(f"{path}: most rows have no gyro; check the column map")
    lost = f"{left_out} of {len(table)} rows have no sound time or no gyro and were left out"
    order = "its rows are newest first and were read in order of time"
    notes = tuple(compress((lost, order), (left_out, newest_first)))
    digest = hashlib.sha256(data).hexdigest()
    return Log(path.name, digest, PROFILE, Telemetry(tuple(series.values())), notes=notes, motor_order=True)


def _table(path: Path, text: str, columns: ColumnMap) -> FloatArray:
    """Time and the mapped columns in their order, (n, 1 + k); NaN for what is no number."""
    head, _, rest = text.partition("\n")
    delimiter, header = columns.file.delimiter, columns.file.header
    there = [cell.strip() for cell in next(csv.reader([head], delimiter=delimiter), [])]
    wanted = [] if columns.time.column is None else [columns.time.column]
    wanted += [name.removeprefix("-") for part in columns.signals.values() for name in part.columns]
    places = [_place(path, name, there, header=header) for name in wanted]
    body = rest if header else text
    if not body.strip():
        raise InputError(f"{path}: it has no rows; check skip_lines and header of the column map")
    cells = next(csv.reader([body.partition("\n")[0]], delimiter=delimiter), [])
    if any(map(_decimal_comma, cells)) or (delimiter == "," and sum(map(bool, cells)) >= 2 * len(there)):
        raise InputError(f"{path}: its numbers have a decimal comma; write them with a point")
    try:
        found = np.loadtxt(io.StringIO(body), delimiter=delimiter, usecols=places, ndmin=2, comments=None)
    except ValueError:
        rows = [row for row in csv.reader(io.StringIO(body, newline=""), delimiter=delimiter) if row]
        found = np.array([[_number(row, place) for place in places] for row in rows]).reshape(-1, len(places))
    if columns.time.rate_hz is not None:
        return np.column_stack([np.arange(len(found)) / columns.time.rate_hz, found])
    return np.asarray(found, dtype=np.float64)


def _number(row: Sequence[str], place: int) -> float:
    try:
        return float(row[place])
    except (ValueError, IndexError):
        return math.nan


def _place(path: Path, column: str, names: Sequence[str], *, header: bool) -> int:
    """Number from 0 of a column. Raises InputError if there is none."""
    if header and column in names:
        return names.index(column)
    if not header and column.isdecimal() and 1 <= int(column) <= len(names):
        return int(column) - 1
    there = ", ".join(names[:20]) if header else f"1 to {len(names)}"
    raise InputError(f"{path}: no column {column!r}; there are {there}")


def _times(column: FloatArray, columns: ColumnMap) -> tuple[IntArray, BoolArray]:
    """Time of each row that has one [ns], and which these are."""
    unit_ns = _TIME_NS[columns.time.unit] if columns.time.rate_hz is None else NS_PER_S
    known = np.abs(column) < LATEST_NS / unit_ns
    counts = column[known]
    if unit_ns < NS_PER_S and counts.max(initial=0.0) < TURN:  # a counter of 32 bits begins anew
        counts = counts + TURN * np.cumsum(np.diff(counts, prepend=counts[:1]) < -TURN / 2)
    since = counts[0] if len(counts) else 0.0
    start_ns = round(float(since) * unit_ns)
    return start_ns + np.round((counts - since) * unit_ns).astype(np.int64), known


def _refused(path: Path) -> Log:
    raise InputError(f"{path}: a CSV file needs its column map; give --columns MAP.toml")


KIND = LogKind(
    "CSV with --columns MAP.toml where a command has it",
    lambda head: False,
    lambda path, *_: _refused(path),
    (PROFILE,),
    GATE,
)
