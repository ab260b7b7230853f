"""What the daemon writes down (edge): the journal, the recording, log lines, learned baselines.

The journal has one JSON object a line:
kind       besides "utc" (when written), "vehicle" (system id) and "vehicle_s" (the vehicle's clock, if known)
event      an alarm of one monitor, whole; the fields of the public contract, its start in vehicle time and UTC
opened     the same at its beginning, with the figures of that moment and end_s null
state      from, to, reason          text        severity, text            suppressed   text, count
stage      the decision: stage, reason, the evidence that it rests on, and every rotor that was named with its span
baseline   digest, airframe, layout  note        text                      start, stop  of the daemon

What cannot be written is counted and reported once, and the next entry is tried again: nothing here stops the daemon.
"""

import contextlib
import errno
import fcntl
import json
import os
import re
import stat
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from math import inf
from pathlib import Path
from typing import BinaryIO

from detector.config import Settings
from detector.values import Effect, EventClosed, EventOpened, Note, Record, SendText, StateChanged, TextSuppressed
from mavdiag.as_json import event_json, plain, seconds, spans_json
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import Change, Event, Stage
from mavdiag.errors import UsageError
from mavdiag.link.messages import Severity
from mavdiag.logs.tlog import tlog_record
from mavdiag.storage import begins, check_apart, check_writable, leave_room
from mavdiag.units import NS_PER_S, NS_PER_US

MB = 1_000_000
_REASONS = {errno.ENXIO: "nobody reads this pipe", errno.EWOULDBLOCK: "another program writes it"}
_ALERTS = (Stage.SUSPECTED, Stage.FAULT, Stage.INSPECT)

Content = dict[str, object]


@dataclass(frozen=True, slots=True)
class When:
    """The time of a line: the wall clock, and the vehicle's, None if it is not known. vehicle: system id."""

    utc: datetime
    vehicle: int | None = None
    vehicle_ns: int | None = None


def mark(kind: str, when: When, content: Content) -> str:
    """One line of the journal, without its newline."""
    head: Content = {"kind": kind, "utc": _iso(when.utc), "vehicle": when.vehicle}
    if when.vehicle_ns is not None:
        head["vehicle_s"] = seconds(when.vehicle_ns)
    return json.dumps({**head, **content}, allow_nan=False)


def _told(record: Record, when: When) -> tuple[str, Content, str, bool]:
    """Kind and content of a record's line, its words in the log, empty for none, and whether it is about an alert."""
    match record:
        case EventClosed(event) | EventOpened(event):
            return "opened" if isinstance(record, EventOpened) else "event", _event(event, when), "", True
        case StateChanged(old, new, reason):
            return "state", {"from": old, "to": new, "reason": reason}, f"{old} -> {new}: {reason}", False
        case Change(stage=stage, reason=reason):
            return "stage", _stage(record), f"decision: {stage}, {reason}", stage in _ALERTS
        case SendText(severity, text):
            content: Content = {"severity": int(severity), "text": text}
            return "text", content, f"{severity.name} {text!r}", severity <= Severity.WARNING
        case TextSuppressed(text, count):
            return "suppressed", {"text": text, "count": count}, f"held back {text!r} ({count} so far)", False
        case Baseline():
            named = record.airframe.name
            content = {"digest": record.digest, "airframe": named, "layout": record.layout_statement}
            return "baseline", content, str(record), False
        case Note(text):
            return "note", {"text": text}, text, False


def _event(event: Event, when: When) -> Content:
    content = Content(event_json(event))
    if when.vehicle_ns is not None:
        since = timedelta(seconds=(when.vehicle_ns - event.start_ns) / NS_PER_S)
        content["start_utc"] = _iso(when.utc - since)
    return content


def _stage(change: Change) -> Content:
    names = ("stage", "reason", "monitor", "axis", "statistic", "threshold", "rotor")
    held: Content = plain({name: getattr(change, name) for name in names} | {"fault_kind": change.kind})
    rest = {"seen": change.seen, "declared_s": seconds(change.declared_ns), "rotors": spans_json(change.rotors)}
    return {"t_s": seconds(change.t_ns)} | held | rest


def _iso(at: datetime) -> str:
    return at.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def older(path: Path, number: int) -> Path:
    """The name of an old file; the kind stays at the end.

    >>> older(Path("flight.tlog"), 2).name
    'flight.2.tlog'
    """
    return path.with_suffix(f".{number}{path.suffix}")


