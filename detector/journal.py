"""What the daemon writes down (edge): the journal, the recording, log lines, learned baselines.

The journal has one JSON object a line:
kind       besides "utc" (when written), "vehicle" (system id) and "vehicle_s" (the vehicle's clock, if known)
event      an alarm of one monitor, whole; the fields of the public contract, its start in vehicle time and UTC
opened     the same at its beginning, with the figures of that moment and end_s null
state      from, to, reason          text        severity, text            suppressed   text, count
stage      the decision: stage, reason, the evidence that it rests on, and every rotor that was named with its span
baseline   digest, airframe, layout  note        text                      start, stop  of the daemon
"""

import json
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Protocol

from detector.appender import Appender
from detector.config import Fsync
from detector.values import Effect, EventClosed, EventOpened, Note, Record, SendText, StateChanged, TextSuppressed
from mavdiag.as_json import event_json, plain
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import Change, Event, Stage
from mavdiag.errors import UsageError
from mavdiag.link.messages import Severity
from mavdiag.units import NS_PER_S, NS_PER_US

FRAME_BYTES = 8  # the shortest MAVLink frame; what is shorter is no frame


@dataclass(frozen=True, slots=True)
class When:
    """The time of a line: the wall clock, and the vehicle's, None if it is not known. vehicle: system id."""

    utc: datetime
    vehicle: int | None = None
    vehicle_ns: int | None = None


def line(record: Record, when: When) -> str:
    """One line of the journal, without its newline."""
    kind, content = _content(record, when)
    return mark(kind, when, content)


def mark(kind: str, when: When, content: dict[str, object]) -> str:
    """A line of any content, as about the daemon itself."""
    head: dict[str, object] = {"kind": kind, "utc": _iso(when.utc), "vehicle": when.vehicle}
    if when.vehicle_ns is not None:
        head["vehicle_s"] = _s(when.vehicle_ns)
    return json.dumps({**head, **content}, allow_nan=False)


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
            named = record.airframe.name
            return "baseline", {"digest": record.digest, "airframe": named, "layout": record.layout_statement}
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
    held: dict[str, object] = plain({name: getattr(change, name) for name in names} | {"fault_kind": change.kind})
    spans = [
        {"rotor": span.rotor, "since_s": _s(span.since_ns), "end_s": None if span.end_ns is None else _s(span.end_ns)}
        for span in change.rotors
    ]
    declared_s = None if change.declared_ns is None else _s(change.declared_ns)
    return {"t_s": _s(change.t_ns)} | held | {"seen": change.seen, "declared_s": declared_s, "rotors": spans}


def _s(t_ns: int) -> float:
    return round(t_ns / NS_PER_S, 6)


def _iso(at: datetime) -> str:
    return at.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


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


class Journal(Appender):
    """A file that lines are appended to. See `Appender` for what may go wrong.

    fsync: when it is written through to the disk; `flush` does it, once for all lines of a look.
    """

    def __init__(
        self,
        path: Path,
        warn: Callable[[str], None],
        limit_mb: float | None = None,
        keep: int = 0,
        fsync: Fsync = Fsync.ALERT,
    ) -> None:
        super().__init__(path, "--journal", warn, limit_mb, keep)
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
        self, path: Path, epoch_ns: int, warn: Callable[[str], None], limit_mb: float | None = None, keep: int = 0
    ) -> None:
        from mavdiag.logs.tlog import tlog_record  # only with a recording: it brings the readers of logs

        super().__init__(path, "--record", warn, limit_mb, keep)
        self._record = tlog_record
        self._epoch_ns = epoch_ns
        self._records: list[bytes] = []

    def write(self, frames: Iterable[bytes], host_ns: int) -> None:
        """Take frames that came at one time; `flush` appends them."""
        time_us = (self._epoch_ns + host_ns) // NS_PER_US
        self._records += [self._record(time_us, frame) for frame in frames if len(frame) >= FRAME_BYTES]

    def flush(self) -> None:
        """Append what was taken since the last call; a reader skips what was torn."""
        if self._records:
            self.append(b"".join(self._records), entries=len(self._records))
            self._records.clear()

    def close(self) -> None:
        """Append what is left, write through and close the file."""
        self.flush()
        super().close()


class Lines(Protocol):
    """Who takes the journal's lines: the journal, the live page."""

    def write(self, text: str, *, urgent: bool = False) -> None:
        """Take one. urgent: it is about an alert."""


class Reporter:
    """Writes to the log, and to those who take the journal's lines.

    lines: these; there may be none.
    say: takes a log line.
    when: the time of a line about a vehicle (None: about the daemon).
    save: file for learned baselines, None to keep none.
    """

    def __init__(
        self, lines: Sequence[Lines], say: Callable[[str], None], when: Callable[[int | None], When], save: Path | None
    ) -> None:
        self._lines, self._say, self._when, self._path = tuple(lines), say, when, save
        self._saved: dict[int, Path] = {}

    def record(self, sysid: int, effect: Effect) -> None:
        """The effects that are worth a line, in the journal and, most of them, in the log."""
        if not isinstance(effect, Record):
            return
        if self._lines:
            text, urgent = line(effect, self._when(sysid)), is_urgent(effect)
            for taker in self._lines:
                taker.write(text, urgent=urgent)
        for words in _log_lines(effect):
            self._say(f"vehicle {sysid}: {words}")

    def mark(self, kind: str, content: dict[str, object]) -> None:
        """A line about the daemon itself."""
        for taker in self._lines:
            taker.write(mark(kind, self._when(None), content))

    def save(self, sysid: int, baseline: Baseline) -> None:
        """Keep a learned baseline: the first vehicle's under the name asked for, another's with its id in it."""
        path = self._path
        if path is None:
            return
        if path.exists() and self._saved.get(sysid) != path:
            path = path.with_stem(f"{path.stem}-{sysid}")
        self._saved[sysid] = path
        try:
            baseline.save(path)
        except UsageError as error:
            self.record(sysid, Note(f"the baseline is not saved: {error}"))
        else:
            self.record(sysid, Note(f"baseline saved to {path}"))


def kept_baselines(path: Path) -> dict[int, tuple[Path, Baseline]]:
    """What earlier starts learned and kept under this name, by system id; 0 for one that was not learned live.

    Raises BaselineError for a file that is none.
    """
    own = re.compile(rf"{re.escape(path.stem)}-\d+{re.escape(path.suffix)}")
    beside = [near for near in path.parent.iterdir() if own.fullmatch(near.name)] if path.parent.is_dir() else []
    loaded = [(file, Baseline.load(file)) for file in (path, *sorted(beside)) if file.is_file()]
    return {baseline.provenance.vehicle: (file, baseline) for file, baseline in reversed(loaded)}


def _log_lines(record: Record) -> list[str]:
    match record:
        case StateChanged(old, new, reason):
            return [f"{old} -> {new}: {reason}"]
        case Change(stage=stage, reason=reason):
            return [f"decision: {stage}, {reason}"]
        case SendText(severity, text):
            return [f"{severity.name} {text!r}"]
        case Baseline():
            return str(record).splitlines()
        case Note(text):
            return [text]
        case TextSuppressed(text, count):
            return [f"held back {text!r} ({count} so far)"]
        case _:
            return []
