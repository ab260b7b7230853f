"""Making a baseline beside the daemon (edge): in a process of its own, so that the receive loop never stalls."""

import hashlib
import multiprocessing
import os
import queue
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Protocol, TypeAlias

from detector.values import Learned, LearningFailed
from mavdiag.errors import MavdiagError
from mavdiag.telemetry import Telemetry

__all__ = ["Fitter", "FittingJob", "Outcome", "ProcessFitter", "fit_baseline"]

LIMIT_S = 300.0  # longer than any fit takes on a small companion computer (our choice)
NICENESS = 10  # the receive loop comes first

Outcome: TypeAlias = Learned | LearningFailed


@dataclass(frozen=True, slots=True, eq=False)
class FittingJob:
    """One vehicle's healthy flight. airframe: the name that the baseline gets."""

    vehicle: int
    airframe: str
    profile: str
    telemetry: Telemetry


class Fitter(Protocol):
    """Whoever makes baselines: `begin` returns at once, `poll` hands out what is done."""

    def begin(self, job: FittingJob) -> None:
        """Start on a job."""

    def poll(self) -> list[tuple[int, Outcome]]:
        """Outcomes since the last call, by vehicle."""

    def close(self) -> None:
        """Give up what is not done."""


def fit_baseline(job: FittingJob) -> Outcome:
    """Make a baseline here and now."""
    # Imported by the process that fits, not by the daemon: it brings the identification with it.
    from mavdiag.learning import Flight, LearnOptions, learn

    created = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    name = f"vehicle {job.vehicle}, live, {created}"
    flight = Flight(name, _digest(job.telemetry), job.profile, job.telemetry)
    try:
        return Learned(learn([flight], LearnOptions(airframe=job.airframe), created=created))
    except MavdiagError as error:
        return LearningFailed(str(error))


def _digest(telemetry: Telemetry) -> str:
    """SHA-256 over signals, times and values: what stands for a file's when there is none."""
    digest = hashlib.sha256()
    for series in sorted(telemetry.series, key=lambda series: series.signal):
        for part in (series.signal.encode(), series.t_ns.tobytes(), series.values.tobytes()):
            digest.update(part)
    return digest.hexdigest()


def _work(connection: Connection) -> None:
    """The process: take a job, send its outcome. Ctrl-C goes to both processes, but is the daemon's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICENESS)
    connection.send(fit_baseline(connection.recv()))


class ProcessFitter:
    """One process a job. Handing the job over takes a thread, because a pipe holds less than a flight."""

    def __init__(self, limit_s: float = LIMIT_S, clock: Callable[[], float] = time.monotonic) -> None:
        self._limit_s, self._clock = limit_s, clock
        self._context = multiprocessing.get_context("spawn")
        self._running: dict[int, tuple[BaseProcess, float]] = {}
        self._done: queue.SimpleQueue[tuple[int, Outcome]] = queue.SimpleQueue()

    def begin(self, job: FittingJob) -> None:
        """Start on a job; one at a time for each vehicle."""
        near, far = self._context.Pipe()
        process = self._context.Process(target=_work, args=(far,), name=f"fit vehicle {job.vehicle}", daemon=True)
        # The child inherits the block, so that Ctrl-C finds it deaf from its first instruction on. The tracker, which
        # multiprocessing starts before the first child, would lift the block again.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        process.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        far.close()
        self._running[job.vehicle] = (process, self._clock())
        threading.Thread(target=self._converse, args=(near, process, job), daemon=True).start()

    def poll(self) -> list[tuple[int, Outcome]]:
        """Outcomes since the last call. A job that takes too long has failed."""
        for process, since in self._running.values():
            if self._clock() - since > self._limit_s:
                process.terminate()  # ends the conversation, which then reports
        done: list[tuple[int, Outcome]] = []
        while not self._done.empty():
            vehicle, outcome = self._done.get()
            if self._running.pop(vehicle, None) is not None:
                done.append((vehicle, outcome))
        return done

    def close(self) -> None:
        """Give up what is not done."""
        for process, _ in self._running.values():
            process.terminate()
        self._running.clear()

    def _converse(self, connection: Connection, process: BaseProcess, job: FittingJob) -> None:
        outcome: Outcome
        try:
            connection.send(job)
            outcome = connection.recv()
        except (EOFError, OSError):
            outcome = LearningFailed("the fitting process ended early or took too long; restart to try again")
        connection.close()
        process.join()
        self._done.put((job.vehicle, outcome))