class Appender:
    """A file that is appended to, each entry whole at once. It has one writer; a pipe that is full loses entries.

    warn: called once when writing begins to fail, and once when it works again. limit_mb: size that it does not exceed.
    keep: how many old ones stay. Raises UsageError if the file cannot be opened.
    """

    option: str  # of the command line, that names it
    after_torn = b""  # goes before an entry if the last one was torn
    leaves_room = False  # whether it is not written where the disk is nearly full

    def __init__(self, path: Path, warn: Callable[[str], None], limit_mb: float = inf, keep: int = 0) -> None:
        self._path, self._name, self._warn = path, f"{self.option.removeprefix('--')} {path}", warn
        self._limit_bytes, self._keep = limit_mb * MB, keep
        try:
            self._file = self._open()
        except OSError as error:
            reason = _REASONS.get(error.errno or 0, error.strerror or str(error))
            raise UsageError(f"{path}: cannot be written ({reason}); choose another {self.option} file") from error
        self._torn = False  # the last entry was written only in part
        self._failing = 0  # entries in a row that could not be written
        self.lost = 0  # entries that could not be written, so far

    def append(self, data: bytes, entries: int = 1) -> None:
        """Append an entry, or several, or count them as lost."""
        data = (self.after_torn if self._torn else b"") + data
        try:
            if self._regular and self._size > 0 and self._size + len(data) > self._limit_bytes:
                self._rotate()
            if self._regular and self.leaves_room:
                leave_room(self._file)
            written = self._file.write(data) or 0  # None from a pipe that is full
        except OSError as error:
            self._failed(error.strerror or str(error), entries)
            return
        self._size += written
        if written < len(data):
            self._torn = self._torn or written > 0
            self._failed("not all of it fitted", entries)
            return
        if self._failing:
            self._warn(f"{self._name}: writing again; {self._failing} entries were lost")
        self._torn, self._failing = False, 0

    def sync(self) -> None:
        """Write through to the disk; what that cannot do counts as a lost entry. A pipe or device is left alone."""
        if self._regular:
            try:
                os.fsync(self._file.fileno())
            except OSError as error:
                self._failed(error.strerror or str(error))

    def close(self) -> None:
        """Write through and close the file."""
        self.sync()
        with contextlib.suppress(OSError):
            self._file.close()

    def _open(self) -> BinaryIO:
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC
        file = os.fdopen(os.open(self._path, flags, 0o666), "ab", buffering=0)
        status = os.fstat(file.fileno())
        regular = stat.S_ISREG(status.st_mode)
        if regular:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                file.close()
                raise
            except OSError:  # the file system has no locks
                pass
            with contextlib.suppress(OSError):  # let a new name survive a power cut, where the file system can do that
                folder = os.open(self._path.parent, os.O_RDONLY | os.O_DIRECTORY)
                try:
                    os.fsync(folder)
                finally:
                    os.close(folder)
        self._regular, self._size = regular, status.st_size
        return file

    def _rotate(self) -> None:
        """Number the old files one higher and begin a new one. Raises OSError; the present file is kept then."""
        if self._path.exists():  # it is gone if the last attempt failed half-way
            for number in range(self._keep - 1, 0, -1):
                if older(self._path, number).exists():
                    older(self._path, number).replace(older(self._path, number + 1))
            if self._keep:
                self._path.replace(older(self._path, 1))
            else:
                self._path.unlink()
        new = self._open()
        self._file.close()
        self._file, self._torn = new, False

    def _failed(self, reason: str, entries: int = 1) -> None:
        if not self._failing:
            self._warn(f"{self._name}: cannot be written ({reason}); watching goes on without it")
        self._failing += entries
        self.lost += entries


class Journal(Appender):
    """A file that lines are appended to. `flush` writes alerts through to the disk, once for all lines of a look."""

    option, after_torn = "--journal", b"\n"
    _due = False

    def write(self, text: str, urgent: bool = False) -> None:
        """Append one line. urgent: it is about an alert."""
        self.append(text.encode() + b"\n")
        self._due = self._due or urgent

    def flush(self) -> None:
        """Write through what was written since the last call, if an alert is among it."""
        if self._due:
            self.sync()
        self._due = False


