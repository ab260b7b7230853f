"""What is asked of a log in an archive, how a worker finds the answer, and where answers are kept (edge)."""

import hashlib
import json
import os
from dataclasses import asdict, dataclass, replace
from functools import cache, lru_cache
from io import BufferedReader
from pathlib import Path
from typing import cast

from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_json

from mavdiag.archive.figures import FlightRecord, Window, record_of, windows_of
from mavdiag.archive.sources import judging_version
from mavdiag.baseline import Baseline, dump, parse
from mavdiag.errors import InputError, LinkError, UsageError
from mavdiag.judging import JUDGED_SHARE, LogVerdict, Verdict, judge, judge_in_full
from mavdiag.logs.csv_columns import ColumnMap
from mavdiag.logs.part import read_part
from mavdiag.storage import open_regular, read_text, write_atomically

END_BYTES = 4096  # of each end of a file: two flights differ there by their times (our choice)
MOST_BYTES = 1 << 40  # the readers know how long a log of their kind may be
RECORD_BYTES = 64 << 20  # of one answer; a flight of an hour with an alarm a second has 1 MB (our choice)


@dataclass(frozen=True, slots=True)
class Options:
    """What changes the answer beside the log and the baseline.

    vehicle: MAVLink system id, where a log holds several.
    from_s, to_s: the part of the log to judge, of the vehicle's clock [s].
    windows_s: length of windows to judge besides [s]; None for none.
    columns: of logs that are CSV recordings.
    judged_share: of the flown time that must be judged before a log is called healthy, 0..1.
    figures: what the history keeps of a flight is wanted, too.
    flown_ns: when a log without a clock was flown, unix epoch [ns]; 0 if that is not known.
    """

    vehicle: int | None = None
    from_s: float | None = None
    to_s: float | None = None
    windows_s: float | None = None
    columns: ColumnMap | None = None
    judged_share: float = JUDGED_SHARE
    figures: bool = False
    flown_ns: int = 0


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked of every log.

    baseline: its content, with every task, for what a worker holds is lost with it.
    version: of the code that asks; a worker of another version must not answer.
    scope: what the answers are kept under, 20 hexadecimal digits; the log's digest is the rest of the key.
    """

    baseline: str
    options: Options
    version: str
    scope: str

    @classmethod
    def of(cls, baseline: Baseline, options: Options) -> "Question":
        """The question about a baseline, asked by this code."""
        version = judging_version()
        content = to_json([baseline.digest, options, version], inf_nan_mode="constants")
        return cls(dump(baseline), options, version, hashlib.sha256(content).hexdigest()[:20])


@dataclass(frozen=True, slots=True)
class Record:
    """The answer for one content, wherever it lies: without the name of a log or an airframe.

    digest: SHA-256 of the file's content; empty if it could not be read.
    windows, flight: empty or None if they were not asked for.
    """

    digest: str
    verdict: LogVerdict
    windows: tuple[Window, ...] = ()
    flight: FlightRecord | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer for one of the logs that were asked for, under its path as named.

    fresh: it was judged now; False if it was kept from before, or another log has the same content.
    """

    path: Path
    record: Record
    fresh: bool

    @property
    def verdict(self) -> LogVerdict:
        """With the name of the log."""
        return replace(self.record.verdict, log=str(self.path))


@dataclass(frozen=True, slots=True)
class Cache:
    """Answers to one question that were found before, a small file each, named by the log's mark and its digest."""

    folder: Path

    def marks(self) -> frozenset[str]:
        """The marks of all contents that have an answer: a log with another one is new."""
        try:
            return frozenset(path.name.partition("-")[0] for path in self.folder.iterdir())
        except OSError:
            return frozenset()

    def get(self, mark: str, digest: str) -> Record | None:
        """The answer for a content; None if there is none, or its file is damaged."""
        try:
            record = record_from(read_text(self._file(mark, digest), RECORD_BYTES))
        except InputError:
            return None
        return record if record.digest == digest else None

    def put(self, mark: str, record: Record) -> None:
        """Keep an answer at once. Raises UsageError if it cannot be written."""
        write_atomically(self._file(mark, record.digest), record_text(record), durable=False)

    def _file(self, mark: str, digest: str) -> Path:
        return self.folder / f"{mark}-{digest}.json"


