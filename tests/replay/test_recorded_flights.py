"""Recorded flights are judged: layouts, guards, damaged propellers named, and health is silence."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_rows import calibrated
from shared_data import shared

import mavdiag as md
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.detect import detect_layout
from mavdiag.airframe.fingerprint import Outcome, compare, fingerprint_of
from mavdiag.airframe.layout import RotorLayout, layout_named
from mavdiag.airframe.load import airframe_named
from mavdiag.errors import InputError
from mavdiag.judging import Verdict
from mavdiag.learning import LearnOptions, airborne, front_for, learn
from mavdiag.learning.teaching import taught
from mavdiag.logs import between, read_log
from mavdiag.monitors.base import Flights, LearnContext, Monitor
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.rows.align import AlignSpec, measure_grid
from mavdiag.rows.block import Block
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.savgol import window_samples
from mavdiag.telemetry import Log, Signal
from mavdiag.thresholds.rule import BUDGET_PER_HOUR
from mavdiag.units import NS_PER_S

SHARE = BUDGET_PER_HOUR / 4
GATES = {
    "crazyflie": GateSpec(min_height_m=0.38, min_thrust=0.38, need_armed=False, trim_start_s=0.5, trim_end_s=0.6),
    "ardupilot-log": GateSpec(min_thrust=0.1, trim_start_s=1.0, trim_end_s=0.6),
}


@cache
def flight(path: Path) -> tuple[Rows, ...]:
    log = read_log(path)
    telemetry = log.telemetry
    dt_s, grid = measure_grid(telemetry)
    setpoint_s = float(np.median(np.diff(np.unique(telemetry.need(Signal.ATTITUDE_SETPOINT).t_ns)))) / 1e9
    gate = GATES.get(log.profile, GateSpec(min_thrust=0.1))
    front = Front(AlignSpec(dt_s, grid, max(0.035, 2.5 * setpoint_s)), gate, RateSpec.of(dt_s, window_samples(dt_s)))
    state, rows = front.step(front.start(), telemetry)
    return tuple(one for one in (*rows, *front.finish(state)[1]) if isinstance(one, Rows))


def learnt(kind: type[Monitor[Any]], flights: Flights, layout: RotorLayout | None = None) -> tuple[Monitor[Any], float]:
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


CRAZYFLIE = airframe_named("crazyflie").layout
UPSET_S = 239.0  # of log171.bin, as the data's own notes have it


@cache
def crazypad_guards(folder: str) -> tuple[Log, ...]:
    return tuple(read_log(path) for path in sorted(shared(f"data/crazypad/{folder}").glob("E8_log*")))


def part(log: Log, from_s: float | None, to_s: float | None) -> Log:
    return replace(log, telemetry=between(log.telemetry, from_s, to_s))


def test_a_real_flight_teaches_up_to_its_upset_and_is_refused_with_it() -> None:
    log = read_log(shared("data/ardupilot_real/log171.bin"))
    assert taught([part(log, 75, 217)], 0.1, None, robust=False).left_out == ()
    with pytest.raises(
        InputError, match=r"log171\.bin: the flight ends in an upset, at 23\d\.\d s: .*cut the log before"
    ):
        taught([log], 0.1, None, robust=False)
    found = taught([log], 0.1, None, robust=True)
    assert found.flights[0].rows[-1].block.t_ns[-1] / 1e9 < UPSET_S
    assert found.flights[0].judged_s == pytest.approx(taught([part(log, None, 236)], 0.1, None, robust=False)
                                                      .flights[0].judged_s, abs=3)  # fmt: skip
    assert len(found.left_out) == 1


def rows(log: Log) -> Sequence[Rows]:
    return airborne(front_for(crazypad_guards("normal_flight"), 0.1), log).rows


@pytest.mark.parametrize(
    "folder",
    [
        "cut_propeller_M3_0.5mm_46.5mm",
        "cut_propeller_M3_4mm_4mm_39mm",
        "cut_propeller_M3_3mm",
        "tape_on_propeller_M1_M3_M4",
        "add_weight_W1_near_M3_M4",
    ],
)
def test_damage_and_load_do_not_make_e8_another_vehicle(folder: str) -> None:
    healthy = [rows(log) for log in crazypad_guards("normal_flight")]
    for learnt in (healthy, healthy[:3], healthy[3:]):
        fingerprint = fingerprint_of(learnt, CRAZYFLIE)
        assert fingerprint is not None
        for log in crazypad_guards(folder):
            assert compare(fingerprint, rows(log), CRAZYFLIE).outcome is not Outcome.FAR


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
    log = read_log(path)
    dt_s, grid = measure_grid(log.telemetry)
    gate = (airframe_named("crazyflie").gate if log.profile == "crazyflie" else None) or GateSpec(min_thrust=0.1)
    front = Front(AlignSpec(dt_s, grid, max_gap_s=0.3), gate, RateSpec.of(dt_s, 5))
    state, parts = front.step(front.start(), log.telemetry)
    _, rest = front.finish(state)
    return tuple(part.block for part in (*parts, *rest) if isinstance(part, Rows))


def between_layout(blocks: tuple[Block, ...], from_s: float, to_s: float) -> list[Block]:
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
    found = [detect_layout(between_layout(blocks, float(at), float(at) + 20.0)).layout for at in starts]
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


STAMP = "1970-01-01T00:00:00+00:00"


@pytest.mark.parametrize(("autopilot", "teaching"), [("ap463", 0), ("px4", 1)])
def test_an_autopilot_in_the_loop_names_the_damaged_motor_and_is_silent_in_health(
    autopilot: str, teaching: int
) -> None:
    """A half of the healthy flight teaches, the other half and the flight with F2/SV2 on motor 4 are judged."""
    folder = shared("data/autopilots_in_the_loop")
    healthy, faulty = (md.read_log(folder / f"{autopilot}_hil_{name}.tlog") for name in ("healthy", "F2SV2_rotor1"))
    times_s = healthy.telemetry.need(Signal.BODY_RATE).t_s
    edges = (None, float(times_s[0] + times_s[-1]) / 2, None)
    halves = [replace(healthy, telemetry=between(healthy.telemetry, *edges[k : k + 2])) for k in range(2)]
    base = learn([halves[teaching]], LearnOptions(), created=STAMP)
    assert {"rotor_trim", "trim_step"} <= {one.spec.kind for one in base.monitors}
    assert md.judge(halves[1 - teaching], base).verdict is not Verdict.FAULT
    verdict = md.judge(faulty, base)
    assert verdict.verdict is Verdict.FAULT
    assert {one.rotor for one in verdict.changes if one.rotor} == {4}
