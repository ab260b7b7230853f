"""The journal and the recorder (edge): files that grow while the daemon runs. A full disk stops nothing else.

The journal has one JSON object a line:
kind       besides "utc" (when written), "vehicle" (system id) and "vehicle_s" (the vehicle's clock, if known)
event      an alarm of one monitor, whole; the fields of the public contract, its start in vehicle time and UTC
opened     the same at its beginning, with the figures of that moment and end_s null
state      from, to, reason          text        severity, text            suppressed   text, count
stage      the decision: stage, reason, and the evidence that it rests on
baseline   digest, airframe, layout  note        text                      start, stop  of the daemon
"""

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import BinaryIO

from detector.values import EventClosed, EventOpened, Note, Record, SendText, StateChanged, TextSuppressed
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import Change, Event
from mavdiag.errors import UsageError
from mavdiag.logs.tlog import tlog_record
from mavdiag.report import event_json
from mavdiag.units import NS_PER_S, NS_PER_US

__all__ = ["Journal", "Recorder", "When", "line", "mark"]

FRAME_BYTES = 8  # the shortest MAVLink frame; what is shorter is no frame


@dataclass(frozen=True, slots=True)
class When:
    """The time of a line: the wall clock, and the vehicle's, None if it is not known. vehicle: system id."""

    utc: datetime
    vehicle: int | None = None
    vehicle_ns: int | None = None


def line(record: Record, when: When) -> str:
    """One line of the journal, without its newline."""
    return _line(when, *_content(record, when))


def mark(kind: str, when: When, content: dict[str, object]) -> str:
    """A line about the daemon itself."""
    return _line(when, kind, content)


def _content(record: Record, when: When) -> tuple[str, dict[str, object]]:
    match record:
        case EventClosed(event):
            return "event", _event(event, when)
        case EventOpened(event):
            return "opened", _event(event, when)
        case StateChanged(old, new, reason):
            return "state", {"from": old, "to": new, "reason": reason}
        case Change():
            return "stage", _stage(record)
        case SendText(severity, text):
            return "text", {"severity": int(severity), "text": text}
        case TextSuppressed(text, count):
            return "suppressed", {"text": text, "count": count}
        case Baseline():
            return "baseline", {
                "digest": record.digest,
                "airframe": record.airframe.name,
                "layout": record.layout_statement,
            }
        case Note(text):
            return "note", {"text": text}


def _event(event: Event, when: When) -> dict[str, object]:
    end_s = None if event.end_ns is None else event.end_ns / NS_PER_S
    content = dict[str, object](event_json(event.start_ns / NS_PER_S, end_s, event))
    if when.vehicle_ns is not None:
        since = timedelta(seconds=(when.vehicle_ns - event.start_ns) / NS_PER_S)
        content["start_utc"] = _iso(when.utc - since)
    return content


def _stage(change: Change) -> dict[str, object]:
    """Numbers that are not finite become null, as in an event."""
    names = ("stage", "reason", "monitor", "axis", "statistic", "threshold", "rotor")
    fields = {name: getattr(change, name) for name in names} | {"fault_kind": change.kind}
    sound = {name: None if isinstance(one, float) and not math.isfinite(one) else one for name, one in fields.items()}
    return {"t_s": round(change.t_ns / NS_PER_S, 6)} | sound


def _line(when: When, kind: str, content: dict[str, object]) -> str:
    head: dict[str, object] = {"kind": kind, "utc": _iso(when.utc), "vehicle": when.vehicle}
    if when.vehicle_ns is not None:
        head["vehicle_s"] = round(when.vehicle_ns / NS_PER_S, 6)
    return json.dumps({**head, **content}, allow_nan=False)


def _iso(at: datetime) -> str:
    return at.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


class _Appender:
    """A file that is appended to. What cannot be written is counted, and reported once.

    option: the command-line option that names it.
    warn: called once when writing begins to fail, and once when it works again.
    Raises UsageError if the file cannot be opened.
    """

    def __init__(self, path: Path, option: str, warn: Callable[[str], None]) -> None:
        try:
            self._file: BinaryIO = path.open("ab", buffering=0)
        except OSError as error:
            reason = error.strerror
            raise UsageError(f"{path}: cannot be written ({reason}); choose another {option} file") from error
        self._name, self._warn = f"{option.removeprefix('--')} {path}", warn
        self._torn = False  # the last entry was written only in part
        self.lost = 0  # entries in a row that could not be written

    def append(self, data: bytes, after_torn: bytes = b"") -> None:
        """Append an entry, or count it as lost. after_torn: what goes before it if the last one was torn."""
        data = (after_torn if self._torn else b"") + data
        try:
            written = self._file.write(data)
        except OSError as error:
            self._failed(error.strerror or str(error))
            return
        if written < len(data):
            self._torn = self._torn or written > 0
            self._failed("the entry did not fit")
            return
        if self.lost:
            self._warn(f"{self._name}: writing again; {self.lost} entries were lost")
        self._torn, self.lost = False, 0

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _failed(self, reason: str) -> None:
        if not self.lost:
            self._warn(f"{self._name}: cannot be written ({reason}); watching goes on without it")
        self.lost += 1


class Journal(_Appender):
    """A file that lines are appended to, each written whole at once. See `_Appender` for what may go wrong."""

    def __init__(self, path: Path, warn: Callable[[str], None]) -> None:
        super().__init__(path, "--journal", warn)

    def write(self, text: str) -> None:
        """Append one line."""
        self.append(text.encode() + b"\n", after_torn=b"\n")


class Recorder(_Appender):
    """A telemetry log (.tlog) of all frames received. See `_Appender` for what may go wrong.

    epoch_ns: what the host clock must be set forward by to be unix time [ns].
    """

    def __init__(self, path: Path, epoch_ns: int, warn: Callable[[str], None]) -> None:
        super().__init__(path, "--record", warn)
        self._epoch_ns = epoch_ns

    def write(self, frames: Iterable[bytes], host_ns: int) -> None:
        """Append frames that came at one time; a reader skips what was torn."""
        time_us = (self._epoch_ns + host_ns) // NS_PER_US
        records = [tlog_record(time_us, frame) for frame in frames if len(frame) >= FRAME_BYTES]
        if records:
            self.append(b"".join(records))
