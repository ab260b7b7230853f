"""The fit beside the daemon makes the baseline that `mavdiag identify` makes."""

import multiprocessing
import time

from detector.fitting import FittingJob, ProcessFitter
from detector.values import Learn
from mavdiag.airframe.airframe import Airframe
from mavdiag.telemetry import Telemetry


def test_only_its_own_process_is_ended() -> None:
    context = multiprocessing.get_context("spawn")
    other = context.Process(target=time.sleep, args=(60.0,))
    other.start()
    try:
        fitter = ProcessFitter()
        fitter.begin(FittingJob(1, Airframe(), Learn("qdrone2", Telemetry())))
        own = [one for one in multiprocessing.active_children() if one.pid != other.pid]
        assert len(own) == 1
        fitter.close()
        ended_by = time.monotonic() + 10.0
        while (
            own[0].is_alive() and time.monotonic() < ended_by
        ):  # the pool's thread waits for it, too: one of both is told
            time.sleep(0.02)
        assert not own[0].is_alive()
        assert other.is_alive()
    finally:
        other.kill()
        other.join()
