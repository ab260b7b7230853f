"""Making a baseline beside the daemon (edge): in a process of its own, so that the receive loop never stalls."""

import contextlib
import multiprocessing
import os
import signal
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from detector.values import FitOutcome, Learn
from mavdiag.airframe.airframe import Airframe
from mavdiag.baseline import sealed
from mavdiag.errors import MavdiagError
from mavdiag.telemetry import Log

LIMIT_S = 300.0  # longer than any fit takes on a small companion computer (our choice)
NICENESS = 10  # the receive loop comes first


@dataclass(frozen=True, slots=True, eq=False)
class FittingJob:
    """One vehicle's healthy flight."""

    vehicle: int  # system id
    airframe: Airframe  # what is known of it; its name is the one that the baseline gets
    flight: Learn
    accept: bool = False  # a baseline of grade D is taken, too


def fit_baseline(job: FittingJob) -> FitOutcome:
    """Make a baseline here and now, as `mavdiag identify` does by default."""
    # Imported by the process that fits, not by the daemon: it brings the identification with it.
    from mavdiag.learning import LearnOptions, learn
    from mavdiag.learning.suspicions import accepted

    created = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    named, flight = f"vehicle {job.vehicle}, live, {created}", job.flight
    log = Log(named, "", flight.profile, flight.telemetry, time.time_ns(), parameters=dict(flight.parameters))
    try:
        baseline = learn([log], LearnOptions(airframe=job.airframe), created=created)
        if not job.accept:
            baseline = accepted(baseline, "accept = true")
    except MavdiagError as error:
        return str(error)
    provenance = baseline.provenance.model_copy(update={"vehicle": job.vehicle})
    return sealed(baseline.model_copy(update={"provenance": provenance}))


def _work(job: FittingJob, answer: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to both processes, but is the daemon's business
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    os.nice(NICENESS)
    answer.send(fit_baseline(job))


class ProcessFitter:
    """Fits one job after the other, each in a process of its own."""

    def __init__(self) -> None:
        self._waiting: list[FittingJob] = []
        self._running: tuple[int, BaseProcess, Connection, float] | None = None

    def begin(self, job: FittingJob) -> None:
        """Start on a job, or put it behind the present one."""
        self._waiting.append(job)
        self._next()

    def poll(self) -> list[tuple[int, FitOutcome]]:
        """Outcomes since the last call, by system id. A job that takes too long has failed."""
        if self._running is None:
            return []
        vehicle, _, answer, since_s = self._running
        outcome: FitOutcome = "the fitting process ended early or took too long; fly on to try again"
        if answer.poll():
            with contextlib.suppress(EOFError):  # it ended without an answer
                outcome = answer.recv()
        elif time.monotonic() - since_s <= LIMIT_S:
            return []
        self._end_process()
        self._next()
        return [(vehicle, outcome)]

    def close(self) -> None:
        """Give up what is not done."""
        self._waiting.clear()
        self._end_process()

    def _next(self) -> None:
        if self._running is not None or not self._waiting:
            return
        job, context = self._waiting.pop(0), multiprocessing.get_context("spawn")
        answer, end = context.Pipe(duplex=False)
        # The process inherits the block, so that Ctrl-C cannot end it before it ignores that. The tracker, which
        # multiprocessing starts before the first process, would lift the block again.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        process = context.Process(target=_work, args=(job, end), daemon=True)
        process.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        end.close()
        self._running = (job.vehicle, process, answer, time.monotonic())

    def _end_process(self) -> None:
        if self._running is not None:
            _, process, answer, _ = self._running
            answer.close()
            process.terminate()
            process.join()
            self._running = None
