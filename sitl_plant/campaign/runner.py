"""Run a campaign: the tasks of a plan over a pool of processes or a Dask cluster, with results kept as they come.

Every result is a line of JSON under a key, the digest of all that it follows from: the campaign's seed, the task, what
was learnt for it, and the sources of both packages. What is in the file already is not flown again; lines of other
campaigns, or of another version, stay in the file and are not counted.
"""

import hashlib
import json
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache, partial
from importlib import resources
from importlib.resources.abc import Traversable
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, TypeAlias, TypeVar

from pydantic import Field, TypeAdapter, ValidationError

from mavdiag.errors import LinkError, UsageError
from sitl_plant.campaign.plan import FlightTask, LearnTask, Plan
from sitl_plant.campaign.worker import FlightLine, LearnLine, fly_task, learn_task

__all__ = ["Crew", "Journal", "Results", "dask_crew", "local_crew", "run_campaign", "source_key", "task_key"]

Line: TypeAlias = LearnLine | FlightLine
Made = TypeVar("Made", LearnLine, FlightLine)
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
UNRELATED = (
    "commands",
    "__main__",
    "_command",
    "campaign.py",
    "campaign_summary",
    "campaign_tables",
)  # cannot change a result

_LINE: TypeAdapter[Line] = TypeAdapter(Annotated[Line, Field(discriminator="record")])


@cache
def source_key() -> str:
    """A digest of the sources that results follow from: results of another version are never mixed in."""
    digest = hashlib.sha256()
    for package in ("mavdiag", "sitl_plant"):
        for name, content in sorted(_sources(resources.files(package), package)):
            digest.update(name.encode())
            digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()[:16]


def _sources(folder: Traversable, path: str) -> Iterator[tuple[str, bytes]]:
    for entry in folder.iterdir():
        name = f"{path}/{entry.name}"
        if any(part in name for part in UNRELATED):
            continue
        if entry.is_dir():
            yield from _sources(entry, name)
        elif entry.name.endswith((".py", ".toml")):
            yield name, entry.read_bytes()


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
    """What a plan came to, in the order of the plan.

    reused: how many results were in the file already. others: lines of other campaigns, or of another version.
    """

    plan: Plan
    learnt: tuple[LearnLine, ...]
    flights: tuple[FlightLine, ...]
    reused: int
    others: int


@dataclass(frozen=True, slots=True)
class Crew:
    """Who does the work: an executor, and how many tasks to keep under way so that nobody waits."""

    executor: Executor
    under_way: int


@contextmanager
def local_crew(workers: int) -> Iterator[Crew]:
    """Worker processes of this machine, each with one thread of arithmetic, so that results do not depend on it."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_ignore_interrupt)
    try:
        yield Crew(pool, 2 * workers)
    except BrokenExecutor as error:
        raise UsageError("a worker process died, perhaps for want of memory; run again with fewer --workers") from error
    finally:
        pool.shutdown(cancel_futures=True)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _ignore_interrupt() -> None:
    """Ctrl-C goes to the whole group of processes; the first of them decides."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def dask_crew(address: str) -> Iterator[Crew]:
    """The workers of a Dask scheduler. They need the same version of this package, with numba.

    Raises UsageError without Dask, LinkError if the scheduler cannot be reached.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError("--scheduler needs Dask: install mavdiag[fleet]") from error
    try:
        client = Client(address, timeout=10)
    except (OSError, TimeoutError, ValueError) as error:
        raise LinkError(f"no Dask scheduler at {address} ({error}); start one with `dask scheduler`") from error
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise LinkError(f"the Dask scheduler at {address} has no workers; start some with `dask worker {address}`")
        yield Crew(client.get_executor(pure=False), 2 * threads)


def run_campaign(
    plan: Plan,
    journal: Journal,
    crew: Crew,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> Results:
    """Learn what is to be learnt, then fly. progress: is told the stage, and how many tasks of it are done.

    The results do not depend on the crew; only the order of the lines in the file does.
    """
    seed = plan.design.seed
    learning = {task_key(seed, task): task for task in plan.learning}
    flights = {task_key(seed, task): task for task in plan.flights}
    reused = len((learning.keys() | flights.keys()) & journal.known.keys())
    others = len(journal.known) - reused + journal.unread

    def learn_jobs() -> Iterator[Callable[[], LearnLine]]:
        for key, task in learning.items():
            if key not in journal.known:
                yield partial(learn_task, key, seed, task)

    def flight_jobs() -> Iterator[Callable[[], FlightLine]]:
        for key, task in flights.items():
            if key not in journal.known:
                learnt = _known(journal, task_key(seed, task.learnt), LearnLine)
                yield partial(fly_task, key, seed, task, learnt)

    for stage, keys, jobs in (("learning", learning, learn_jobs()), ("flying", flights, flight_jobs())):
        done = len(keys.keys() & journal.known.keys())
        progress(stage, done, len(keys))
        for line in _as_completed(crew, jobs):
            journal.add(line)
            done += 1
            progress(stage, done, len(keys))
    return Results(
        plan,
        tuple(_known(journal, key, LearnLine) for key in learning),
        tuple(_known(journal, key, FlightLine) for key in flights),
        reused,
        others,
    )


def _known(journal: Journal, key: str, kind: type[Made]) -> Made:
    line = journal.known[key]
    if not isinstance(line, kind):
        raise UsageError(f"result {key} is of another kind; start anew with --fresh")
    return line


def _as_completed(crew: Crew, jobs: Iterable[Callable[[], Line]]) -> Iterator[Line]:
    """The results of jobs as they come, with only so many handed out at a time: memory does not grow with the plan."""
    waiting: set[Future[Line]] = set()
    for job in jobs:
        waiting.add(crew.executor.submit(job))
        if len(waiting) >= crew.under_way:
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            yield from _lines(done)
    while waiting:
        done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
        yield from _lines(done)


def _lines(done: set[Future[Line]]) -> list[Line]:
    return sorted((future.result() for future in done), key=lambda line: line.key)
