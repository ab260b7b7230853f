"""Answers as a table, for a spreadsheet or a data frame: one row a log, or one a window; CSV and Parquet (edge)."""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from mavdiag.archive.figures import Window, WindowMonitor
from mavdiag.archive.scan import Answer
from mavdiag.decision.diagnosis import Stage, graded
from mavdiag.judging import LogVerdict
from mavdiag.monitors import MONITORS
from mavdiag.storage import write_atomically
from mavdiag.units import NS_PER_S

Value: TypeAlias = str | float | int | None
Row: TypeAlias = Mapping[str, Value]  # by the names of columns; what is not known may be left out

_TEXTS = ("log", "sha256", "verdict", "log_verdict", "reason", "kind", "rotors", "fault_type", "monitor", "profile")
_NAMES = (
    *("log", "sha256", "from_s", "to_s", "verdict", "log_verdict", "reason", "kind", "since_s", "rotor", "rotors"),
    *("fault_type", "severity", "confidence", "alarms", "judged_s", "ratio", "monitor", "flown_s", "profile"),
    *("rate_hz", *(f"{monitor.name}_{figure}" for monitor in MONITORS for figure in ("judged_s", "ratio"))),
)
#: The columns and their types; those that a window has no figure of its own for are of its log.
COLUMNS: dict[str, type[str] | type[float] | type[int]] = {
    name: str if name in _TEXTS else int if name in ("rotor", "severity", "alarms") else float for name in _NAMES
}


def rows_of(answer: Answer) -> Iterator[Row]:
    """The rows of a log, by COLUMNS: one for each of its windows, or one where it has none."""
    verdict, typed = answer.verdict, graded(answer.verdict.changes)
    faults = [change for change in verdict.changes if change.stage is Stage.FAULT and change.kind is verdict.kind]
    spans = [
        f"{span.rotor} from {span.since_ns / NS_PER_S:.1f} s"
        + ("" if span.end_ns is None else f" to {span.end_ns / NS_PER_S:.1f} s")
        for span in verdict.rotors
    ]
    of_log = {
        **{name: getattr(verdict, name) for name in ("log", "reason", "kind", "since_s", "rotor")},
        **{name: getattr(typed, name, None) for name in ("fault_type", "severity")},
        "sha256": answer.record.digest or None,
        "log_verdict": str(verdict.verdict),
        "rotors": "; ".join(spans) or None,
        "confidence": next((one.confidence for one in reversed(faults) if one.confidence is not None), None),
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
        yield told


def _whole(verdict: LogVerdict) -> Window:
    ratios = {one.name: None if one.maximum is None else one.maximum / one.threshold for one in verdict.monitors}
    known = ((ratios[one.name], one.name) for one in verdict.monitors if one.decides)
    highest, whose = max(((ratio, name) for ratio, name in known if ratio is not None), default=(None, None))
    monitors = tuple(WindowMonitor(one.name, one.judged_s, ratios[one.name]) for one in verdict.monitors)
    return Window(0.0, 0.0, verdict.verdict, verdict.flown_s, verdict.judged_s, highest, whose, monitors)


def write_csv(path: Path, rows: Iterable[Row]) -> None:
    """Write rows with a head. What is not known is an empty field. Raises UsageError if it cannot be written."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(COLUMNS), extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode(errors="surrogateescape"))


def write_parquet(path: Path, rows: Sequence[Row]) -> None:
    """Write rows with the types of the columns; what is not known is null. Raises UsageError if it cannot be.

    Parquet has only text: of the name of a file that is no UTF-8 the bytes become escapes.
    """
    import pyarrow
    from pyarrow.parquet import write_table

    def text(value: Value) -> Value:
        raw = value.encode(errors="surrogateescape") if isinstance(value, str) else None
        return value if raw is None else raw.decode(errors="backslashreplace")

    types = {str: pyarrow.string(), float: pyarrow.float64(), int: pyarrow.int64()}
    schema = pyarrow.schema([(name, types[kind]) for name, kind in COLUMNS.items()])
    table = [{name: text(row.get(name)) for name in COLUMNS} for row in rows]
    buffer = io.BytesIO()
    write_table(pyarrow.Table.from_pylist(table, schema=schema), buffer)
    write_atomically(path, buffer.getvalue())
