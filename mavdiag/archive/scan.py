"""Many logs to answers (edge): each content judged once, by several workers; each log answered once, in their order.

    logs ─ digest ─▶ known? ─ no ─▶ judge ─▶ keep ─▶ answers of all logs with this content

A log that cannot be read is answered as an error; so is one whose judging ends its worker. Nothing else is lost by it.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from mavdiag.archive.job import Cache, Question, Record, digest_of, judge_file, refused
from mavdiag.archive.paths import Named
from mavdiag.archive.pool import died, run_all
from mavdiag.errors import InputError, MavdiagError
from mavdiag.judging import LogVerdict

DIED = "the process that judged it died, perhaps for want of memory; judge it alone, or a part of it (--from, --to)"


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer for a log, under its path as named. fresh: False if it was kept, or is that of a copy."""

    path: Path
    record: Record
    fresh: bool

    @property
    def verdict(self) -> LogVerdict:
        """With the name of the log."""
        return replace(self.record.verdict, log=str(self.path))


class _Task(NamedTuple):
    digest: str
    path: str


class _Found(NamedTuple):
    record: Record
    fresh: bool


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
    seen: list[str | Record] = []  # of each log so far: its digest, or why it has none
    found, finished = dict[str, _Found](), set[str]()

    def tasks() -> Iterator[_Task]:
        asked = set[str]()
        for log in logs:
            seen.append(_digest(log))
            digest = seen[-1]
            if isinstance(digest, str) and digest not in asked:
                asked.add(digest)
                yield _Task(digest, str(log.path.absolute()))

    def known(task: _Task) -> _Found | None:
        record = kept.get(task.digest)
        return None if record is None else _Found(record, fresh=False)

    def ready(first: int) -> Iterator[Answer]:
        for log, digest in zip(logs[first:], seen[first:], strict=False):
            if isinstance(digest, Record):
                yield Answer(log.path, digest, fresh=True)
            elif digest in found:
                yield Answer(log.path, *found.pop(digest))
            elif digest in finished:  # a copy; of a file that was changed before it was judged nothing is kept
                yield Answer(log.path, kept.get(digest) or judge_file(str(log.path.absolute()), question), fresh=False)
            else:
                return

    count = 0
    with closing(run_all(partial(_judged, question), tasks(), workers, known=known, warn=warn)) as ended:
        for task, future in ended:
            found[task.digest] = _result(future)
            finished.add(task.digest)
            if found[task.digest].fresh:
                kept.put(task.digest, found[task.digest].record)
            for answer in ready(count):
                count += 1
                yield answer
    yield from ready(count)


def _digest(log: Named) -> str | Record:
    try:
        return refused(log.trouble) if log.trouble else digest_of(log.path)
    except InputError as error:
        return refused(str(error).removeprefix(f"{log.path}: "))


def _judged(question: Question, task: _Task) -> _Found:
    return _Found(judge_file(task.path, question), fresh=True)


def _result(future: Future[_Found]) -> _Found:
    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, MavdiagError):
        raise error
    fault = f"a fault of mavdiag or of a worker, please report it: {type(error).__name__}: {error}"
    return _Found(refused(DIED if died(error) else fault), fresh=True)
