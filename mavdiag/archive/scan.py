"""Many logs to answers (edge): each content judged once, by several workers; each log answered once, in their order.

    logs ─ digest ─▶ known? ─ no ─▶ judge ─▶ keep ─▶ answers of all logs with this content

Where no answer is kept yet, only logs of one size and one beginning can be copies of each other, and only these are
read for their digests; of the others the worker that judges them tells it. A log that cannot be read is answered as an
error; so is one whose judging ends its worker. Nothing else is lost by it.
"""

import hashlib
import os
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from importlib import metadata, resources
from importlib.resources.abc import Traversable
from io import BufferedReader
from pathlib import Path
from typing import cast

from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_json

from mavdiag.archive.figures import FlightRecord, Window, record_of, windows_of
from mavdiag.archive.paths import Named
from mavdiag.archive.pool import died, run_all
from mavdiag.baseline import Baseline, dump, parse
from mavdiag.errors import InputError, LinkError, MavdiagError, UsageError
from mavdiag.judging import JUDGED_SHARE, LogVerdict, Verdict, judge, judge_in_full
from mavdiag.logs import read_part
from mavdiag.logs.csv_columns import ColumnMap
from mavdiag.storage import open_regular, read_text, write_atomically

MOST_BYTES = 1 << 40  # the readers know how long a log of their kind may be
COMPUTED_BY = ("numpy", "scipy", "numba", "pymavlink", "pyulog")  # whose versions may change a figure
HEAD_BYTES = 4096  # of a log that is looked at for copies: it holds the time of its flight (our choice)
RECORD_BYTES = 64 << 20  # of one answer; a flight of an hour with an alarm a second has 1 MB (our choice)
DIED = "the process that judged it died, perhaps for want of memory; judge it alone, or a part of it (--from, --to)"


@dataclass(frozen=True, slots=True)
class Options:
    """What changes the answer beside the log and the baseline.

    from_s, to_s: the part of the log to judge, of the vehicle's clock [s]. windows_s: of windows to judge besides [s].
    judged_share: of the flown time that must be judged before a log is called healthy, 0..1.
    figures: what the history keeps is wanted, too. flown_ns: when a log without a clock was flown [ns]; 0 if unknown.
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
    """What is asked of every log. version: of the code that asks; a worker of another version must not answer.

    baseline: its content, with every task, for what a worker holds is lost with it. scope: what answers are kept under.
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
    """The answer for one content, wherever it lies. digest: of the file, SHA-256; empty if it could not be read."""

    digest: str
    verdict: LogVerdict
    windows: tuple[Window, ...] = ()
    flight: FlightRecord | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer for a log, under its path as named. known: it was kept before. copy: it is that of an earlier log."""

    path: Path
    record: Record
    known: bool = False
    copy: bool = False

    @property
    def verdict(self) -> LogVerdict:
        """With the name of the log."""
        return replace(self.record.verdict, log=str(self.path))


def refused(reason: str) -> Record:
    """The record of a log that cannot be judged for an error. reason: a sentence."""
    return Record("", LogVerdict("", Verdict.ERROR, " ".join(reason.split())))


class Cache:
    """Answers to one question by the digests of the logs, a small file each; none is kept where there is no folder."""

    def __init__(self, folder: Path | None = None, warn: Callable[[str], None] = lambda text: None) -> None:
        self._folder, self._warn = folder, warn

    @property
    def empty(self) -> bool:
        """Whether there is no answer yet."""
        return self._folder is None or not any(self._folder.glob("*.json"))

    def get(self, digest: str) -> Record | None:
        """The answer for a content; None if there is none, or its file is damaged."""
        if self._folder is None:
            return None
        try:
            record = _adapter().validate_json(read_text(self._folder / f"{digest}.json", RECORD_BYTES))
        except (InputError, ValidationError):
            return None
        return record if record.digest == digest else None

    def put(self, record: Record) -> None:
        """Keep an answer at once, unless it is an error."""
        if self._folder is not None and record.digest:
            try:
                text = to_json(record, inf_nan_mode="constants")
                write_atomically(self._folder / f"{record.digest}.json", text, durable=False)
            except UsageError as error:
                self._folder = None
                self._warn(f"answers are not kept any more: {error}")


def own_cache() -> Path:
    """The user's own folder for what is kept between runs (XDG Base Directory Specification)."""
    told = os.environ.get("XDG_CACHE_HOME", "")  # a relative one is to be ignored
    return (Path(told) if Path(told).is_absolute() else Path("~/.cache").expanduser()) / "mavdiag"


def open_cache(folder: Path | None, scope: str, warn: Callable[[str], None] = lambda text: None) -> Cache:
    """The answers of a scope below a folder, which is made; None for the user's own (XDG Base Directory Specification).

    Raises UsageError if a folder that was named cannot be used; of the user's own that is told.
    """
    trouble, mine = "cannot be written (no permission)", (folder or own_cache()) / "scan" / scope
    try:
        mine.mkdir(parents=True, exist_ok=True)
        if os.access(mine, os.W_OK | os.X_OK):
            return Cache(mine, warn)
    except OSError as error:
        trouble = f"no folder to keep answers in ({error.strerror or error})"
    trouble = f"{mine.parents[1]}: {trouble}; name another with --cache, or use --no-cache"
    if folder is not None:
        raise UsageError(trouble)
    warn(f"answers are not kept: {trouble}")
    return Cache()


def digest_of(path: Path) -> str:
    """SHA-256 of a file's content, hexadecimal. Raises InputError if it cannot be read."""
    with open_regular(path, MOST_BYTES) as file:
        return hashlib.file_digest(cast(BufferedReader, file), "sha256").hexdigest()


