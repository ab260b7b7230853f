"""Which vehicles are judged when a look has no time for all, and what is said of the delay."""

from collections.abc import Callable

import numpy as np
import pytest

from detector.fleet import due_turns
from mavdiag.telemetry import Instant

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


@pytest.mark.parametrize("seed", range(3))
def test_many_take_turns_and_a_look_stays_short(seed: int) -> None:
    """100 vehicles that cost 4 ms each have five turns in 20 ms: every 0.8 s, none left out."""
    waits, longest_s = looks(100, seed)
    assert longest_s < TICK_S / 2 + 1.5 * COST_S
    late = [max(waited[5:]) for waited in waits.values()]
    assert min(len(waited) for waited in waits.values()) > 15
    assert max(late) < 1.5 * np.mean(late) < 1.5
