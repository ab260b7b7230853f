"""CSV recordings, whatever wrote them: a column map, a TOML file, says which column is which signal, in which unit.

[time]
column = "timestamp"          # a name of the header, or a number from 1 where there is none
unit = "us"                   # s, ms, us or ns; "rate_hz = 200" in place of both where no column has the time

[body_rate]                   # a name of `telemetry.Signal`; body_rate is needed
columns = ["gyro_x", "-gyro_y", "-gyro_z"]   # FRD: forward, right, down; a minus turns the direction
unit = "deg/s"

[specific_force]
columns = ["acc_x", "-acc_y", "-acc_z"]      # (0, 0, -9.81) at rest in FRD
unit = "g"

[file]                        # may be left out
delimiter = ","
skip_lines = 0                # before the header
header = true

No CSV file is recognised by its content; it takes the map.
"""

import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mavdiag.errors import InputError
from mavdiag.logs.log import LogKind, read_bytes, sha256_of
from mavdiag.logs.records import recorded
from mavdiag.rows.gate import GateSpec
from mavdiag.storage import TOML_BYTES, parse_toml, read_text, read_toml
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Log, Signal, Telemetry
from mavdiag.units import DEG, NS_PER_MS, NS_PER_S, NS_PER_US, RPM, G

PROFILE = "csv"
GATE = GateSpec(min_thrust=0.1, need_armed=True, trim_start_s=1.0, trim_end_s=0.6)  # as far as the columns tell
LATEST_NS = 2**62
_line_end = re.compile(rb"[\r\n]").search
LINE_BYTES = 64 << 10  # of a line, at most (our choice): a thousand columns have a quarter of it
DAMAGED_SHARE = 0.5  # of the rows: beyond it the map is wrong (our choice)

SUFFIXES = (".csv", ".tsv", ".txt")
TIME_NS: Mapping[str, int] = MappingProxyType({"s": NS_PER_S, "ms": NS_PER_MS, "us": NS_PER_US, "ns": 1})
_ANGLES, _RATES = {"rad": 1.0, "deg": DEG}, {"rad/s": 1.0, "deg/s": DEG, "mrad/s": 1e-3}
_FORCES = {"m/s^2": 1.0, "g": G, "mg": 1e-3 * G}
_SHARES = {"": 1.0, "percent": 0.01, "per mille": 1e-3}
_UNITS: Mapping[Signal, Mapping[str, float]] = MappingProxyType(
    {
        Signal.ATTITUDE_SETPOINT: _ANGLES,
        Signal.ATTITUDE: _ANGLES,
        Signal.RATE_SETPOINT: _RATES,
        Signal.BODY_RATE: _RATES,
        Signal.SPECIFIC_FORCE: _FORCES,
        Signal.VIBRATION: _FORCES,
        Signal.THRUST_SETPOINT: _SHARES,
        Signal.TORQUE_COMMAND: _SHARES,
        Signal.ACTUATOR: _SHARES,
        Signal.ARMED: {"": 1.0},
        Signal.ROTOR_SPEED: {"rad/s": 1.0, "rpm": RPM, "Hz": 60 * RPM},
        Signal.HEIGHT: {"m": 1.0},
        Signal.VOLTAGE: {"V": 1.0, "mV": 1e-3},
    }
)
_WIDTHS = {
    **dict.fromkeys((Signal.THRUST_SETPOINT, Signal.HEIGHT, Signal.VOLTAGE, Signal.ARMED), 1),
    **dict.fromkeys((Signal.ACTUATOR, Signal.ROTOR_SPEED), None),
}

Column: TypeAlias = Annotated[str, Field(min_length=1, max_length=200)]


@dataclass(frozen=True, slots=True)
class SignalColumns:
    """One signal. columns: as in the file, without their sign. factors: to SI and FRD, one a column."""

    signal: Signal
    columns: tuple[str, ...]
    factors: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class ColumnMap:
    """How a CSV file is read.

    time_column: None where the rows come at `rate_hz`.
    time_ns: one unit of the time column [ns].
    """

    signals: tuple[SignalColumns, ...]
    time_column: str | None
    time_ns: int = NS_PER_S
    rate_hz: float = 0.0
    delimiter: str = ","
    skip_lines: int = 0
    header: bool = True


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Time(_Part):
    column: Column | None = None
    unit: str = "s"
    rate_hz: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] | None = None


class _File(_Part):
    delimiter: Annotated[str, Field(min_length=1, max_length=1)] = ","
    skip_lines: Annotated[int, Field(ge=0, le=1000)] = 0
    header: bool = True


class _Columns(_Part):
    columns: Annotated[tuple[Column, ...], Field(min_length=1, max_length=16)]
    unit: str = ""


def load_column_map(path: Path) -> ColumnMap:
    """A column map from its file. Raises InputError, naming file and field."""
    return _map(str(path), read_toml(path))


