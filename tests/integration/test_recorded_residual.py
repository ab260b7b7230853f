"""What the thesis's residual measures on the QDrone 2 as it was recorded: vibration, not damage.

Published noise levels in a model of the roll loop gave a one-step p90 on the raw gyro of 0.84e-3 and 0.79e-3 rad/s on
drones 2 and 3 and 1.25e-3 to 1.57e-3 on drone 1, by least squares on drones 2 and 3; free run was equal for all. A line
made stronger by 1.5, 2 and 3 came above the margin in .44, .55 and .69 of the time. The emulator must give the same
picture; nothing in it was set to these figures.
"""

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from thesis_table import Craft, Kind, Yardstick, config_of, flight

from mavdiag.learning import LearntFlight

SEED = 9100  # of flights that no benchmark flies


@cache
def healthy() -> tuple[LearntFlight, ...]:
    return tuple(flight(config_of(Craft.AS_RECORDED, drone, SEED + drone)) for drone in (1, 2, 3))


@cache
def yardstick(kind: Kind) -> Yardstick:
    return Yardstick.of(kind, healthy())


def test_one_step_p90_has_the_size_and_the_order_of_the_published_levels() -> None:
    one, two, three = yardstick(Kind.ONE_STEP).p90
    assert two == pytest.approx(0.84e-3, rel=0.3)
    assert three == pytest.approx(0.79e-3, rel=0.3)
    assert 1.25e-3 / 1.5 < one < 1.57e-3 * 1.5
    assert one > 1.15 * max(two, three)


def test_one_step_rises_with_the_line_and_free_run_does_not() -> None:
    stronger = [flight(config_of(Craft.AS_RECORDED, 1, SEED + 1, line)) for line in (1.0, 2.0, 3.0)]
    shares = {kind: [yardstick(kind).read(one)[2] for one in stronger] for kind in Kind}
    assert shares[Kind.ONE_STEP][1] == pytest.approx(0.55, abs=0.2)
    assert shares[Kind.ONE_STEP][2] == pytest.approx(0.69, abs=0.2)
    assert np.all(np.diff(shares[Kind.ONE_STEP]) > 0.05)
    assert np.ptp(shares[Kind.FREE_RUN]) < 0.02


def test_free_run_is_alike_on_all_drones_and_far_above_one_step() -> None:
    free, step = yardstick(Kind.FREE_RUN).p90, yardstick(Kind.ONE_STEP).p90
    assert free.max() / free.min() < 2.0
    assert free.min() > 5.0 * step.max()
