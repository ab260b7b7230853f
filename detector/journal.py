"""The journal and the recorder (edge): what is written while the daemon runs, on top of `appender`.

The journal has one JSON object a line:
kind       besides "utc" (when written), "vehicle" (system id) and "vehicle_s" (the vehicle's clock, if known)
event      an alarm of one monitor, whole; the fields of the public contract, its start in vehicle time and UTC
opened     the same at its beginning, with the figures of that moment and end_s null
state      from, to, reason          text        severity, text            suppressed   text, count
stage      the decision: stage, reason, the evidence that it rests on, and every rotor that was named with its span
baseline   digest, airframe, layout  note        text                      start, stop  of the daemon
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from detector.appender import Appender, Rotation
from detector.config import Fsync
from detector.values import EventClosed, EventOpened, Note, Record, SendText, StateChanged, TextSuppressed
from mavdiag.as_json import event_json, plain
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import Change, Event, Stage
from mavdiag.link.messages import Severity
from mavdiag.logs.tlog import tlog_record
from mavdiag.units import NS_PER_S, NS_PER_US

__all__ = ["Journal", "Recorder", "When", "is_urgent", "line", "mark"]

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
    names = ("stage", "reason", "monitor", "axis", "statistic", "threshold", "rotor")
    fields = {name: getattr(change, name) for name in names} | {"fault_kind": change.kind}
    held: dict[str, object] = plain(fields)
    spans = [
        {"rotor": one.rotor, "since_s": _s(one.since_ns), "end_s": None if one.end_ns is None else _s(one.end_ns)}
        for one in change.rotors
    ]
    declared_s = None if change.declared_ns is None else _s(change.declared_ns)
    return {"t_s": _s(change.t_ns)} | held | {"seen": change.seen, "declared_s": declared_s, "rotors": spans}


def _s(t_ns: int) -> float:
    return round(t_ns / NS_PER_S, 6)


def _line(when: When, kind: str, content: dict[str, object]) -> str:
    head: dict[str, object] = {"kind": kind, "utc": _iso(when.utc), "vehicle": when.vehicle}
    if when.vehicle_ns is not None:
        head["vehicle_s"] = round(when.vehicle_ns / NS_PER_S, 6)
    return json.dumps({**head, **content}, allow_nan=False)


def _iso(at: datetime) -> str:
    return at.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


class Journal(Appender):
    """A file that lines are appended to. See `Appender` for what may go wrong.

    fsync: when it is written through to the disk; `flush` does it, once for all lines of a look.
    """

    def __init__(
        self,
        path: Path,
        warn: Callable[[str], None],
        rotation: Rotation | None = None,
        fsync: Fsync = Fsync.ALERT,
    ) -> None:
        super().__init__(path, "--journal", warn, rotation)
        self._fsync, self._due = fsync, False

    def write(self, text: str, *, urgent: bool = False) -> None:
        """Append one line. urgent: it is about an alert."""
        self.append(text.encode() + b"\n", after_torn=b"\n")
        self._due = self._due or self._fsync is Fsync.ALWAYS or (urgent and self._fsync is Fsync.ALERT)

    def flush(self) -> None:
        """Write through what was written since the last call, if it is to be."""
        if self._due:
            self.sync()
        self._due = False


class Recorder(Appender):
    """A telemetry log (.tlog) of all frames received. See `Appender` for what may go wrong.

    epoch_ns: what the host clock must be set forward by to be unix time [ns].
    """

    def __init__(
        self, path: Path, epoch_ns: int, warn: Callable[[str], None], rotation: Rotation | None = None
    ) -> None:
        super().__init__(path, "--record", warn, rotation)
        self._epoch_ns = epoch_ns
        self._records: list[bytes] = []

    def write(self, frames: Iterable[bytes], host_ns: int) -> None:
        """Take frames that came at one time; `flush` appends them."""
        time_us = (self._epoch_ns + host_ns) // NS_PER_US
        self._records += [tlog_record(time_us, frame) for frame in frames if len(frame) >= FRAME_BYTES]

    def flush(self) -> None:
        """Append what was taken since the last call; a reader skips what was torn."""
        if self._records:
            self.append(b"".join(self._records), entries=len(self._records))
            self._records.clear()

    def close(self) -> None:
        """Append what is left, write through and close the file."""
        self.flush()
        super().close()


def is_urgent(record: Record) -> bool:
    """Whether a record is about an alert: an alarm, a suspicion or fault, a text of at least WARNING."""
    match record:
        case EventOpened() | EventClosed():
            return True
        case Change(stage=stage):
            return stage in (Stage.SUSPECTED, Stage.FAULT, Stage.INSPECT)
        case SendText(severity, _):
            return severity <= Severity.WARNING
        case _:
            return False