def head_of(path: Path) -> str:
    """Size and beginning of a file, which copies have in common, in short. Raises InputError if it cannot be read."""
    with open_regular(path, MOST_BYTES) as file:
        return f"{os.fstat(file.fileno()).st_size} {hashlib.sha256(file.read(HEAD_BYTES)).hexdigest()}"


@cache
def digest_of_sources(packages: tuple[str, ...], unrelated: tuple[str, ...] = ("__pycache__",)) -> str:
    """A digest of all sources and data of packages and of the versions of what computes, 16 hexadecimal digits.

    unrelated: ends of the paths that are left out.
    """
    digest = hashlib.sha256(repr([(name, _version(name)) for name in COMPUTED_BY]).encode())
    for package in packages:
        for name, content in sorted(_sources(resources.files(package), package, unrelated)):
            digest.update(name.encode() + hashlib.sha256(content).digest())
    return digest.hexdigest()[:16]


def judging_version() -> str:
    """The digest of this package."""
    return digest_of_sources(("mavdiag",))


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _sources(folder: Traversable, path: str, unrelated: tuple[str, ...]) -> Iterator[tuple[str, bytes]]:
    for entry in folder.iterdir():
        name = f"{path}/{entry.name}"
        if not name.endswith(unrelated):
            yield from _sources(entry, name, unrelated) if entry.is_dir() else [(name, entry.read_bytes())]


def judge_file(path: str, question: Question) -> Record:
    """The task of a worker: read a log and judge it. A log that cannot be read is a record with the reason.

    Raises LinkError if this process has other code, or computes with other packages, than the one that asks.
    """
    if judging_version() != question.version:
        raise LinkError("a worker has another version of mavdiag, numpy or scipy; install the same ones everywhere")
    options, baseline = question.options, _parsed(question.baseline)
    try:
        log = read_part(Path(path), options.vehicle, options.from_s, options.to_s, options.columns)
        log = replace(log, started_ns=log.started_ns or options.flown_ns)
        if options.windows_s is None and not options.figures:
            return Record(log.sha256, replace(judge(log, baseline, options.judged_share), log=""))
        flight = judge_in_full(log, baseline, options.judged_share)
    except InputError as error:
        return refused(str(error).removeprefix(f"{path}: "))
    windows = () if options.windows_s is None else windows_of(flight, options.windows_s, options.judged_share)
    kept = record_of(log, flight, baseline) if options.figures else None
    return Record(log.sha256, replace(flight.verdict, log=""), windows, kept)


_parsed = lru_cache(maxsize=2)(parse)  # a worker gets the same baseline with every task


@cache
def _adapter() -> TypeAdapter[Record]:
    return TypeAdapter(Record)


def scan(
    logs: Sequence[Named],
    question: Question,
    workers: int | str = 1,
    cache: Cache | None = None,
    warn: Callable[[str], None] = lambda text: None,
) -> Generator[Answer, None, None]:
    """The answers in the order of the logs, each as soon as it and all before it are there; they are kept as they come.

    workers, warn: as of `run_all`. Raises UsageError or LinkError if the workers cannot go on.
    """
    kept = cache or Cache()
    seen: list[str | Record] = []  # of each log so far: its digest, or its path if it is no copy, or why it has none
    digest_at, found = dict[str, str](), dict[str, Record]()
    before, answered = set[str](), set[str]()
    heads, fresh = [_told(log, head_of) for log in logs], kept.empty
    alike = Counter(head for head in heads if isinstance(head, str))

    def tasks() -> Iterator[str]:
        asked = set[str]()
        for log, head in zip(logs, heads, strict=True):
            path = str(log.path.absolute())
            alone = isinstance(head, str) and fresh and alike[head] == 1
            digest = digest_at.get(path) or (path if alone else _told(log, digest_of))  # named twice, it may grow
            seen.append(digest)
            if isinstance(digest, str) and digest not in asked:
                asked.add(digest)
                digest_at[path] = digest
                yield path

    def known(path: str) -> Record | None:
        record = None if digest_at[path] == path else kept.get(digest_at[path])
        before.update(() if record is None else (digest_at[path],))
        return record

    def ready(first: int) -> Iterator[Answer]:
        for log, head, digest in zip(logs[first:], heads[first:], seen[first:], strict=False):
            if isinstance(digest, Record):
                yield Answer(log.path, digest)
                continue
            record, copy = found.get(digest), digest in answered
            if copy and (record is None or record.digest not in ("", digest)):  # that file was changed meanwhile
                record = judge_file(str(log.path.absolute()), question)
            if record is None:
                return
            answered.add(digest)
            if isinstance(head, str) and alike[head] == 1:  # nothing else can be its copy
                found.pop(digest, None)
            yield Answer(log.path, record, known=digest in before and not copy, copy=copy)

    count = 0
    with closing(run_all(partial(judge_file, question=question), tasks(), workers, known=known, warn=warn)) as ended:
        for path, future in ended:
            digest = digest_at[path]
            found[digest] = _record(future)
            if digest not in before:
                kept.put(found[digest])
            for answer in ready(count):
                count += 1
                yield answer
    yield from ready(count)


def _told(log: Named, tell: Callable[[Path], str]) -> str | Record:
    try:
        return refused(log.trouble) if log.trouble else tell(log.path)
    except InputError as error:
        return refused(str(error).removeprefix(f"{log.path}: "))


def _record(future: Future[Record]) -> Record:
    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, MavdiagError):
        raise error
    fault = f"a fault of mavdiag or of a worker, please report it: {type(error).__name__}: {error}"
    return refused(DIED if died(error) else fault)
