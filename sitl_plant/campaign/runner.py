"""Run a campaign: the tasks of a plan over a pool of processes or a Dask cluster, with results kept as they come.

Every result is a line of JSON under a key, the digest of all that it follows from: the campaign's seed, the task, what
was learnt for it, and the sources of both packages. What is in the file already is not flown again; lines of other
campaigns, or of another version, stay in the file and are not counted.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Annotated, TypeAlias, TypeVar

from pydantic import Field, TypeAdapter, ValidationError

from mavdiag.archive import pool
from mavdiag.archive.cluster import dask_executor
from mavdiag.archive.pool import TaskExecutor
from mavdiag.archive.sources import digest_of_sources
from mavdiag.errors import UsageError
from sitl_plant.campaign.plan import FlightTask, LearnTask, Plan
from sitl_plant.campaign.worker import FlightResult, LearnResult, fly_task, learn_task

__all__ = [
    "Journal",
    "Results",
    "TaskExecutor",
    "dask_executor",
    "local_executor",
    "run_campaign",
    "source_key",
    "task_key",
]

Line: TypeAlias = LearnResult | FlightResult
Made = TypeVar("Made", LearnResult, FlightResult)
# What cannot change a result: bytecode, and the edges.
UNRELATED = (
    *("__pycache__", "py.typed", "__main__.py", "mavdiag/cli.py", "mavdiag/commands", "mavdiag/demo"),
    *(
        f"sitl_plant/campaign/{name}.py"
        for name in ("command", "condition_rows", "intervals", "runner", "summary", "tables")
    ),
)

_LINE: TypeAdapter[Line] = TypeAdapter(Annotated[Line, Field(discriminator="record")])


@cache
def source_key() -> str:
    """A digest of the sources and data that results follow from: results of another version are never mixed in."""
    return digest_of_sources(("mavdiag", "sitl_plant"), UNRELATED)


def task_key(seed: int, task: LearnTask | FlightTask) -> str:
    """What a result is kept under."""
    content = json.dumps([source_key(), seed, type(task).__name__, asdict(task)], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:20]


class Journal:
    """The file of results, one JSON object a line, in order of completion. A torn last line is no result.

    Raises UsageError if the file cannot be used.
    """

    def __init__(self, path: Path, fresh: bool = False) -> None:
        self._path = path
        self.known: dict[str, Line] = {}
        self.unread = 0
        try:
            text = "" if fresh or not path.exists() else path.read_text(encoding="utf-8")
            self._file = path.open("w" if fresh else "a", encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(f"cannot use {path} for results ({error}); choose another --output") from error
        for row in text.splitlines():
            try:
                line = _LINE.validate_json(row)
            except ValidationError:
                self.unread += 1
                continue
            self.known[line.key] = line
        if text and not text.endswith("\n"):
            self._file.write("\n")

    def add(self, line: Line) -> None:
        """Keep a result, on disk at once."""
        self.known[line.key] = line
        self._file.write(json.dumps(asdict(line)) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


@dataclass(frozen=True, slots=True)
class Results:
    """The results of a plan, in its order.

    reused: how many results were in the file already.
    others: lines of other campaigns, or of another version.
    """

    plan: Plan
    learnt: tuple[LearnResult, ...]
    flights: tuple[FlightResult, ...]
    reused: int
    others: int


@contextmanager
def local_executor(workers: int) -> Iterator[TaskExecutor]:
    """Worker processes of this machine. Raises UsageError if one of them died."""
    try:
        with pool.local_executor(workers) as executor:
            yield executor
    except BrokenExecutor as error:
        raise UsageError("a worker process died, perhaps for want of memory; run again with fewer --workers") from error


def run_campaign(
    plan: Plan,
    journal: Journal,
    executor: TaskExecutor,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> Results:
    """Learn what is to be learnt, then fly.

    progress: called with the stage, how many of its tasks are done, and how many there are.
    The results do not depend on the executor; only the order of the lines in the file does.
    """
    seed = plan.design.seed
    learning = {task_key(seed, task): task for task in plan.learning}
    flights = {task_key(seed, task): task for task in plan.flights}
    reused = len((learning.keys() | flights.keys()) & journal.known.keys())
    others = len(journal.known) - reused + journal.unread

    def learn_jobs() -> Iterator[Callable[[], LearnResult]]:
        for key, task in learning.items():
            if key not in journal.known:
                yield partial(learn_task, key, seed, task)

    def flight_jobs() -> Iterator[Callable[[], FlightResult]]:
        for key, task in flights.items():
            if key not in journal.known:
                learnt = _known(journal, task_key(seed, task.learnt), LearnResult)
                yield partial(fly_task, key, seed, task, learnt)

    for stage, keys, jobs in (("learning", learning, learn_jobs()), ("flying", flights, flight_jobs())):
        done = len(keys.keys() & journal.known.keys())
        progress(stage, done, len(keys))
        for line in _as_completed(executor, jobs):
            journal.add(line)
            done += 1
            progress(stage, done, len(keys))
    return Results(
        plan,
        tuple(_known(journal, key, LearnResult) for key in learning),
        tuple(_known(journal, key, FlightResult) for key in flights),
        reused,
        others,
    )


def _known(journal: Journal, key: str, kind: type[Made]) -> Made:
    line = journal.known[key]
    if not isinstance(line, kind):
        raise UsageError(f"result {key} is of another kind; start anew with --fresh")
    return line


def _as_completed(executor: TaskExecutor, jobs: Iterable[Callable[[], Line]]) -> Iterator[Line]:
    """The results of jobs as they come, with only so many handed out at a time: memory does not grow with the plan."""
    waiting: set[Future[Line]] = set()
    for job in jobs:
        waiting.add(executor.pool.submit(job))
        if len(waiting) >= executor.in_flight:
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            yield from _lines(done)
    while waiting:
        done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
        yield from _lines(done)


def _lines(done: set[Future[Line]]) -> list[Line]:
    return sorted((future.result() for future in done), key=lambda line: line.key)
