"""Recorded flights: their readers against pymavlink and physics; layouts, damaged propellers named, silent health."""

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_rows import calibrated
from recorded_flights import part
from scipy.signal import savgol_filter
from shared_data import shared

import mavdiag as md
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.detect import detect_layout
from mavdiag.airframe.fingerprint import Outcome, compare, fingerprint_of
from mavdiag.airframe.layout import RotorLayout, layout_named
from mavdiag.airframe.load import airframe_named
from mavdiag.errors import InputError
from mavdiag.judging import Verdict
from mavdiag.learning import LearnOptions, airborne, front_for, learn, rows_of
from mavdiag.learning.teaching import taught
from mavdiag.logs import between, read_log
from mavdiag.logs.crazyflie import read_crazyflie
from mavdiag.logs.dataflash import Walk, read_dataflash
from mavdiag.logs.log import Table
from mavdiag.logs.ulog import read_ulog
from mavdiag.monitors.base import Flights, LearnContext, Monitor
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.rows.align import AlignSpec, measure_grid
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.savgol import window_samples
from mavdiag.telemetry import FloatArray, Log, Signal, Telemetry
from mavdiag.thresholds.rule import BUDGET_PER_HOUR
from mavdiag.units import NS_PER_S

SHARE = BUDGET_PER_HOUR / 4
GATES = {
    "crazyflie": GateSpec(min_height_m=0.38, min_thrust=0.38, need_armed=False, trim_start_s=0.5, trim_end_s=0.6),
    "ardupilot-log": GateSpec(min_thrust=0.1, trim_start_s=1.0, trim_end_s=0.6),
}
CRAZYFLIE = airframe_named("crazyflie").layout
UPSET_S = 239.0  # of log171.bin, as the data's own notes have it
STAMP = "1970-01-01T00:00:00+00:00"
DT_S = 1 / 101.1
LAGS = range(16)  # the vehicle follows its setpoint within 0.15 s
FILE = "data/px4_real/pyulog_sample.ulg"


@cache
def flight(path: Path, max_gap_s: float = 0.035) -> tuple[Rows, ...]:
    log = read_log(path)
    telemetry = log.telemetry
    dt_s, grid = measure_grid(telemetry)
    setpoint_s = float(np.median(np.diff(np.unique(telemetry.need(Signal.ATTITUDE_SETPOINT).t_ns)))) / 1e9
    gate = GATES.get(log.profile, GateSpec(min_thrust=0.1))
    front = Front(
        AlignSpec(dt_s, grid, max(max_gap_s, 2.5 * setpoint_s)), gate, RateSpec.of(dt_s, window_samples(dt_s))
    )
    return rows_of(front, telemetry)


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


@cache
def crazypad_guards(folder: str) -> tuple[Log, ...]:
    return tuple(read_log(path) for path in sorted(shared(f"data/crazypad/{folder}").glob("E8_log*")))


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
    "folder", ["cut_propeller_M3_0.5mm_46.5mm", "cut_propeller_M3_3mm", "add_weight_W1_near_M3_M4"]
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
    "arducopter_sitl/healthy_jsonplant2_sq1.tlog": "x",
    "arducopter_sitl/fault_jsonplant2_m1_eff090_imb_sq1.tlog": "x",
    "arducopter_sitl/jsonplant_flight.bin": "x",
    "ardupilot_real/log171.bin": "x",
}


@pytest.mark.parametrize(("name", "layout"), FLIGHTS.items())
def test_l6_every_part_of_a_flight_gives_the_layout_or_none(name: str, layout: str) -> None:
    """L6: one flight was x on the live link and unknown from its .tlog."""
    blocks = [one.block for one in flight(shared(f"data/{name}"), 0.3)]
    whole = detect_layout(blocks)
    assert whole.layout is not None, whole
    assert whole.layout.name == layout
    flight_s = (blocks[-1].t_ns[-1] - blocks[0].t_ns[0]) / NS_PER_S
    starts = np.arange(0.0, flight_s - 20.0, max(10.0, flight_s / 30))
    found = []
    for at in starts:
        limits = int(blocks[0].t_ns[0]) + np.round(np.array([at, at + 20.0]) * NS_PER_S).astype(np.int64)
        cuts = [(one, np.searchsorted(one.t_ns, limits)) for one in blocks]
        found.append(detect_layout([one.rows(int(a), int(b)) for one, (a, b) in cuts if b > a]).layout)
    named = [one.name for one in found if one is not None]
    assert set(named) == {layout}
    assert len(named) >= len(found) / 3  # the others say why not; a third of log171 is on the ground
    pieces = [one.rows(i, min(i + 40, len(one))) for one in blocks for i in range(0, len(one), 40)]
    assert detect_layout(pieces) == whole


@pytest.mark.parametrize(("autopilot", "teaching"), [("ap463", 0), ("px4", 1)])
def test_an_autopilot_in_the_loop_names_the_damaged_motor_or_none_in_health(autopilot: str, teaching: int) -> None:
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


REAL = "data/ardupilot_real/log171.bin"  # Copter 3.3-dev, 2015
SIMULATED = "data/arducopter_sitl/jsonplant_flight.bin"  # Copter 4.5.6
CHECKED = {
    REAL: ("IMU", "ATT", "RATE", "RCOU", "CTUN", "CURR", "BARO", "GPS", "EV"),
    SIMULATED: ("IMU", "ATT", "RATE", "RCOU", "CTUN", "POS", "BARO", "VIBE", "BAT", "ARM", "EV", "GPS"),
}
INSTANCE = {"IMU": "I", "BARO": "I", "VIBE": "IMU", "BAT": "Inst", "GPS": "I"}


