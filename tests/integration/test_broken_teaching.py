"""Nothing broken is learnt: emulated flights with a damaged propeller among those that teach, and healthy ones."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from broken_teaching import MONITORS, Pool, Tally, judge_sets, pool_of

import mavdiag as md
from mavdiag.baseline import Baseline
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import Log, Signal, Telemetry
from sitl_plant.vehicle import airframe_of

NOW = "2026-01-01T00:00:00+00:00"


@cache
def pool() -> Pool:
    """Of an airframe at 1 kHz."""
    return pool_of(7001, 0, 8)


def learnt(*flights: Log) -> Baseline:
    frame = airframe_of(pool().session.airframe.vehicle, "made")
    return learn(flights, LearnOptions(airframe=frame, monitors=MONITORS), created=NOW)


def test_drawn_sets_are_marked_where_one_is_broken_and_nowhere_else() -> None:
    """A short form of `benchmarks/broken_teaching.py`, on an airframe of a seed of its own."""
    tally = Tally()
    judge_sets(pool(), 1, np.random.default_rng(7001), tally)
    for kind, counts in tally.kinds.items():
        if kind.startswith("healthy"):
            assert counts[True] == 0, (kind, tally.wrong)
        elif kind != "one broken of 1":  # physics alone does not show every one
            assert counts[False] == 0, (kind, tally.wrong)


@pytest.mark.parametrize("code", ["F1/SV2", "F2/SV1", "F3/SV3"])
def test_a_crack_in_one_flight_names_the_flight_and_the_time(code: str) -> None:
    half = pool().half[code]
    weak = learnt(half).weak
    assert half.name in weak or "all flights" in weak
    broken = pool().broken[code]
    assert f"{broken.name}: " in learnt(pool().healthy[0], broken, pool().healthy[1]).weak


def test_more_unbalance_than_a_rotor_may_have_is_not_learnt() -> None:
    found = learnt(pool().broken["F3/SV3"])
    assert (found.grade, "grade G40" in found.weak) == ("D", True)


def weakened(log: Log, rotor: int, loss: float) -> Log:
    """The log with a rotor that lost thrust at half: its command rises, that of all together stays."""
    parts = []
    for one in log.telemetry.series:
        if one.signal is Signal.ACTUATOR:
            values = one.values.copy()
            late = one.t_ns > (one.t_ns[0] + one.t_ns[-1]) // 2
            values[late, rotor - 1] += (1 / np.sqrt(1 - loss) - 1) * values[late, :4].mean(axis=1)
            one = replace(one, values=values)
        parts.append(one)
    return replace(log, name="weakened", sha256="", telemetry=Telemetry(tuple(parts)))


def test_what_the_baseline_says_that_it_notices_it_notices() -> None:
    baseline = learnt(*pool().healthy[:4])
    assert baseline.least_damage is not None
    fresh = pool().healthy[5]
    assert md.judge(fresh, baseline).verdict == "healthy"
    for rotor, loss in enumerate(baseline.least_damage.thrust_loss, 1):
        assert 0.005 < loss < 0.2
        assert md.judge(weakened(fresh, rotor, 0.3 * loss), baseline).verdict == "healthy"
        assert md.judge(weakened(fresh, rotor, 1.6 * loss + 0.01), baseline).verdict != "healthy"
