"""Judging in the daemon: what the settings change, why monitors do not judge, turns, and the fit beside it."""

import multiprocessing
import time
from collections.abc import Callable

import numpy as np
import pytest
from flying_telemetry import flying
from made_baselines import trim
from made_session import baseline_for

from detector.config import SessionSettings
from detector.fitting import FittingJob, ProcessFitter
from detector.fleet import due_turns
from detector.judging import Judge, chain_for
from detector.streams import Streams
from detector.values import Learn
from mavdiag.airframe.airframe import Airframe
from mavdiag.chain import chain_of
from mavdiag.errors import BaselineError
from mavdiag.link.profiles import PROFILES
from mavdiag.telemetry import FloatArray, Instant, Series, Signal, Telemetry


def test_monitors_named_as_suspect_do_not_decide_as_long_as_another_does() -> None:
    baseline = baseline_for(names=("unbalance", "rotor_trim"))
    settings = SessionSettings(suspect=("rotor_trim",), threshold_scale=2.0)
    plain, chain = chain_of(baseline), chain_for(baseline, settings, 0)
    assert [slot.decides for slot in plain.slots] == [True, True]
    assert [slot.decides for slot in chain.slots] == [spec.decides for spec in chain.decision.slots] == [True, False]
    assert [b.threshold / a.threshold for a, b in zip(plain.slots, chain.slots, strict=True)] == [2.0, 2.0]
    with pytest.raises(BaselineError, match="suspect names every monitor that decides"):
        chain_for(baseline, SessionSettings(suspect=("unbalance", "rotor_trim")), 0)


def test_a_flight_outside_of_the_envelope_says_which_condition_was_not_learnt() -> None:
    """And not that it waits for unbroken flight, nor a figure that changes with every look."""
    for rate, said in ((2.0, {"rotor trim": "yaw rate not learnt"}), (0.0, {})):
        telemetry = flying(3000, 5, turn=np.full(3000, rate))
        judge, streams = Judge(trim(), chain_of(trim()), Instant(0)), Streams()
        judge.step(telemetry, Instant(0))
        streams.observe(telemetry, Instant(0), PROFILES["qdrone2"])
        assert judge.not_judged(streams, Instant(30 * 10**9)) == said


def came(streams: Streams, t_s: FloatArray, now_s: float) -> None:
    t_ns = np.round(1e9 * t_s).astype(np.int64)
    gyro = Series(Signal.BODY_RATE, t_ns, t_ns, np.zeros((len(t_ns), 3)))
    streams.observe(Telemetry((gyro,)), Instant(round(now_s * 1e9)), PROFILES["ardupilot"])


def test_h5_a_link_that_stalls_changes_no_rate() -> None:
    """By arrival 0.2 s without data read 45 Hz, then 100 Hz: 204 requests in 718 s."""
    streams, seen = Streams(), []
    for k in range(100):  # 100 Hz by the vehicle's clock; every second look comes late, with all that waited
        stamps = 0.01 * np.arange(20.0 * k, 20.0 * (k + 1))
        first, rest = stamps[:3], stamps[3:]
        came(streams, first, 0.2 * k + 0.18)
        seen.append(streams.rate_hz(Signal.BODY_RATE, Instant(round((0.2 * k + 0.181) * 1e9))))
        came(streams, rest, 0.2 * k + 0.19)
    assert [one for one in seen if one is not None] == pytest.approx([100.0] * sum(one is not None for one in seen))
    came(streams, 20.0 + 0.25 * np.arange(1.0, 4.0), 21.0)
    assert streams.rate_hz(Signal.BODY_RATE, Instant(21 * 10**9)) == pytest.approx(4.0)  # and a lower one shows at once


COST_S = 0.004
TICK_S = 0.04


def looks(
    vehicles: int, seed: int, source_of: Callable[[int], int] = lambda sysid: sysid, begun_s: float = 0.0
) -> tuple[dict[int, list[float]], float]:
    """Judge by the policy for 500 looks: the waits of each vehicle, and the longest look.

    begun_s: of each look, that went by before anybody is judged.
    """
    rng = np.random.default_rng(seed)
    judged, longest_s = {sysid: Instant(0) for sysid in range(vehicles)}, 0.0
    waits: dict[int, list[float]] = {sysid: [] for sysid in range(vehicles)}
    for number in range(1, 501):
        now, spent_s = Instant(0) + number * TICK_S, [begun_s]
        for sysid, waited_s in due_turns(judged, now, source_of, lambda spent_s=spent_s: sum(spent_s) < TICK_S / 2):  # type: ignore[misc]  # a default of one look
            waits[sysid].append(waited_s)
            judged[sysid] = now
            spent_s.append(COST_S * float(rng.uniform(0.5, 1.5)))
        longest_s = max(longest_s, sum(spent_s))
    return waits, longest_s


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
