"""The fit beside the daemon makes the baseline that `mavdiag identify` makes."""

import multiprocessing
import time

import pytest
from made_session import baseline_for

from detector.fitting import FittingJob, ProcessFitter, fit_baseline
from mavdiag import learning
from mavdiag.airframe.airframe import Airframe
from mavdiag.baseline import Baseline
from mavdiag.learning import LearnOptions
from mavdiag.telemetry import Log, Telemetry

AIRFRAME = Airframe(name="survey quad", mass_kg=1.2)
JOB = FittingJob(1, AIRFRAME, "qdrone2", Telemetry())


def test_b26_live_learning_has_the_options_of_identify(monkeypatch: pytest.MonkeyPatch) -> None:
    """It modelled two axes where `identify` models one: one flight gave two baselines."""
    asked: list[LearnOptions] = []

    def learn(logs: list[Log], options: LearnOptions, *, created: str) -> object:
        asked.append(options)
        return baseline_for()

    monkeypatch.setattr(learning, "learn", learn)
    assert isinstance(fit_baseline(JOB), Baseline)
    assert asked == [LearnOptions(airframe=AIRFRAME)]


def test_only_its_own_process_is_ended() -> None:
    context = multiprocessing.get_context("spawn")
    other = context.Process(target=time.sleep, args=(60.0,))
    other.start()
    try:
        fitter = ProcessFitter()
        fitter.begin(FittingJob(1, Airframe(), "qdrone2", Telemetry()))
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
