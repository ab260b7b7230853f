"""What is asked of a log in an archive, and the answer, which can be kept as JSON and is the same when read again."""

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from mavdiag.archive.windows import Window
from mavdiag.baseline import Baseline, dump
from mavdiag.errors import InputError
from mavdiag.judging import JUDGED_SHARE, LogVerdict, Verdict

__all__ = ["Answer", "Options", "Question", "Record", "record_from", "record_text", "refused"]


@dataclass(frozen=True, slots=True)
class Options:
    """What changes the answer beside the log and the baseline.

    vehicle: MAVLink system id, where a log holds several.
    from_s, to_s: the part of the log to judge, of the vehicle's clock [s].
    windows_s: length of windows to judge besides [s]; None for none.
    columns: the text of a column map, where the logs are CSV recordings (`mavdiag.logs.csv_columns`).
    judged_share: of the flown time that must be judged before a log is called healthy, 0..1.
    """

    vehicle: int | None = None
    from_s: float | None = None
    to_s: float | None = None
    windows_s: float | None = None
    columns: str | None = None
    judged_share: float = JUDGED_SHARE


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked of every log.

    baseline: the content of the baseline file. It goes with every task: what a worker holds is lost with it.
    options: what changes the answer besides.
    version: of the code that asks; a worker of another version must not answer.
    scope: what the answers are kept under, 20 hexadecimal digits; the log's digest is the rest of the key.
    """

    baseline: str
    options: Options
    version: str
    scope: str

    @classmethod
    def of(cls, baseline: Baseline, options: Options, version: str) -> "Question":
        """The question about a baseline."""
        content = json.dumps([baseline.digest, asdict(options), version], sort_keys=True)
        return cls(dump(baseline), options, version, hashlib.sha256(content.encode()).hexdigest()[:20])


@dataclass(frozen=True, slots=True)
class Record:
    """The answer for one content, wherever it lies.

    digest: SHA-256 of the file's content; empty if it could not be read.
    verdict: without the name of a log.
    windows: in order of time; empty if none were asked for.
    """

    digest: str
    verdict: LogVerdict
    windows: tuple[Window, ...] = ()


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer for one of the logs that were asked for.

    number: its place in the list, from 0.
    path: as it was named.
    record: may be shared with other logs of the same content.
    fresh: it was judged now; False if it was kept from before, or another log has the same content.
    """

    number: int
    path: Path
    record: Record
    fresh: bool

    @property
    def verdict(self) -> LogVerdict:
        """With the name of the log."""
        return replace(self.record.verdict, log=str(self.path))


def refused(reason: str, digest: str = "") -> Record:
    """The record of a log that cannot be judged for an error. reason: a sentence."""
    return Record(digest, LogVerdict("", Verdict.ERROR, reason))


def record_text(record: Record) -> str:
    """The record as JSON, every number to its last bit."""
    return json.dumps(asdict(record))


def record_from(text: str) -> Record:
    """The record of a text. Raises InputError if it is none."""
    try:
        return _adapter().validate_json(text)
    except ValidationError as error:
        raise InputError(f"not an answer that was kept: {error.errors()[0]['msg']}") from error


@cache
def _adapter() -> TypeAdapter[Record]:
    return TypeAdapter(Record)