def cache_folder() -> Path | None:
    """Where answers are kept unless told otherwise (XDG Base Directory Specification); None without a home."""
    told = os.environ.get("XDG_CACHE_HOME", "")
    try:  # a relative path is to be ignored, says the specification
        return (Path(told) if Path(told).is_absolute() else Path.home() / ".cache") / "mavdiag"
    except RuntimeError:
        return None


def open_cache(folder: Path, scope: str) -> Cache:
    """The answers of a scope below a folder, which is made. Raises UsageError if it cannot be used."""
    mine, why = folder / "scan" / scope, "cannot be written (no permission)"
    try:
        mine.mkdir(parents=True, exist_ok=True)
        if os.access(mine, os.W_OK | os.X_OK):
            return Cache(mine)
    except OSError as error:
        why = f"no folder to keep answers in ({error.strerror or error})"
    raise UsageError(f"{folder}: {why}; name another with --cache, or use --no-cache")


def refused(reason: str) -> Record:
    """The record of a log that cannot be judged for an error. reason: a sentence."""
    return Record("", LogVerdict("", Verdict.ERROR, reason))


def record_text(record: Record) -> str:
    """The record as JSON, every number to its last bit."""
    return json.dumps(asdict(record))


def record_from(text: str) -> Record:
    """The record of a text. Raises InputError if it is none."""
    try:
        return _adapter().validate_json(text)
    except ValidationError as error:
        raise InputError(f"not an answer that was kept: {error.errors()[0]['msg']}") from error


def mark_of(path: Path) -> str:
    """A digest of a file's size and ends, which files of equal content share; empty if it cannot be read."""
    try:
        with open_regular(path, MOST_BYTES) as file:
            size = os.fstat(file.fileno()).st_size
            ends = file.read(END_BYTES)
            file.seek(max(len(ends), size - END_BYTES))
            return hashlib.sha256(b"%d %s" % (size, ends + file.read(END_BYTES))).hexdigest()[:16]
    except (InputError, OSError):
        return ""


def digest_of(path: Path) -> str:
    """SHA-256 of a file's content, hexadecimal; empty if it cannot be read."""
    try:
        with open_regular(path, MOST_BYTES) as file:
            return hashlib.file_digest(cast(BufferedReader, file), "sha256").hexdigest()
    except (InputError, OSError):
        return ""


def judge_file(path: str, question: Question) -> Record:
    """The task of a worker: read a log and judge it.

    Raises InputError if it cannot be read, and LinkError if this process has other code, or computes with other
    packages, than the one that asks.
    """
    if judging_version() != question.version:
        raise LinkError("a worker has another version of mavdiag, numpy or scipy; install the same ones everywhere")
    options, baseline = question.options, _parsed(question.baseline)
    log = read_part(Path(path), options.vehicle, options.from_s, options.to_s, options.columns)
    log = replace(log, started_ns=log.started_ns or options.flown_ns)
    if options.windows_s is None and not options.figures:
        return Record(log.sha256, replace(judge(log, baseline, options.judged_share), log=""))
    flight = judge_in_full(log, baseline, options.judged_share)
    windows = () if options.windows_s is None else windows_of(flight, options.windows_s, options.judged_share)
    kept = record_of(log, flight, baseline) if options.figures else None
    return Record(log.sha256, replace(flight.verdict, log=""), windows, kept)


_parsed = lru_cache(maxsize=2)(parse)  # a worker gets the same baseline with every task


@cache
def _adapter() -> TypeAdapter[Record]:
    return TypeAdapter(Record)
