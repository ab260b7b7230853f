"""Answers as a table, for a spreadsheet or a data frame: one row a log, or one a window; CSV and Parquet (edge)."""

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TypeAlias

from mavdiag.archive.job import Answer
from mavdiag.archive.windows import Window
from mavdiag.decision.alarm import Change, Stage
from mavdiag.errors import missing_extra
from mavdiag.judging import LogVerdict, MonitorSummary
from mavdiag.monitors import MONITORS
from mavdiag.storage import write_atomically

__all__ = ["COLUMNS", "Column", "check_parquet", "rows_of", "write_csv", "write_parquet"]

Value: TypeAlias = str | float | int | None


@dataclass(frozen=True, slots=True)
class Column:
    """A column. kind: str, float or int. value: of a log, or of one of its windows."""

    name: str
    kind: type[str] | type[float] | type[int]
    value: Callable[[Answer, Window | None], Value]


def rows_of(answer: Answer) -> tuple[tuple[Value, ...], ...]:
    """The rows of a log, by COLUMNS: one for each of its windows, or one where it has none."""
    return tuple(tuple(column.value(answer, part) for column in COLUMNS) for part in answer.record.windows or (None,))


def write_csv(path: Path, rows: Sequence[Sequence[Value]]) -> None:
    """Write rows with a head. What is not known is an empty field. Raises UsageError if it cannot be written."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([column.name for column in COLUMNS])
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode(errors="surrogateescape"))


def check_parquet() -> None:
    """Raise UsageError, saying what to install, if Parquet cannot be written."""
    if find_spec("pyarrow") is None:
        raise missing_extra("--parquet", "pyarrow", "fleet")


def write_parquet(path: Path, rows: Sequence[Sequence[Value]]) -> None:
    """Write rows with the types of the columns; what is not known is null. Raises UsageError if it cannot be."""
    check_parquet()
    import pyarrow
    from pyarrow.parquet import write_table

    types = {str: pyarrow.string(), float: pyarrow.float64(), int: pyarrow.int64()}
    schema = pyarrow.schema([(column.name, types[column.kind]) for column in COLUMNS])
    columns = [[_printed(row[i]) for row in rows] for i in range(len(COLUMNS))]
    buffer = io.BytesIO()
    write_table(
        pyarrow.Table.from_arrays(
            [pyarrow.array(c, t) for c, t in zip(columns, schema.types, strict=True)], schema=schema
        ),
        buffer,
    )
    write_atomically(path, buffer.getvalue())


def _printed(value: Value) -> Value:
    """A name of a file that is no UTF-8 with its bytes as escapes: Parquet has only text."""
    return value.encode(errors="surrogateescape").decode(errors="backslashreplace") if isinstance(value, str) else value


def _verdict(answer: Answer, part: Window | None) -> Value:
    return str(answer.record.verdict.verdict if part is None else part.verdict)


def _nearest(answer: Answer) -> MonitorSummary | None:
    """The deciding monitor that came nearest to its threshold."""
    judged = [one for one in answer.record.verdict.monitors if one.decides and one.maximum is not None]
    return max(judged, key=lambda one: _ratio(one) or 0.0, default=None)


def _ratio(one: MonitorSummary | None) -> float | None:
    return None if one is None or one.maximum is None else one.maximum / one.threshold


def _ratio_of(answer: Answer, part: Window | None) -> Value:
    return _ratio(_nearest(answer)) if part is None else part.ratio


def _whose(answer: Answer, part: Window | None) -> Value:
    if part is not None:
        return part.monitor
    nearest = _nearest(answer)
    return None if nearest is None else nearest.name


def _faults(verdict: LogVerdict) -> list[Change]:
    """The changes to the gravest kind of fault."""
    return [one for one in verdict.changes if one.stage is Stage.FAULT and one.kind is verdict.kind]


def _rotors(verdict: LogVerdict) -> str | None:
    """Every rotor that was named, with its span: "1 from 98.7 s to 228.0 s; 2 from 228.0 s"."""
    ends = ("" if one.end_s is None else f" to {one.end_s:.1f} s" for one in verdict.rotors)
    told = (f"{one.rotor} from {one.since_s:.1f} s{end}" for one, end in zip(verdict.rotors, ends, strict=True))
    return "; ".join(told) or None


def _last(name: str) -> Callable[[Answer, Window | None], Value]:
    """What was last known of the fault: a field of `Change`."""

    def value(answer: Answer, part: Window | None) -> Value:
        known = [getattr(one, name) for one in _faults(answer.record.verdict)]
        found: Value = next((one for one in reversed(known) if one is not None), None)
        return found

    return value


def _monitor_columns(name: str) -> tuple[Column, ...]:
    """What a monitor did: in the window, if the row is of one."""

    def summary(answer: Answer) -> MonitorSummary | None:
        return next((one for one in answer.record.verdict.monitors if one.name == name), None)

    def judged(answer: Answer, part: Window | None) -> Value:
        if part is not None:
            return next((one.judged_s for one in part.monitors if one.name == name), None)
        one = summary(answer)
        return None if one is None else one.judged_s

    def ratio(answer: Answer, part: Window | None) -> Value:
        if part is not None:
            return next((one.ratio for one in part.monitors if one.name == name), None)
        return _ratio(summary(answer))

    return Column(f"{name}_judged_s", float, judged), Column(f"{name}_ratio", float, ratio)


COLUMNS: tuple[Column, ...] = (
    Column("log", str, lambda answer, part: str(answer.path)),
    Column("sha256", str, lambda answer, part: answer.record.digest or None),
    Column("from_s", float, lambda answer, part: None if part is None else part.from_s),
    Column("to_s", float, lambda answer, part: None if part is None else part.to_s),
    Column("verdict", str, _verdict),
    Column("log_verdict", str, lambda answer, part: str(answer.record.verdict.verdict)),
    Column("reason", str, lambda answer, part: answer.record.verdict.reason),
    Column("kind", str, lambda answer, part: answer.record.verdict.kind),
    Column("since_s", float, lambda answer, part: answer.record.verdict.since_s),
    Column("rotor", int, lambda answer, part: answer.record.verdict.rotor),
    Column("rotors", str, lambda answer, part: _rotors(answer.record.verdict)),
    Column("fault_type", str, _last("fault_type")),
    Column("severity", int, _last("severity")),
    Column("confidence", float, _last("confidence")),
    Column("alarms", int, lambda answer, part: len(answer.record.verdict.events)),
    Column("judged_s", float, lambda answer, part: (answer.record.verdict if part is None else part).judged_s),
    Column("ratio", float, _ratio_of),
    Column("monitor", str, _whose),
    Column("flown_s", float, lambda answer, part: (answer.record.verdict if part is None else part).flown_s),
    Column("profile", str, lambda answer, part: answer.record.verdict.profile or None),
    Column("rate_hz", float, lambda answer, part: answer.record.verdict.rate_hz or None),
    *(column for monitor in MONITORS for column in _monitor_columns(monitor.name)),
)
"""All columns; those that a window has no figure of its own for are of its log."""