@cache
def oracle(path: Path, wanted: Collection[str]) -> dict[str, dict[str, FloatArray]]:
    """Every numeric column of these messages, first instances only, as pymavlink reads them."""
    reader = import_module("pymavlink.DFReader").DFReader_binary(str(path), zero_time_base=False)
    rows: dict[str, list[dict[str, float]]] = defaultdict(list)
    while (message := reader.recv_match(type=list(wanted))) is not None:
        name, fields = message.get_type(), message.to_dict()
        if fields.get(INSTANCE.get(name, ""), 0) == 0:
            rows[name].append({k: v for k, v in fields.items() if isinstance(v, int | float)})
    reader.close()
    return {name: {k: np.array([row[k] for row in all_rows]) for k in all_rows[0]} for name, all_rows in rows.items()}


@cache
def tables(path: Path, wanted: Collection[str]) -> Mapping[str, Table]:
    walk = Walk(wanted)
    walk.feed(path.read_bytes())
    return walk.finish()[0]


@pytest.mark.parametrize(("file", "name"), [(file, name) for file, names in CHECKED.items() for name in names])
def test_counts_and_values_are_those_of_pymavlink(file: str, name: str) -> None:
    path = shared(file)
    expected = oracle(path, CHECKED[file])[name]
    table = tables(path, CHECKED[file])[name]
    assert len(table.starts) == len(next(iter(expected.values())))
    for label, values in expected.items():
        np.testing.assert_allclose(table.column(label), values, rtol=1e-12, atol=1e-12, err_msg=label)


@cache
def real() -> Telemetry:
    return read_dataflash(shared(REAL)).telemetry


def test_the_upset_of_the_real_flight_is_where_it_was() -> None:
    attitude = real().need(Signal.ATTITUDE)
    over = np.abs(attitude.values[:, 0]) > np.radians(100)
    assert float(attitude.t_ns[over][0]) * 1e-9 == pytest.approx(240, abs=3)
    assert (real().need(Signal.ARMED).t_ns * 1e-9).tolist() == pytest.approx([11.5, 72.6], abs=0.1)


@cache
def healthy(number: int) -> Telemetry:
    return read_crazyflie(shared("data/crazypad/normal_flight") / f"E8_log{number:02d}").telemetry


def aloft(telemetry: Telemetry) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Rows at least half a second inside a flight: high enough, and with thrust."""
    up = (telemetry.need(Signal.HEIGHT).values[:, 0] > 0.38) & (
        telemetry.need(Signal.THRUST_SETPOINT).values[:, 0] > 0.38
    )
    return np.convolve(up, np.ones(101), "same") > 100.5


def correlation(a: FloatArray, b: FloatArray) -> float:
    return float(np.corrcoef(a, b)[0, 1])


@pytest.mark.parametrize("number", range(5))
@pytest.mark.parametrize("axis", [0, 1])
def test_the_body_follows_its_setpoint_with_the_same_sign(number: int, axis: int) -> None:
    telemetry = healthy(number)
    rows = aloft(telemetry)
    demand = savgol_filter(telemetry.need(Signal.ATTITUDE_SETPOINT).values[:, axis], 11, 2, deriv=1, delta=DT_S)
    rate = savgol_filter(telemetry.need(Signal.BODY_RATE).values[:, axis], 11, 2)
    found = [correlation(np.roll(demand, lag)[rows], rate[rows]) for lag in LAGS]
    assert max(found) > max(0.6, abs(min(found)))


@pytest.mark.parametrize("number", range(5))
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_torque_command_pushes_against_the_rate_error(number: int, axis: int) -> None:
    telemetry = healthy(number)
    rows = aloft(telemetry)
    error = telemetry.need(Signal.RATE_SETPOINT).values[:, axis] - telemetry.need(Signal.BODY_RATE).values[:, axis]
    command = telemetry.need(Signal.TORQUE_COMMAND).values[:, axis]
    assert correlation(np.diff(error)[rows[1:]], np.diff(command)[rows[1:]]) > 0.5  # changes: the integral part is slow


def test_rates_are_those_of_the_recording_and_the_attitude_turns_as_the_gyro_says() -> None:
    telemetry = read_ulog(shared(FILE)).telemetry
    rates = ((Signal.BODY_RATE, 250), (Signal.ATTITUDE_SETPOINT, 50), (Signal.RATE_SETPOINT, 84))
    for signal, hz in rates:
        assert 1e9 / np.median(np.diff(telemetry.need(signal).t_ns)) == pytest.approx(hz, rel=0.01)
    attitude, gyro = telemetry.need(Signal.ATTITUDE), telemetry.need(Signal.BODY_RATE)
    moved = attitude.t_ns < attitude.t_ns[0] + 10_000_000_000
    for axis in (0, 1):
        turned = np.gradient(attitude.values[moved, axis], attitude.t_ns[moved] * 1e-9)
        measured = np.interp(attitude.t_ns[moved], gyro.t_ns, gyro.values[:, axis])
        assert float(np.corrcoef(turned, measured)[0, 1]) > 0.9
