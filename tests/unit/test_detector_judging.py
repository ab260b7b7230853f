"""A baseline at work in a session: what the settings change, and why monitors do not judge."""

import numpy as np
import pytest
from flying_telemetry import flying
from made_baselines import trim
from made_session import baseline_for

from detector.config import SessionSettings
from detector.judging import Judge, chain_for, not_judged
from detector.streams import Streams, observe
from mavdiag.chain import chain_of
from mavdiag.errors import BaselineError
from mavdiag.link.profiles import PROFILES
from mavdiag.telemetry import Instant


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
    for rate, said in ((2.0, (("rotor trim", "yaw rate not learnt"),)), (0.0, ())):
        telemetry, chain = flying(3000, 5, turn=np.full(3000, rate)), chain_of(trim())
        judge, _ = Judge(trim(), chain, chain.start(), Instant(0)).step(telemetry, Instant(0))
        streams = observe(Streams(), telemetry, Instant(0), PROFILES["qdrone2"])
        assert not_judged(judge, streams, Instant(30 * 10**9)) == said