class Recorder(Appender):
    """A telemetry log (.tlog) of all frames received."""

    option, leaves_room = "--record", True

    def __init__(self, path: Path, warn: Callable[[str], None], limit_mb: float = inf, keep: int = 0) -> None:
        super().__init__(path, warn, limit_mb, keep)
        self._records = list[bytes]()

    def write(self, frames: Iterable[tuple[bytes, int]], epoch_ns: int) -> None:
        """Take frames, each with its time of arrival [ns]; `flush` appends them. epoch_ns: makes it unix time."""
        self._records += [tlog_record((epoch_ns + host_ns) // NS_PER_US, frame) for frame, host_ns in frames]

    def flush(self) -> None:
        """Append what was taken since the last call; a reader skips what was torn."""
        if self._records:
            self.append(b"".join(self._records), entries=len(self._records))
            self._records.clear()

    def close(self) -> None:
        """Append what is left, write through and close the file."""
        self.flush()
        super().close()


def check_files(settings: Settings) -> None:
    """Raise UsageError if two settings name one file, a journal or recording would be appended to another kind, or what
    is learned could not be kept."""
    own = settings.journal, settings.record, settings.save
    named = (settings.baseline, settings.signing_key, settings.web_token_file, settings.history, settings.airframe)
    known = [Path(name) for name in (*named, *(one.baseline for one in settings.vehicles.values())) if name is not None]
    for number, path in enumerate(own):
        if path is not None:
            check_apart(path, *own[number + 1 :], *known)
    if settings.save is not None and not settings.save.is_file():  # one that is there is used
        check_writable(settings.save)
    kinds = {"journal": rb'\s*\{"kind"', "record": rb".{8}[\xfd\xfe]", "history": rb"SQLite format 3\0"}
    for option, kind in kinds.items():
        if (path := getattr(settings, option)) is not None and not begins(Path(path), kind):
            raise UsageError(f"{path}: is no {option} so far, and would be spoilt; choose another --{option} file")


class Reporter:
    """Writes to the log (`say`), and to those who take the journal's lines, each with whether it is about an alert.

    when: the time of a line about a vehicle (None: about the daemon). save: file for learned baselines; None for none.
    """

    def __init__(
        self,
        takers: Iterable[Callable[[str, bool], None]],
        say: Callable[[str], None],
        when: Callable[[int | None], When],
        save: Path | None,
    ) -> None:
        self._takers, self._say, self._when, self._path = tuple(takers), say, when, save
        self._saved: dict[int, Path] = {}

    def record(self, sysid: int, effect: Effect) -> None:
        """The effects that are worth a line, in the journal and, most of them, in the log."""
        if isinstance(effect, Record):
            when = self._when(sysid)
            kind, content, words, urgent = _told(effect, when)
            for take in self._takers:
                take(mark(kind, when, content), urgent)
            for part in words.splitlines():
                self._say(f"vehicle {sysid}: {part}")

    def mark(self, kind: str, content: Content) -> None:
        """A line about the daemon itself."""
        for take in self._takers:
            take(mark(kind, self._when(None), content), False)

    def save(self, sysid: int, baseline: Baseline) -> tuple[Record, ...]:
        """Keep a learned baseline, the first vehicle's under the name asked for, another's with its id in it.

        Returns what is to be told of it.
        """
        path = self._path
        if path is None:
            return ()
        if path.exists() and self._saved.get(sysid) != path:
            path = path.with_stem(f"{path.stem}-{sysid}")
        self._saved[sysid] = path
        try:
            baseline.save(path)
        except UsageError as error:
            text = SendText(Severity.WARNING, "PROP baseline not saved, lost at the end")
            return Note(f"the baseline is not saved: {error}"), text
        return (Note(f"baseline saved to {path}"),)


def kept_baselines(path: Path) -> dict[int, Baseline]:
    """What earlier starts learned and kept under this name, by system id; 0 for one that was not learned live.

    Raises BaselineError for a file that is none.
    """
    own = re.compile(rf"{re.escape(path.stem)}-\d+{re.escape(path.suffix)}")
    beside = [near for near in path.parent.iterdir() if own.fullmatch(near.name)] if path.parent.is_dir() else []
    loaded = [Baseline.load(file) for file in (path, *sorted(beside)) if file.is_file()]
    return {baseline.provenance.vehicle: baseline for baseline in reversed(loaded)}


def baselines_in(folder: Path) -> dict[int | str, Baseline]:
    """The baselines of a folder: 3.json by system id, and others by the autopilot's uid in hexadecimal.

    Raises UsageError if there is none, or a name is neither, and BaselineError for a file that is none.
    """
    found: dict[int | str, Baseline] = {}
    for path in sorted(folder.glob("*.json")):
        sysid = int(path.stem) if re.fullmatch(r"[1-9]\d{0,2}", path.stem) else 0
        if not 1 <= sysid <= 255 and not re.fullmatch(r"([0-9a-f]{2}){4,18}", path.stem):
            raise UsageError(f"{path}: name it by system id (3.json) or by uid (000000000051d205.json)")
        found[sysid or path.stem] = Baseline.load(path)
    if not found:
        raise UsageError(f"{folder}: no folder with baselines; put 3.json there for system id 3, or one named by uid")
    return found
