"""Answers as a table, for a spreadsheet or a data frame: one row a log, or one a window; CSV and Parquet (edge)."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TypeAlias

from mavdiag.archive.job import Answer
from mavdiag.archive.windows import Window, WindowMonitor
from mavdiag.decision.alarm import Stage
from mavdiag.errors import missing_extra
from mavdiag.judging import LogVerdict
from mavdiag.monitors import MONITORS
from mavdiag.storage import write_atomically

Value: TypeAlias = str | float | int | None
Row: TypeAlias = tuple[Value, ...]

#: The columns and their types; those that a window has no figure of its own for are of its log.
COLUMNS: dict[str, type[str] | type[float] | type[int]] = {
    "log": str,
    "sha256": str,
    "from_s": float,
    "to_s": float,
    "verdict": str,
    "log_verdict": str,
    "reason": str,
    "kind": str,
    "since_s": float,
    "rotor": int,
    "rotors": str,
    "fault_type": str,
    "severity": int,
    "confidence": float,
    "alarms": int,
    "judged_s": float,
    "ratio": float,
    "monitor": str,
    "flown_s": float,
    "profile": str,
    "rate_hz": float,
    **{f"{monitor.name}_{figure}": float for monitor in MONITORS for figure in ("judged_s", "ratio")},
}


def rows_of(answer: Answer) -> Iterator[Row]:
    """The rows of a log, by COLUMNS: one for each of its windows, or one where it has none."""
    verdict = answer.verdict
    faults = [change for change in verdict.changes if change.stage is Stage.FAULT and change.kind is verdict.kind]
    of_log = {
        "log": verdict.log,
        "sha256": answer.record.digest or None,
        "log_verdict": str(verdict.verdict),
        "reason": verdict.reason,
        "kind": verdict.kind,
        "since_s": verdict.since_s,
        "rotor": verdict.rotor,
        "rotors": _rotors(verdict),
        "fault_type": _last(change.fault_type for change in faults),
        "severity": _last(change.severity for change in faults),
        "confidence": _last(change.confidence for change in faults),
        "alarms": len(verdict.events),
        "profile": verdict.profile or None,
        "rate_hz": verdict.rate_hz or None,
    }
    for part in answer.record.windows or (_whole(verdict),):
        span = {"from_s": part.from_s, "to_s": part.to_s} if answer.record.windows else {}
        told: dict[str, Value] = {**of_log, **span, "verdict": str(part.verdict), "ratio": part.ratio}
        told |= {"monitor": part.monitor, "judged_s": part.judged_s, "flown_s": part.flown_s}
        for monitor in part.monitors:
            told |= {f"{monitor.name}_judged_s": monitor.judged_s, f"{monitor.name}_ratio": monitor.ratio}
        yield tuple(told.get(name) for name in COLUMNS)


def write_csv(path: Path, rows: Iterable[Row], columns: Iterable[str] = COLUMNS) -> None:
    """Write rows with a head. What is not known is an empty field. Raises UsageError if it cannot be written."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode(errors="surrogateescape"))


def check_parquet() -> None:
    """Raise UsageError, saying what to install, if Parquet cannot be written."""
    if find_spec("pyarrow") is None:
        raise missing_extra("--parquet", "pyarrow", "fleet")


def write_parquet(path: Path, rows: Sequence[Row]) -> None:
    """Write rows with the types of the columns; what is not known is null. Raises UsageError if it cannot be."""
    check_parquet()
    import pyarrow
    from pyarrow.parquet import write_table

    types = {str: pyarrow.string(), float: pyarrow.float64(), int: pyarrow.int64()}
    schema = pyarrow.schema([(name, types[kind]) for name, kind in COLUMNS.items()])
    table = [dict(zip(COLUMNS, map(_printed, row), strict=True)) for row in rows]
    buffer = io.BytesIO()
    write_table(pyarrow.Table.from_pylist(table, schema=schema), buffer)
    write_atomically(path, buffer.getvalue())


def _printed(value: Value) -> Value:
    """A name of a file that is no UTF-8 with its bytes as escapes: Parquet has only text."""
    return value.encode(errors="surrogateescape").decode(errors="backslashreplace") if isinstance(value, str) else value


def _whole(verdict: LogVerdict) -> Window:
    """A log as one window."""
    ratios = {one.name: None if one.maximum is None else one.maximum / one.threshold for one in verdict.monitors}
    deciding = [
        (ratio, one.name) for one in verdict.monitors if one.decides and (ratio := ratios[one.name]) is not None
    ]
    highest, whose = max(deciding, default=(None, None))
    monitors = tuple(WindowMonitor(one.name, one.judged_s, ratios[one.name]) for one in verdict.monitors)
    return Window(0.0, 0.0, verdict.verdict, verdict.flown_s, verdict.judged_s, highest, whose, monitors)


def _rotors(verdict: LogVerdict) -> str | None:
    """Every rotor that was named, with its span: "1 from 98.7 s to 228.0 s; 2 from 228.0 s"."""
    ends = ("" if span.end_s is None else f" to {span.end_s:.1f} s" for span in verdict.rotors)
    told = (f"{span.rotor} from {span.since_s:.1f} s{end}" for span, end in zip(verdict.rotors, ends, strict=True))
    return "; ".join(told) or None


def _last(values: Iterable[Value]) -> Value:
    known = [value for value in values if value is not None]
    return known[-1] if known else None
