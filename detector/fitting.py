"""Making a baseline beside the daemon (edge): in a process of its own, so that the receive loop never stalls."""

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from datetime import UTC, datetime
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess

from detector.values import LearningFailed
from mavdiag.airframe.airframe import Airframe
from mavdiag.baseline import Baseline, sealed
from mavdiag.errors import MavdiagError
from mavdiag.telemetry import Log, Telemetry

LIMIT_S = 300.0  # longer than any fit takes on a small companion computer (our choice)
NICENESS = 10  # the receive loop comes first

Outcome = Baseline | LearningFailed


@dataclass(frozen=True, slots=True, eq=False)
class FittingJob:
    """One vehicle's healthy flight."""

    vehicle: int  # system id
    airframe: Airframe  # what is known of it; its name is the one that the baseline gets
    profile: str  # of its link
    telemetry: Telemetry  # the flight
    parameters: Mapping[str, float] = field(default_factory=dict)  # of its autopilot, by name
    accept: bool = False  # a baseline of grade D is taken, too


def fit_baseline(job: FittingJob) -> Outcome:
    """Make a baseline here and now, as `mavdiag identify` does by default."""
    # Imported by the process that fits, not by the daemon: it brings the identification with it.
    from mavdiag.learning import LearnOptions, learn
    from mavdiag.learning.suspicions import accepted

    created = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    flight = (f"vehicle {job.vehicle}, live, {created}", "", job.profile, job.telemetry)
    log = Log(*flight, started_ns=time.time_ns(), parameters=dict(job.parameters))
    try:
        baseline = learn([log], LearnOptions(airframe=job.airframe), created=created)
        if not job.accept:
            baseline = accepted(baseline, "accept = true")
    except MavdiagError as error:
        return LearningFailed(str(error))
    provenance = baseline.provenance.model_copy(update={"vehicle": job.vehicle})
    return sealed(baseline.model_copy(update={"provenance": provenance}))


def _prepare() -> None:  # the process: Ctrl-C goes to both, but is the daemon's business
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    os.nice(NICENESS)


class ProcessFitter:
    """One process that fits, one job after the other; it ends when nothing is left to do."""

    def __init__(self, limit_s: float = LIMIT_S, clock: Callable[[], float] = time.monotonic) -> None:
        self._limit_s, self._clock = limit_s, clock
        self._pool: ProcessPoolExecutor | None = None
        self._processes: list[BaseProcess] = []  # of the pool, which begins them with its first job
        self._running: dict[int, tuple[Future[Outcome], float]] = {}

    def begin(self, job: FittingJob) -> None:
        """Start on a job; one at a time for each vehicle."""
        # The process inherits the block, so that Ctrl-C cannot end it before it is prepared. The tracker, which
        # multiprocessing starts before the first process, would lift the block again.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _prepare)
        others = multiprocessing.active_children()
        self._running[job.vehicle] = (self._pool.submit(fit_baseline, job), self._clock())
        self._processes += [one for one in multiprocessing.active_children() if one not in others]
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def poll(self) -> list[tuple[int, Outcome]]:
        """Outcomes since the last call. A job that takes too long has failed, and those behind it with it."""
        if any(self._clock() - since > self._limit_s for _, since in self._running.values()):
            self._end_process()
        done = [(vehicle, _outcome(future)) for vehicle, (future, _) in self._running.items() if future.done()]
        for vehicle, _ in done:
            del self._running[vehicle]
        if self._pool is not None and not self._running:
            self._pool.shutdown(wait=False)
            self._pool = None
            self._processes.clear()
        return done

    def close(self) -> None:
        """Give up what is not done."""
        self._end_process()
        self._running.clear()

    def _end_process(self) -> None:
        for process in self._processes:
            process.terminate()
        self._processes.clear()
        if self._pool is not None:
            self._pool.shutdown(wait=False)
            self._pool = None


def _outcome(future: "Future[Outcome]") -> Outcome:
    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, BrokenProcessPool):
        return LearningFailed("the fitting process ended early or took too long; fly on to try again")
    return LearningFailed(f"the fit failed ({type(error).__name__}: {error}); fly on to try again")