def column_map_text(path: Path) -> str:
    """The text of a column map that can be used. Raises InputError, naming file and field."""
    load_column_map(path)
    return read_text(path, TOML_BYTES)


def is_csv(path: Path) -> bool:
    """Whether a file of a folder may be such a recording, by its name: its content does not tell."""
    return path.suffix.lower() in SUFFIXES


def parse_column_map(text: str) -> ColumnMap:
    """A column map from the text of its file. Raises InputError, naming the field.

    >>> parse_column_map('[time]\\nrate_hz = 100\\n[body_rate]\\ncolumns = ["p", "-q", "r"]\\nunit = "rad/s"').signals
    (SignalColumns(signal=<Signal.BODY_RATE: 'body_rate'>, columns=('p', 'q', 'r'), factors=(1.0, -1.0, 1.0)),)
    """
    return _map("column map", parse_toml(text, "column map"))


def _map(name: str, content: Mapping[str, object]) -> ColumnMap:
    known = {"time", "file", *(signal.value for signal in Signal)}
    unknown = sorted(set(content) - known)
    if unknown:
        raise InputError(f"{name}: {unknown[0]}: no such table; there are time, file, {', '.join(Signal)}")
    try:
        time, file = _Time.model_validate(content.get("time", {})), _File.model_validate(content.get("file", {}))
        parts = {s: _Columns.model_validate(content[s.value]) for s in Signal if s.value in content}
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{name}: {place}: {first['msg'][0].lower()}{first['msg'][1:]}") from error
    if (time.column is None) == (time.rate_hz is None):
        raise InputError(f"{name}: time: give the column of the time, or rate_hz")
    if time.unit not in TIME_NS:
        raise InputError(f"{name}: time.unit: {time.unit!r} is none of {', '.join(TIME_NS)}")
    if Signal.BODY_RATE not in parts:
        raise InputError(f"{name}: body_rate is missing; nothing works without the gyro")
    signals = tuple(_signal(name, signal, part) for signal, part in parts.items())
    rate_hz = time.rate_hz or 0.0
    return ColumnMap(signals, time.column, TIME_NS[time.unit], rate_hz, file.delimiter, file.skip_lines, file.header)


def _signal(name: str, signal: Signal, part: _Columns) -> SignalColumns:
    units, width = _UNITS[signal], _WIDTHS.get(signal, 3)
    if part.unit not in units:
        there = ", ".join(map(repr, units))
        raise InputError(f"{name}: {signal}.unit: {part.unit!r} is none of {there}")
    if width is not None and len(part.columns) != width:
        raise InputError(f"{name}: {signal}.columns: it has {width} columns, not {len(part.columns)}")
    turned = [column.startswith("-") for column in part.columns]
    columns = tuple(column.removeprefix("-") for column in part.columns)
    factors = tuple(-units[part.unit] if minus else units[part.unit] for minus in turned)
    return SignalColumns(signal, columns, factors)


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
    series, first = {}, 1
    for mapped in columns.signals:
        values = table[known, first : first + len(mapped.columns)] * np.array(mapped.factors)
        first += len(mapped.columns)
        sound = np.isfinite(values).all(axis=1)
        if sound.any():
            series[mapped.signal] = recorded(mapped.signal, t_ns[sound], values[sound])
    left_out = len(table) - (len(series[Signal.BODY_RATE]) if Signal.BODY_RATE in series else 0)
    if left_out > (1 - DAMAGED_SHARE) * len(table):
        raise InputError(f"{path}: most rows have no gyro; check the column map")
    notes = (f"{left_out} of {len(table)} rows have no time or no gyro and were left out",) if left_out else ()
    return Log(path.name, sha256_of(data), PROFILE, Telemetry(tuple(series.values())), notes=notes, motor_order=True)


def _table(path: Path, text: str, columns: ColumnMap) -> FloatArray:
    """Time and the mapped columns in their order, (n, 1 + k); NaN for what is no number."""
    head, _, rest = text.partition("\n")
    names = [cell.strip() for cell in next(csv.reader([head], delimiter=columns.delimiter), [])]
    wanted = [] if columns.time_column is None else [columns.time_column]
    wanted += [column for mapped in columns.signals for column in mapped.columns]
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


def _times(column: FloatArray, columns: ColumnMap) -> tuple[IntArray, BoolArray]:
    """Time of each row that has one [ns], and which these are."""
    unit_ns = columns.time_ns if columns.time_column is not None else NS_PER_S
    known = np.isfinite(column) & (np.abs(column) * unit_ns < LATEST_NS)
    since = column[known][0] if known.any() else 0.0
    start_ns = round(float(since) * unit_ns)
    return start_ns + np.round((column[known] - since) * unit_ns).astype(np.int64), known


def _refused(path: Path) -> Log:
    raise InputError(f"{path}: a CSV file needs its column map; give --columns MAP.toml")


KIND = LogKind(
    "CSV with a column map", lambda head: False, lambda path, vehicle, profile: _refused(path), PROFILE, GATE
)
