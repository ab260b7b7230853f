"""The workers of a Dask cluster (edge)."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from mavdiag.archive.pool import TaskExecutor
from mavdiag.errors import LinkError, missing_extra

PATIENCE_S = 10.0


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
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
