"""Making a baseline beside the daemon (edge): in a process of its own, so that the receive loop never stalls."""

import os
import pickle
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import UTC, datetime

from detector.process import begun
from detector.values import FitOutcome, Learn
from mavdiag.airframe.airframe import Airframe
from mavdiag.baseline import sealed
from mavdiag.errors import MavdiagError
from mavdiag.telemetry import Log

LIMIT_S = 300.0  # longer than any fit takes on a small companion computer (our choice)
NICENESS = 10  # the receive loop comes first


def fit_baseline(vehicle: int, airframe: Airframe, flight: Learn, accept: bool) -> FitOutcome:
    """Make a baseline here and now, as `mavdiag identify` does by default.

    airframe: what is known of the vehicle, with the baseline's name. accept: a baseline of grade D is taken, too.
    """
    # Imported by the process that fits, not by the daemon: it brings the identification with it.
    from mavdiag.learning import LearnOptions, learn
    from mavdiag.learning.suspicions import accepted

    created = datetime.now(UTC).isoformat(timespec="seconds")
    named = f"vehicle {vehicle}, live, {created}"
    log = Log(named, "", flight.profile, flight.telemetry, time.time_ns(), parameters=dict(flight.parameters))
    try:
        baseline = learn([log], LearnOptions(airframe=airframe), created=created)
        if not accept:
            baseline = accepted(baseline, "accept = true")
    except MavdiagError as error:
        return str(error)
    provenance = baseline.provenance.model_copy(update={"vehicle": vehicle})
    return sealed(baseline.model_copy(update={"provenance": provenance}))


class ProcessFitter:
    """Fits one job after the other, each in a process of its own. A thread starts it and hands the flight over.

    That may take seconds, and whatever goes wrong there is an outcome.
    """

    def __init__(self) -> None:
        self._fits: list[tuple[int, Future[FitOutcome]]] = []  # by system id, in order
        self._lock = threading.Lock()  # held while a process starts
        self._closed = False
        self._process: subprocess.Popen[bytes] | None = None  # at work
        self._thread = ThreadPoolExecutor(1, "fitting")
        self._thread.submit(int)  # it begins with the daemon: to start a thread in flight may fail

    def begin(self, vehicle: int, airframe: Airframe, flight: Learn, accept: bool = False) -> None:
        """Start on a vehicle's healthy flight, or put it behind the present one. The others as in `fit_baseline`."""
        self._fits.append((vehicle, self._thread.submit(self._fit, (vehicle, airframe, flight, accept))))

    def poll(self) -> list[tuple[int, FitOutcome]]:
        """Outcomes since the last call, by system id."""
        done = [one for one in self._fits if one[1].done()]
        self._fits = self._fits[len(done) :]
        return [(vehicle, _outcome(fit)) for vehicle, fit in done]

    def close(self) -> None:
        """Give up what is not done."""
        self._thread.shutdown(wait=False, cancel_futures=True)
        with self._lock:
            self._closed = True
            if self._process is not None:
                self._process.kill()

    def _fit(self, job: tuple[int, Airframe, Learn, bool]) -> FitOutcome:
        with self._lock:
            if self._closed:
                return "the daemon stops"
            self._process = process = begun("detector.fitting")
        with process:
            try:
                answer, _ = process.communicate(pickle.dumps(job), LIMIT_S)
            finally:
                self._process = None
                process.kill()
        if process.returncode:
            raise ChildProcessError(f"exit code {process.returncode}")
        outcome: FitOutcome = pickle.loads(answer)
        return outcome


def _outcome(fit: Future[FitOutcome]) -> FitOutcome:
    if (error := fit.exception()) is not None:
        return f"the fitting process failed or took too long ({error!r}); fly on to try again"
    return fit.result()


if __name__ == "__main__":
    os.nice(NICENESS)
    sys.stdout.buffer.write(pickle.dumps(fit_baseline(*pickle.load(sys.stdin.buffer))))
