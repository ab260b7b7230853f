"""Which vehicles are judged when a look has no time for all, and what is said of the delay."""

from collections.abc import Callable

import numpy as np
import pytest

from detector.pacing import LEVELS_S, QUIET_S, Delay, Pacing, by_turns
from mavdiag.telemetry import Instant

COST_S = 0.004
TICK_S = 0.04


def looks(
    vehicles: int, count: int, seed: int, source_of: Callable[[int], int] = lambda sysid: sysid, begun_s: float = 0.0
) -> tuple[dict[int, list[float]], float]:
    """Judge by the policy for so many looks: the waits of each vehicle, and the longest look.

    begun_s: of each look, that went by before anybody is judged.
    """
    rng, pacing = np.random.default_rng(seed), Pacing.of(TICK_S)
    judged, longest_s = {sysid: Instant(0) for sysid in range(vehicles)}, 0.0
    waits: dict[int, list[float]] = {sysid: [] for sysid in range(vehicles)}
    for number in range(1, count + 1):
        now, spent_s, first = Instant(0) + number * TICK_S, begun_s, True
        for sysid, waited_s in by_turns(judged, now, source_of):
            if pacing.judges(waited_s, spent_s, first):
                waits[sysid].append(waited_s)
                judged[sysid], first = now, False
                spent_s += COST_S * float(rng.uniform(0.5, 1.5))
        longest_s = max(longest_s, spent_s)
    return waits, longest_s


@pytest.mark.parametrize("seed", range(3))
def test_few_vehicles_are_judged_in_every_look(seed: int) -> None:
    waits, _ = looks(3, 200, seed)
    assert all(len(one) == 200 for one in waits.values()), seed
    assert max(max(one) for one in waits.values()) == pytest.approx(TICK_S)


@pytest.mark.parametrize("seed", range(3))
def test_many_take_turns_and_a_look_stays_short(seed: int) -> None:
    """100 vehicles that cost 4 ms each have five turns in 20 ms: every 0.8 s, none left out."""
    waits, longest_s = looks(100, 500, seed)
    assert longest_s < TICK_S / 2 + 1.5 * COST_S, seed
    late = [max(one[5:]) for one in waits.values()]
    assert min(len(one) for one in waits.values()) > 15
    assert max(late) < 1.5 * np.mean(late) < 1.5


@pytest.mark.parametrize("seed", range(3))
def test_127_made_up_vehicles_of_one_source_do_not_delay_another_source(seed: int) -> None:
    waits, longest_s = looks(128, 500, seed, lambda sysid: int(sysid == 60))
    assert max(waits[60]) == pytest.approx(TICK_S)
    assert len(waits[60]) == 500
    assert min(len(one) for one in waits.values()) > 10
    assert longest_s < TICK_S / 2 + 1.5 * COST_S


def test_without_any_time_another_source_waits_no_longer_than_alone() -> None:
    waits, _ = looks(128, 500, 0, lambda sysid: int(sysid == 60), begun_s=TICK_S)
    assert max(waits[60]) <= 2.0 + 2 * TICK_S
    assert len(waits[60]) >= 9


def test_without_time_one_vehicle_that_waited_long_is_judged_all_the_same() -> None:
    pacing = Pacing.of(TICK_S)
    assert pacing.judges(2.1, 1.0, True)
    assert not pacing.judges(2.1, 1.0, False)
    assert not pacing.judges(1.9, 1.0, True)
    assert Pacing().judges(0.0, 1e9, False)


def test_the_delay_is_told_when_it_changes_and_not_too_often() -> None:
    delay, text = Delay().waited(TICK_S).news(Instant(0))
    assert text == ""
    delay, text = delay.waited(0.5).waited(0.2).news(Instant(0) + 1.0)
    assert "every 0.50 s" in text
    assert delay.longest_s == 0.0
    delay, text = delay.waited(LEVELS_S[-1] + 1.0).news(Instant(0) + 2.0)
    assert text == ""
    delay, text = delay.waited(LEVELS_S[-1] + 1.0).news(Instant(0) + 1.0 + QUIET_S)
    assert "every 3.40 s" in text
    _, text = delay.waited(TICK_S).news(Instant(0) + 2.0 + 2 * QUIET_S)
    assert "again" in text
