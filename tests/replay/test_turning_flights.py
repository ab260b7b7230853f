"""A nose that turns in the flights that teach: the trims still see a weak motor, and name it.

The recording with the turning nose has no outputs. They are made from its own gyro by the law of the same simulated
vehicle, whose outputs the locked-yaw recordings have: 0.049 of hover for 1 rad/s^2, and its drag of 0.28 1/s.
"""

import csv
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from shared_data import shared

import mavdiag as md
from mavdiag.airframe.layout import layout_named
from mavdiag.chain import chain_of
from mavdiag.judging import Verdict
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import Log, Series, Signal, Telemetry

STAMP = "1970-01-01T00:00:00+00:00"
X = md.Airframe(layout=layout_named("x"))
PER_ACCELERATION, DRAG_1_S = 0.049, 0.28


def with_outputs(log: Log) -> Log:
    gyro, thrust = log.telemetry.need(Signal.BODY_RATE), log.telemetry.need(Signal.THRUST_SETPOINT)
    yaw = np.convolve(gyro.values[:, 2], np.ones(5) / 5, "same")
    torque = PER_ACCELERATION * (np.gradient(yaw, gyro.t_s) + DRAG_1_S * yaw)
    level = np.interp(gyro.t_ns, thrust.t_ns, thrust.values[:, 0])
    outputs = np.round(1000 * level[:, None] * (1 + np.outer(torque, layout_named("x").mixing[:, 2]))) / 1000
    made = Series(Signal.ACTUATOR, gyro.t_ns[::2], gyro.host_ns[::2], outputs[::2])
    return replace(log, telemetry=Telemetry((*log.telemetry.series, made)))


def weak_spans(path: Path) -> list[tuple[int, float, float, float]]:
    """Motor, what is left of its thrust, start and end [s] of each weakness."""
    with path.open(encoding="utf-8", newline="") as file:
        lines = [one for one in csv.DictReader(file) if one["boot_ms"] and one["kind"] == "segment"]
    return [
        (int(one["name"][1]), float(one["name"][3:]), float(one["boot_ms"]) / 1000, float(after["boot_ms"]) / 1000)
        for one, after in pairwise(lines)
        if one["name"].startswith("m")
    ]


def test_weak_motors_are_found_and_named_by_trims_that_a_turning_nose_taught() -> None:
    """At 0.95 a motor rises by 0.053."""
    folder = shared("data/arducopter_live")
    turning, healthy, weak = (
        md.read_log(folder / f"{name}.tlog")
        for name in ("turning_nose_healthy", "locked_yaw_healthy", "locked_yaw_weak_motors")
    )
    options = LearnOptions(airframe=X, monitors=("rotor_trim", "trim_step"))
    base = learn([with_outputs(turning)], options, created=STAMP)
    limits = {one.spec.kind: one.threshold.value for one in base.monitors}  # 1.08 and 0.62 of hover before
    assert limits["rotor_trim"] < 0.12
    assert limits["trim_step"] < 0.03
    assert md.judge(healthy, base).verdict is Verdict.HEALTHY
    assert md.judge(with_outputs(turning), base).verdict is Verdict.HEALTHY

    chain = chain_of(base)
    state, first = chain.step(chain.start(), weak.telemetry)
    changes = (*first.changes, *chain.finish(state)[1].changes)
    named = []
    spans = weak_spans(folder / "locked_yaw_weak_motors.csv")
    for _, _, start_s, end_s in spans:
        inside = [one for one in changes if start_s <= one.t_ns / 1e9 < end_s and one.rotor]
        named.append(inside[-1].rotor if inside else None)
    assert named == [motor for motor, *_ in spans]
    assert len(spans) == 12


@pytest.mark.parametrize("autopilot", ["ap463", "px4"])
def test_an_autopilot_in_the_loop_names_the_damaged_motor_and_is_silent_in_health(autopilot: str) -> None:
    """Each half of the healthy flight teaches, the other half and the flight with F2/SV2 on motor 4 are judged."""
    folder = shared("data/autopilots_in_the_loop")
    healthy, faulty = (md.read_log(folder / f"{autopilot}_hil_{name}.tlog") for name in ("healthy", "F2SV2_rotor1"))
    times = healthy.telemetry.need(Signal.BODY_RATE).t_ns
    middle = int(times[0] + times[-1]) // 2
    halves = [cut(healthy, int(times[0]), middle), cut(healthy, middle, int(times[-1]) + 1)]
    for taught, other in (halves, halves[::-1]):
        base = learn([taught], LearnOptions(), created=STAMP)
        assert {"rotor_trim", "trim_step"} <= {one.spec.kind for one in base.monitors}
        assert md.judge(other, base).verdict is not Verdict.FAULT
        verdict = md.judge(faulty, base)
        assert verdict.verdict is Verdict.FAULT
        assert {one.rotor for one in verdict.changes if one.rotor} == {4}


def cut(log: Log, start_ns: int, end_ns: int) -> Log:
    series = []
    for one in log.telemetry.series:
        inside = (one.t_ns >= start_ns) & (one.t_ns < end_ns)
        series.append(Series(one.signal, one.t_ns[inside], one.host_ns[inside], one.values[inside]))
    return replace(log, telemetry=Telemetry(tuple(series)))
