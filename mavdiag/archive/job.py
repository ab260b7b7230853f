"""What is asked of a log in an archive, the answer, which can be kept as JSON, and how a worker finds it (edge)."""

import hashlib
import json
import os
from dataclasses import asdict, dataclass, replace
from functools import cache, lru_cache
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from mavdiag.archive.figures import FlightRecord, record_of
from mavdiag.archive.sources import judging_version
from mavdiag.archive.windows import Window, windows_of
from mavdiag.baseline import Baseline, dump, parse
from mavdiag.errors import InputError, LinkError
from mavdiag.judging import JUDGED_SHARE, LogVerdict, Verdict, judge, judge_in_full
from mavdiag.logs.csv_columns import parse_column_map
from mavdiag.logs.part import read_part
from mavdiag.storage import open_regular

END_BYTES = 4096  # of each end of a file: two flights differ there by their times (our choice)
CHUNK_BYTES = 1 << 20
MOST_BYTES = 1 << 40  # the readers know how long a log of their kind may be


@dataclass(frozen=True, slots=True)
class Options:
    """What changes the answer beside the log and the baseline.

    vehicle: MAVLink system id, where a log holds several.
    from_s, to_s: the part of the log to judge, of the vehicle's clock [s].
    windows_s: length of windows to judge besides [s]; None for none.
    columns: the text of a column map, where the logs are CSV recordings (`mavdiag.logs.csv_columns`).
    judged_share: of the flown time that must be judged before a log is called healthy, 0..1.
    figures: what the history keeps of a flight is wanted, too.
    flown_ns: when a log without a clock was flown, unix epoch [ns]; 0 if that is not known.
    """

    vehicle: int | None = None
    from_s: float | None = None
    to_s: float | None = None
    windows_s: float | None = None
    columns: str | None = None
    judged_share: float = JUDGED_SHARE
    figures: bool = False
    flown_ns: int = 0


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked of every log.

    baseline: the content of the baseline file. It goes with every task: what a worker holds is lost with it.
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
        content = json.dumps([baseline.digest, asdict(options), version], sort_keys=True)
        return cls(dump(baseline), options, version, hashlib.sha256(content.encode()).hexdigest()[:20])


@dataclass(frozen=True, slots=True)
class Record:
    """The answer for one content, wherever it lies.

    digest: SHA-256 of the file's content; empty if it could not be read.
    verdict: without the name of a log.
    windows, flight: empty or None if they were not asked for; the flight has no airframe's name.
    """

    digest: str
    verdict: LogVerdict
    windows: tuple[Window, ...] = ()
    flight: FlightRecord | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer for one of the logs that were asked for.

    path: as it was named. record: may be shared with other logs of the same content.
    fresh: it was judged now; False if it was kept from before, or another log has the same content.
    """

    path: Path
    record: Record
    fresh: bool

    @property
    def verdict(self) -> LogVerdict:
        """With the name of the log."""
        return replace(self.record.verdict, log=str(self.path))


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
            ends += file.read(END_BYTES)
    except (InputError, OSError):
        return ""
    return hashlib.sha256(b"%d %s" % (size, ends)).hexdigest()[:16]


def digest_of(path: Path) -> str:
    """SHA-256 of a file's content, hexadecimal; empty if it cannot be read."""
    try:
        with open_regular(path, MOST_BYTES) as file:
            digest = hashlib.sha256()
            while part := file.read(CHUNK_BYTES):
                digest.update(part)
            return digest.hexdigest()
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
    columns = None if options.columns is None else parse_column_map(options.columns)
    log = read_part(Path(path), options.vehicle, options.from_s, options.to_s, columns)
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
