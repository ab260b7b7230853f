"""A Dask cluster of processes on loopback, for tests and benchmarks. What is started here is ended by its own id."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["cluster"]

PATIENCE_S = 60.0
# Of a worker, as docs/operating.md advises: threads share their memory, and Dask does not keep where its time goes.
LEAN = {"MALLOC_ARENA_MAX": "1", "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False"}


@contextmanager
def cluster(workers: int) -> Iterator[tuple[str, list[subprocess.Popen[str]]]]:
    """A Dask scheduler and its workers on loopback: its address and their processes."""
    quiet = {**os.environ, "DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "error"}
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "scheduler.json"
        local = ("--host", "127.0.0.1", "--no-dashboard")
        program = [sys.executable, "-m", "distributed.cli.dask_scheduler", *local, "--port", "0"]
        started = [subprocess.Popen([*program, "--scheduler-file", str(told)], env=quiet, text=True)]
        try:
            until = time.monotonic() + PATIENCE_S
            while not told.exists() or not told.read_text().endswith("}"):  # it is written in parts
                assert time.monotonic() < until, "the scheduler did not start"
                time.sleep(0.1)
            address = json.loads(told.read_text())["address"]
            single = ("--nthreads", "1", "--no-nanny", "--local-directory", folder)
            program = [sys.executable, "-m", "distributed.cli.dask_worker", address, *local, *single]
            environment = {**quiet, **LEAN, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
            started += [subprocess.Popen(program, env=environment, text=True) for _ in range(workers)]
            wait_for(address, workers)
            yield address, started
        finally:
            for one in started[::-1]:
                one.terminate()
                one.wait()


def wait_for(address: str, workers: int) -> None:
    """Until so many workers are there."""
    from distributed import Client

    with Client(address, timeout=PATIENCE_S) as client:
        until = time.monotonic() + PATIENCE_S
        while len(client.nthreads()) < workers:
            assert time.monotonic() < until, "the workers did not start"
            time.sleep(0.1)
