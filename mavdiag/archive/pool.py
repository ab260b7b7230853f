"""Many tasks on workers (edge): processes of this machine, those of a Dask cluster, or this process alone."""

import gc
import logging
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from mavdiag.errors import LinkError, UsageError, missing_extra
from mavdiag.storage import COLLECT_AT, give_back, keep_freed

Task = TypeVar("Task")
Result = TypeVar("Result")
# Of a worker: one thread of arithmetic; and glibc keeps the arrays' memory for the next task instead of giving it back
# to the system, which makes a third of the page faults and half of the system's time (measured). It loads nothing that
# lies in the present folder.
ENVIRONMENT = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"),
    "PYTHONSAFEPATH": "1",
    "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(64 << 20),
}
KEPT_BYTES = 1 << 20  # of a worker of Dask, to whose memory nobody else looks (our choice)
PATIENCE_S = 10.0  # for a scheduler to answer
QUIET_S = 15.0  # without an answer, until it is looked whether there is any worker (our choice)


@dataclass(frozen=True, slots=True)
class TaskExecutor:
    """Where tasks run. in_flight: how many are handed out at a time. manned: whether there is any worker.

    sent: what goes to the pool in place of a function. A Dask scheduler unpacks what it hands on, and would load all
    that judges (40 MB) for a function of ours.
    """

    pool: Executor
    in_flight: int
    manned: Callable[[], bool] = lambda: True
    sent: Callable[[Callable[..., Any]], Callable[..., Any]] = lambda function: function


def run_all(
    function: Callable[[Task], Result],
    tasks: Iterable[Task],
    workers: int | str,
    *,
    known: Callable[[Task], Result | None] = lambda task: None,
    warn: Callable[[str], None] = lambda text: None,
) -> Generator[tuple[Task, Future[Result]], None, None]:
    """Call a function for every task; give each task with its finished future, in the order in which they end.

    workers: how many processes of this machine (1: this process itself), or the address of a Dask scheduler.
    known: the result of a task that need not run, else None. warn: is told once if a cluster has no worker left.
    Tasks are taken as workers get free. What a worker had that died is run again, each task alone; the future of one
    that ends this worker, too, holds BrokenExecutor. Raises UsageError or LinkError if there are no workers.
    """
    running = dict[Future[Result], Task]()
    deserted = False
    with ExitStack() as stack:
        executor: TaskExecutor | None = None

        def ended(most: int) -> Iterator[tuple[Task, Future[Result]]]:
            """Those that end until only so many are left."""
            nonlocal executor, deserted
            while len(running) > most:
                done, _ = wait(running, QUIET_S, FIRST_COMPLETED)
                if not (done or deserted or executor is None or executor.manned()):
                    deserted = True
                    warn("no worker is left; waiting for another one (Ctrl-C stops, what is finished is kept)")
                if any(future.cancelled() for future in done):
                    raise LinkError(
                        "the scheduler went away or gave up the work; start it, and run this again to go on"
                    )
                broken = {future for future in done if isinstance(future.exception(), BrokenExecutor)}
                yield from [(running.pop(future), future) for future in done - broken]
                if broken:
                    stack.close()
                    executor, lost = None, list(running.values())
                    running.clear()
                    yield from ((task, _alone(function, task)) for task in lost)

        for task in tasks:
            result = known(task)
            if result is not None or workers == 1:
                yield task, _here(function, task, result)
                continue
            if executor is not None:
                yield from ended(executor.in_flight - 1)
            if executor is None:  # not yet, or it broke
                opened = dask_executor(workers) if isinstance(workers, str) else local_executor(workers)
                executor = stack.enter_context(opened)
            running[_submitted(executor, function, task)] = task
        yield from ended(0)


def _here(function: Callable[[Task], Result], task: Task, known: Result | None) -> Future[Result]:
    future = Future[Result]()
    try:
        future.set_result(function(task) if known is None else known)
    except MemoryError as error:  # the next one may need less
        future.set_exception(error)
    return future


def _submitted(executor: TaskExecutor, function: Callable[[Task], Result], task: Task) -> Future[Result]:
    try:
        return executor.pool.submit(executor.sent(function), task)
    except BrokenExecutor as error:
        future = Future[Result]()
        future.set_exception(error)
        return future


def _alone(function: Callable[[Task], Result], task: Task) -> Future[Result]:
    with local_executor(1) as executor:
        future = executor.pool.submit(function, task)
        wait([future])
        return future


def died(error: BaseException) -> bool:
    """Whether a future's error says that its worker died, or had too little memory."""
    return isinstance(error, (BrokenExecutor, MemoryError)) or type(error).__name__ == "KilledWorker"  # of Dask


@contextmanager
def local_executor(workers: int) -> Iterator[TaskExecutor]:
    """Worker processes of this machine, each with one thread of arithmetic, so that results do not depend on it.

    They end at once if the block is left by an exception or if this process dies. Ctrl-C is for this process alone.
    """
    before = {name: os.environ.get(name) for name in ENVIRONMENT}
    others = set(multiprocessing.active_children())
    os.environ.update(ENVIRONMENT)
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_settle)
    whole = False
    try:
        _start(pool, workers)
        yield TaskExecutor(pool, 2 * workers)
        whole = True
    finally:
        for process in set() if whole else set(multiprocessing.active_children()) - others:
            process.terminate()
        pool.shutdown(cancel_futures=True)
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _start(pool: Executor, workers: int) -> None:
    """Start the workers with SIGINT blocked, which they inherit: Ctrl-C goes to the whole group of processes."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        started = [pool.submit(os.getpid) for _ in range(workers)]  # one more starts with each while none is idle
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    try:
        started[0].result()
    except BrokenExecutor as error:
        raise UsageError("the worker processes end before they have anything to do; use --jobs 1") from error


def _settle() -> None:
    gc.set_threshold(COLLECT_AT)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def dask_executor(address: str) -> Iterator[TaskExecutor]:
    """The workers of a Dask scheduler, which need the same versions of this package and of what the tasks need.

    Raises UsageError without Dask, LinkError if the scheduler cannot be reached or has no workers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise missing_extra("--scheduler", "Dask", "fleet") from error
    try:
        client = Client(address, timeout=PATIENCE_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise LinkError(f"no Dask scheduler at {address} ({error}); start one with `dask scheduler`") from error

    def manned() -> bool:
        try:
            return bool(client.nthreads())
        except (OSError, TimeoutError):  # then the scheduler has gone, and the tasks say so
            return True

    for name in ("distributed", "distributed.client"):  # of a connection that is lost: what follows is an error of ours
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise LinkError(f"the Dask scheduler at {address} has no workers; start some with `dask worker {address}`")
        pool = client.get_executor(pure=False)
        yield TaskExecutor(pool, 2 * threads, manned, lambda function: partial(_called, pickle.dumps(function)))


def _called(function: bytes, task: Any) -> Any:
    keep_freed(KEPT_BYTES)
    try:
        return pickle.loads(function)(task)
    finally:
        give_back()
