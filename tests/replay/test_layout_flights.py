"""The rotor layout of recorded flights: the right one from any part of them, or none with a reason."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from shared_data import shared

from mavdiag.airframe.detect import detect_layout
from mavdiag.airframe.load import airframe_named
from mavdiag.logs import read_log
from mavdiag.rows.align import AlignSpec, measure_grid
from mavdiag.rows.block import Block
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.units import NS_PER_S

FLIGHTS = {
    "arducopter_live/locked_yaw_healthy.tlog": "x",
    "arducopter_live/locked_yaw_weak_motors.tlog": "x",
    "arducopter_sitl/healthy_quad3kg_sq1.tlog": "plus",
    "arducopter_sitl/healthy_quad3kg_sq5.tlog": "plus",
    "arducopter_sitl/fault_quad3kg_m1_080_sq1.tlog": "plus",
    "arducopter_sitl/fault_quad3kg_m1_080_sq5.tlog": "plus",
    "arducopter_sitl/healthy_jsonplant2_sq1.tlog": "x",
    "arducopter_sitl/fault_jsonplant2_m1_eff090_imb_sq1.tlog": "x",
    "arducopter_sitl/jsonplant_flight.bin": "x",
    "ardupilot_real/log171.bin": "x",
}


@cache
def flown(path: Path) -> tuple[Block, ...]:
    """The rows of flight of a log."""
    log = read_log(path)
    dt_s, grid = measure_grid(log.telemetry)
    gate = (airframe_named("crazyflie").gate if log.profile == "crazyflie" else None) or GateSpec(min_thrust=0.1)
    front = Front(AlignSpec(dt_s, grid, max_gap_s=0.3), gate, RateSpec.of(dt_s, 5))
    state, parts = front.step(front.start(), log.telemetry)
    _, rest = front.finish(state)
    return tuple(part.block for part in (*parts, *rest) if isinstance(part, Rows))


def between(blocks: tuple[Block, ...], from_s: float, to_s: float) -> list[Block]:
    """The rows between two times since the first."""
    begin = int(blocks[0].t_ns[0])
    limits = [begin + round(at * NS_PER_S) for at in (from_s, to_s)]
    cuts = [(one, np.searchsorted(one.t_ns, limits)) for one in blocks]
    return [one.rows(int(first), int(stop)) for one, (first, stop) in cuts if stop > first]


@pytest.mark.parametrize(("name", "layout"), FLIGHTS.items())
def test_l6_every_part_of_a_flight_gives_the_layout_or_none(name: str, layout: str) -> None:
    """L6: one flight was x on the live link and unknown from its .tlog."""
    blocks = flown(shared(f"data/{name}"))
    whole = detect_layout(blocks)
    assert whole.layout is not None, whole
    assert whole.layout.name == layout
    flight_s = (blocks[-1].t_ns[-1] - blocks[0].t_ns[0]) / NS_PER_S
    starts = np.arange(0.0, flight_s - 20.0, max(10.0, flight_s / 30))
    found = [detect_layout(between(blocks, float(at), float(at) + 20.0)).layout for at in starts]
    named = [one.name for one in found if one is not None]
    assert set(named) == {layout}
    assert len(named) >= len(found) / 3  # the others say why not; a third of log171 is on the ground
    pieces = [one.rows(i, min(i + 40, len(one))) for one in blocks for i in range(0, len(one), 40)]
    assert detect_layout(pieces) == whole


@pytest.mark.parametrize("name", ["crazypad/normal_flight/E8_log00", "arducopter_live/turning_nose_healthy.tlog"])
def test_a_flight_without_outputs_says_so(name: str) -> None:
    found = detect_layout(flown(shared(f"data/{name}")))
    assert found.layout is None
    assert found.reason == "the data carry no rotor outputs that move"
