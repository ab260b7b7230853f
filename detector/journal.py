"""The journal (edge): one JSON object a line, for events, states, texts and notes. A full disk stops nothing else.

kind       besides "utc" (when written), "vehicle" (system id) and "vehicle_s" (the vehicle's clock, if known)
event      an alarm of one monitor, whole; the fields of the public contract, its start in vehicle time and UTC
opened     the same at its beginning, with the figures of that moment and end_s null
state      from, to, reason          text        severity, text            suppressed   text, count
baseline   digest, airframe          note        text                      start, stop  of the daemon
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import BinaryIO

from detector.effects import (
    BaselineLearned,
    EventClosed,
    EventOpened,
    Note,
    Record,
    SendText,
    StateChanged,
    TextSuppressed,
)
from mavdiag.decision.events import Event
from mavdiag.errors import UsageError
from mavdiag.report import event_json
from mavdiag.telemetry import NS_PER_S

__all__ = ["Journal", "When", "line", "mark"]


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
        case SendText(severity, text):
            return "text", {"severity": int(severity), "text": text}
        case TextSuppressed(text, count):
            return "suppressed", {"text": text, "count": count}
        case BaselineLearned(baseline):
            return "baseline", {"digest": baseline.digest, "airframe": baseline.airframe.name}
        case Note(text):
            return "note", {"text": text}


def _event(event: Event, when: When) -> dict[str, object]:
    end_s = None if event.end_ns is None else event.end_ns / NS_PER_S
    content = dict[str, object](event_json(event.start_ns / NS_PER_S, end_s, event))
    if when.vehicle_ns is not None:
        since = timedelta(seconds=(when.vehicle_ns - event.start_ns) / NS_PER_S)
        content["start_utc"] = _iso(when.utc - since)
    return content


def _line(when: When, kind: str, content: dict[str, object]) -> str:
    head: dict[str, object] = {"kind": kind, "utc": _iso(when.utc), "vehicle": when.vehicle}
    if when.vehicle_ns is not None:
        head["vehicle_s"] = round(when.vehicle_ns / NS_PER_S, 6)
    return json.dumps({**head, **content}, allow_nan=False)


def _iso(at: datetime) -> str:
    return at.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


class Journal:
    """A file that lines are appended to, each written whole at once. What cannot be written is counted, and told once.

    warn: told once when writing begins to fail, and once when it works again. Raises UsageError if the file cannot be
    opened.
    """

    def __init__(self, path: Path, warn: Callable[[str], None]) -> None:
        try:
            self._file: BinaryIO = path.open("ab", buffering=0)
        except OSError as error:
            raise UsageError(f"{path}: cannot be written ({error.strerror}); choose another --journal file") from error
        self._path, self._warn = path, warn
        self._torn = False  # the last line was written only in part
        self.lost = 0  # lines in a row that could not be written

    def write(self, text: str) -> None:
        """Append one line, or count it as lost."""
        data = (b"\n" if self._torn else b"") + text.encode() + b"\n"
        try:
            written = self._file.write(data)
        except OSError as error:
            self._failed(error.strerror or str(error))
            return
        if written < len(data):
            self._torn = self._torn or written > 0
            self._failed("the line did not fit")
            return
        if self.lost:
            self._warn(f"journal {self._path}: writing again; {self.lost} lines were lost")
        self._torn, self.lost = False, 0

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _failed(self, reason: str) -> None:
        if not self.lost:
            self._warn(f"journal {self._path}: cannot be written ({reason}); watching goes on without it")
        self.lost += 1
