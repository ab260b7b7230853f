"""Workers (edge): processes of this machine, those of a Dask cluster, or none."""

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ParamSpec, TypeVar

from mavdiag.errors import InputError, LinkError, missing_extra

P = ParamSpec("P")
T = TypeVar("T")
#: Of a worker: one thread of arithmetic; and glibc keeps the arrays' memory for the next log instead of giving it back
#: to the system, which makes a third of the page faults and half of the system's time (measured).
ENVIRONMENT: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"),
        "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
        "MALLOC_TRIM_THRESHOLD_": str(64 << 20),
    }
)
PATIENCE_S = 10.0  # for a scheduler to answer


@dataclass(frozen=True, slots=True)
class TaskExecutor:
    """Where the tasks run.

    pool: processes, a cluster, or none. in_flight: how many tasks to submit at a time, so that no worker waits.
    killed: errors that say that a task's workers died, one after the other.
    manned: whether there is any worker; a pool of processes tells by an error if there is none.
    """

    pool: Executor
    in_flight: int
    killed: tuple[type[Exception], ...] = ()
    manned: Callable[[], bool] = lambda: True


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
        for _ in range(workers):  # a pool starts one more with each task, while none is idle
            pool.submit(os.getpid)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _settle() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


class _Here(Executor):
    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Run it at once; what is no InputError is raised here and now."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except InputError as error:
            future.set_exception(error)
        return future


@contextmanager
def in_this_process() -> Iterator[TaskExecutor]:
    """No worker: each task is done when it is submitted."""
    yield TaskExecutor(_Here(), 1)


@contextmanager
def dask_executor(address: str) -> Iterator[TaskExecutor]:
    """The workers of a Dask scheduler. They need the same version of this package and of what the tasks need.

    What a lost worker had to do is done again by another one. Raises UsageError without Dask, LinkError if the
    scheduler cannot be reached or has no workers.
    """
    try:
        from distributed import Client, KilledWorker
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

    with _without_tracebacks(), client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise LinkError(f"the Dask scheduler at {address} has no workers; start some with `dask worker {address}`")
        yield TaskExecutor(client.get_executor(pure=False), 2 * threads, (KilledWorker,), manned)


@contextmanager
def _without_tracebacks() -> Iterator[None]:
    """Of a connection that is lost: what follows from it is an error of ours."""
    levels = {name: logging.getLogger(name).level for name in ("distributed", "distributed.client")}
    for name in levels:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)
