"""The monitors on recorded flights: healthy ones stay quiet, damaged ones are found and the rotor is named."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_thresholds import calibrated
from shared_data import shared

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.detect import detect_layout
from mavdiag.airframe.layout import RotorLayout, layout_named
from mavdiag.logs import read_log
from mavdiag.monitors.base import Flights, LearnContext, Monitor
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.rows.align import AlignSpec, measure_grid
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.savgol import window_samples
from mavdiag.telemetry import Signal
from mavdiag.thresholds.rule import BUDGET_PER_HOUR

SHARE = BUDGET_PER_HOUR / 4
GATES = {
    "crazyflie": GateSpec(min_height_m=0.38, min_thrust=0.38, need_armed=False, trim_start_s=0.5, trim_end_s=0.6),
    "ardupilot-log": GateSpec(min_thrust=0.1, trim_start_s=1.0, trim_end_s=0.6),
}


@cache
def flight(path: Path) -> tuple[Rows, ...]:
    """Airborne rows of a log."""
    log = read_log(path)
    telemetry = log.telemetry
    dt_s, grid = measure_grid(telemetry)
    setpoint_s = float(np.median(np.diff(np.unique(telemetry.need(Signal.ATTITUDE_SETPOINT).t_ns)))) / 1e9
    gate = GATES.get(log.profile, GateSpec(min_thrust=0.1))
    front = Front(AlignSpec(dt_s, grid, max(0.035, 2.5 * setpoint_s)), gate, RateSpec.of(dt_s, window_samples(dt_s)))
    state, rows = front.step(front.start(), telemetry)
    return tuple(one for one in (*rows, *front.finish(state)[1]) if isinstance(one, Rows))


def learnt(kind: type[Monitor[Any]], flights: Flights, layout: RotorLayout | None = None) -> tuple[Monitor[Any], float]:
    """The monitor fitted to healthy flights, and its threshold."""
    dt_s = flights[0][0].block.dt_s
    context = LearnContext(Airframe(layout=layout), None, dt_s, window_samples(dt_s))
    monitor, threshold = calibrated(kind, flights, context, SHARE)
    return monitor, threshold.value


def highest(fitted: tuple[Monitor[Any], float], rows: tuple[Rows, ...]) -> tuple[float, int]:
    """Highest judged statistic over its threshold, and the rotor named there."""
    monitor, threshold = fitted
    best, rotor = 0.0, 0
    for found in monitor.over(rows):
        x = np.where(found.valid, found.value, 0.0)
        if len(x) and x.max() > best:
            best = float(x.max())
            rotor = int(found.rotors[x.argmax()].argmax()) + 1 if found.rotors.size else 0
    return best / threshold, rotor


@pytest.fixture(scope="module")
def crazypad() -> dict[str, list[tuple[Rows, ...]]]:
    names = ("normal_flight", "cut_propeller_M3_3.5mm_3mm_40.5mm", "cut_propeller_M3_2.5mm_2.5mm_42mm")
    extra = ("add_weight_W1_near_M3_M4", "tape_on_propeller_M3_M4")
    folders = {name: shared("data/crazypad") / name for name in (*names, *extra)}
    return {name: [flight(path) for path in sorted(folder.glob("E8_log*"))] for name, folder in folders.items()}


def test_a_cut_propeller_is_found_and_named(crazypad: dict[str, list[tuple[Rows, ...]]]) -> None:
    fitted = learnt(RotorTrim, crazypad["normal_flight"], layout_named("crazyflie"))
    for name, flights in crazypad.items():
        for one in flights:
            ratio, rotor = highest(fitted, one)
            if name.startswith("cut"):
                assert ratio > 1.2, name
                assert rotor == 3, name
            else:
                assert ratio < 0.9, name  # weight and tape are no lost thrust


@pytest.mark.parametrize("taught", ["sq1", "sq5"])
def test_arducopter_hides_a_weak_motor_but_its_outputs_show_it(taught: str) -> None:
    folder = shared("data/arducopter_sitl")
    rows = flight(folder / f"healthy_quad3kg_{taught}.tlog")
    fitted = learnt(RotorTrim, [rows], detect_layout(one.block for one in rows).layout)
    for square in ("sq1", "sq5"):
        assert highest(fitted, flight(folder / f"healthy_quad3kg_{square}.tlog"))[0] < 0.1
        for share in ("080", "090"):
            ratio, rotor = highest(fitted, flight(folder / f"fault_quad3kg_m1_{share}_{square}.tlog"))
            assert ratio > 1.3  # after one flight, another session is allowed 0.07 of hover
            assert rotor == 1
