"""The column map of a CSV recording: which columns are which signal, in which unit and direction; a TOML file.

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
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mavdiag.errors import InputError
from mavdiag.storage import TOML_BYTES, parse_toml, read_text, read_toml
from mavdiag.telemetry import Signal
from mavdiag.units import DEG, NS_PER_MS, NS_PER_S, NS_PER_US, RPM, G

__all__ = ["ColumnMap", "SignalColumns", "column_map_text", "is_csv", "load_column_map", "parse_column_map"]

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
        there = ", ".join(repr(one) for one in units)
        raise InputError(f"{name}: {signal}.unit: {part.unit!r} is none of {there}")
    if width is not None and len(part.columns) != width:
        raise InputError(f"{name}: {signal}.columns: it has {width} columns, not {len(part.columns)}")
    turned = [column.startswith("-") for column in part.columns]
    columns = tuple(column.removeprefix("-") for column in part.columns)
    factors = tuple(-units[part.unit] if one else units[part.unit] for one in turned)
    return SignalColumns(signal, columns, factors)
