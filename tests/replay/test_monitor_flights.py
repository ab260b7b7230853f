"""The monitors on recorded flights: healthy ones stay silent, damaged ones are found and the rotor is named."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from shared_data import shared

from mavdiag.airframe.layout import LAYOUTS, RotorLayout, detect_layout, layout_named
from mavdiag.judging import between
from mavdiag.learning import Flight, front_for, rows_of
from mavdiag.logs import read_log
from mavdiag.monitors import innovation, rotor_trim, vibration_level
from mavdiag.monitors.base import Monitor, Rows
from mavdiag.thresholds.heldout import Flights
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, Threshold, calibrate

SHARE = BUDGET_PER_HOUR / 4
Watched = tuple[Monitor[rotor_trim.RotorTrimState], Threshold]


@cache
def flight(path: Path, from_s: float | None = None, to_s: float | None = None) -> tuple[Rows, ...]:
    """Airborne rows of a log, between two times of the vehicle's clock."""
    log = read_log(path)
    telemetry = between(log.telemetry, from_s, to_s)
    return rows_of(front_for([Flight(log.name, log.sha256, log.profile, telemetry)], 0.1), telemetry)


def trim_monitor(flights: Flights, frame: RotorLayout | None) -> Watched:
    assert frame is not None
    spec, threshold = calibrate(
        flights,
        lambda rest: rotor_trim.fit(rest, frame),
        rotor_trim.RotorTrim,
        budget_per_hour=SHARE,
        guard=rotor_trim.GUARD,
    )
    return rotor_trim.RotorTrim(spec), threshold


def trim(watched: Watched, rows: tuple[Rows, ...]) -> tuple[float, int]:
    """Highest judged statistic over its threshold, and the rotor named there."""
    monitor, threshold = watched
    state, best, rotor = monitor.start(), 0.0, 0
    for one in rows:
        state, reading = monitor.step(state, one)
        x = np.where(reading.valid, reading.statistic, 0.0)
        if len(x) and x.max() > best:
            best, rotor = float(x.max()), int(reading.rotors[x.argmax()].argmax()) + 1
    return best / threshold.value, rotor


@pytest.fixture(scope="module")
def crazypad() -> dict[str, list[tuple[Rows, ...]]]:
    names = ("normal_flight", "cut_propeller_M3_3.5mm_3mm_40.5mm", "cut_propeller_M3_2.5mm_2.5mm_42mm")
    extra = ("add_weight_W1_near_M3_M4", "tape_on_propeller_M3_M4")
    folders = {name: shared("data/crazypad") / name for name in (*names, *extra)}
    return {name: [flight(path) for path in sorted(folder.glob("E8_log*"))] for name, folder in folders.items()}


def test_healthy_crazyflies_stay_silent_when_left_out(crazypad: dict[str, list[tuple[Rows, ...]]]) -> None:
    healthy = crazypad["normal_flight"]
    for one in healthy:
        watched = trim_monitor([other for other in healthy if other is not one], layout_named("crazyflie"))
        assert trim(watched, one)[0] < 0.6


def test_a_cut_propeller_is_found_and_named(crazypad: dict[str, list[tuple[Rows, ...]]]) -> None:
    watched = trim_monitor(crazypad["normal_flight"], layout_named("crazyflie"))
    for name, flights in crazypad.items():
        for one in flights:
            ratio, rotor = trim(watched, one)
            if name.startswith("cut"):
                assert ratio > 1.2, name
                assert rotor == 3, name
            else:
                assert ratio < 0.9, name  # weight and tape are no lost thrust


@pytest.mark.parametrize(
    ("name", "frame"),
    [
        ("arducopter_sitl/healthy_quad3kg_sq1.tlog", "plus"),
        ("arducopter_sitl/fault_quad3kg_m1_080_sq5.tlog", "plus"),
        ("arducopter_sitl/healthy_jsonplant2_sq1.tlog", "x"),
        ("arducopter_sitl/jsonplant_flight.bin", "x"),
    ],
)
def test_the_frame_is_found_from_the_log(name: str, frame: str) -> None:
    assert detect_layout(flight(shared("data") / name)) is LAYOUTS[frame]


def test_a_crazyflie_log_without_outputs_names_no_frame() -> None:
    assert detect_layout(flight(shared("data/crazypad/normal_flight/E8_log00"))) is None


@pytest.mark.parametrize("taught", ["sq1", "sq5"])
def test_arducopter_hides_a_weak_motor_but_its_outputs_tell(taught: str) -> None:
    folder = shared("data/arducopter_sitl")
    rows = flight(folder / f"healthy_quad3kg_{taught}.tlog")
    watched = trim_monitor([rows], detect_layout(rows))
    for square in ("sq1", "sq5"):
        assert trim(watched, flight(folder / f"healthy_quad3kg_{square}.tlog"))[0] < 0.1
        for share in ("080", "090"):
            ratio, rotor = trim(watched, flight(folder / f"fault_quad3kg_m1_{share}_{square}.tlog"))
            assert ratio > 1.5
            assert rotor == 1


def test_unbalance_shows_in_vibration() -> None:
    folder = shared("data/arducopter_sitl")
    healthy = folder / "healthy_jsonplant2_sq1.tlog"
    middle_s = float(flight(healthy)[0].block.t_ns[0]) / 1e9 + 60
    spec, threshold = calibrate(
        [flight(healthy, None, middle_s)],
        vibration_level.fit,
        vibration_level.VibrationLevel,
        guard=vibration_level.GUARD,
    )
    monitor = vibration_level.VibrationLevel(spec)
    highest = []
    for rows in (flight(healthy, middle_s, None), flight(folder / "fault_jsonplant2_m1_eff090_imb_sq1.tlog")):
        state, top = monitor.start(), 0.0
        for one in rows:
            state, reading = monitor.step(state, one)
            top = max(top, float(reading.statistic.max(where=reading.valid, initial=0.0)))
        highest.append(top)
    assert highest[0] < threshold.value < highest[1]


def test_the_upset_is_found_before_the_crash_and_the_loiter_is_not() -> None:
    log = shared("data/ardupilot_real/log171.bin")
    spec, threshold = calibrate(
        [flight(log, 75, 146)], innovation.fit, innovation.Innovation, budget_per_hour=SHARE, guard=innovation.GUARD
    )
    monitor = innovation.Innovation(spec)
    first: list[float | None] = []
    for span in ((146, 217), (217, 239.6)):
        state, alarm = monitor.start(), None
        for one in flight(log, *span):
            state, reading = monitor.step(state, one)
            above = np.flatnonzero(reading.valid & (reading.statistic > threshold.value))
            alarm = float(reading.t_ns[above[0]]) / 1e9 if alarm is None and len(above) else alarm
        first.append(alarm)
    assert first[0] is None
    assert first[1] is not None
    assert 238.5 < first[1] < 239.6
