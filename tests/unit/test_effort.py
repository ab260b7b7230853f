"""The trim monitor: amplitude, rotor, what it must not react to, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from flying_telemetry import flying, flying_rows
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.airframe.layout import LAYOUTS, RotorLayout, layout_named
from mavdiag.decision.events import Reading
from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import Rows
from mavdiag.monitors.rotor_trim import ALERT_TEXT, GUARD, RotorTrim, RotorTrimSpec, fit, judgeable
from mavdiag.telemetry import FloatArray
from mavdiag.testing import example_rows
from mavdiag.thresholds.rule import calibrate

CALM = (0.03, 0.03, 0.01)


def read(spec: RotorTrimSpec, rows: list[Rows]) -> Reading:
    monitor = RotorTrim(spec)
    _, reading = monitor.step(monitor.start(), rows[0])
    return reading


def spec_of(frame: str = "x") -> RotorTrimSpec:
    return RotorTrimSpec(frame=frame, source="actuator", mean=(0.0, 0.0, 0.0), spread=CALM)


@given(frame=st.sampled_from(sorted(LAYOUTS)), rotor=st.integers(0, 3), rise=st.floats(0.02, 0.5))
def test_the_rise_and_its_rotor_come_out_exactly(frame: str, rotor: int, rise: float) -> None:
    w = np.full(4, -rise / 4)
    w[rotor] += rise  # one rotor rises, the mean stays
    reading = read(spec_of(frame), [example_rows(600, actuator=np.tile(0.5 * (1 + w), (600, 1)))])
    assert reading.valid.tolist() == [False] * 499 + [True] * 101
    np.testing.assert_allclose(reading.statistic[reading.valid], rise, rtol=1e-9)
    assert int(reading.rotors[-1].argmax()) == rotor
    np.testing.assert_array_equal(reading.level, reading.statistic)


def test_a_shifted_centre_of_mass_counts_little() -> None:
    shift = np.array([0.06, 0.04, 0.0])  # roll and pitch only
    w = layout_named("x").mixing @ shift
    reading = read(spec_of(), [example_rows(600, actuator=np.tile(0.5 * (1 + w), (600, 1)))])
    weak = read(spec_of(), [example_rows(600, actuator=0.5 * (1 + np.tile([0.2, 0.0, 0.0, 0.0], (600, 1))))])
    assert reading.statistic[-1] < 0.1
    assert weak.statistic[-1] > 0.15
    assert abs(reading.signal[-1]) < 1e-12  # yaw did not move


def test_torque_commands_tell_the_same_as_outputs() -> None:
    frame = layout_named("crazyflie")
    gain = np.array([0.25, 0.25, 0.5]) * 65534 / 65535
    rng, n = np.random.default_rng(2), 800
    torque, thrust = rng.normal([0.02, -0.03, 0.1], 0.05, (n, 3)), rng.uniform(0.5, 0.6, n)
    outputs = thrust[:, None] + (torque * gain) @ frame.mixing.T
    spec = RotorTrimSpec(frame="crazyflie", source="torque", mean=(0.0, 0.0, 0.0), spread=CALM)
    by_torque = read(spec, [example_rows(n, torque=torque, thrust=thrust)])
    by_outputs = read(replace(spec, source="actuator"), [example_rows(n, actuator=outputs)])
    np.testing.assert_allclose(by_torque.rotors, by_outputs.rotors, atol=1e-12)


def test_it_finds_the_weak_rotor_that_healthy_flights_lack() -> None:
    flights = [flying_rows(flying(3000, seed)) for seed in range(3)]
    spec, threshold = calibrate(flights, lambda rest: fit(rest, layout_named("x")), RotorTrim, guard=GUARD)
    assert spec.source == "actuator"
    assert spec.spread[0] >= 3 * spec.spread[2] >= 3 * 0.002
    for seed, rotor in ((11, 1), (12, 2), (13, 3), (14, 4)):
        reading = read(spec, flying_rows(flying(2000, seed, weak_rotor=rotor, rise=0.15)))
        assert reading.statistic[reading.valid].min() > threshold.value, f"seed {seed}"
        assert (reading.rotors[reading.valid].argmax(axis=1) + 1 == rotor).all(), f"seed {seed}"
    calm = read(spec, flying_rows(flying(3000, 15)))
    assert calm.statistic[calm.valid].max() < threshold.value
    assert ALERT_TEXT == "trim shift"


def damaged(outputs: FloatArray) -> FloatArray:
    outputs = outputs.copy()
    outputs[700:710] = np.nan
    outputs[1400] = np.inf
    outputs[1401] = 0.0  # all motors off for a row
    return outputs


def test_broken_outputs_are_not_judged_and_leave_no_trace() -> None:
    sound = np.random.default_rng(5).normal(0.5, 0.01, (2500, 4))
    clean, broken = (read(spec_of(), [example_rows(2500, actuator=x)]) for x in (sound, damaged(sound)))
    assert not broken.valid[700:1209].any()
    assert not broken.valid[1400:1901].any()
    assert broken.valid[1901:].all()
    np.testing.assert_allclose(broken.statistic[1901:], clean.statistic[1901:], atol=1e-12)


def test_why_it_cannot_judge() -> None:
    frame, outputs = layout_named("x"), np.full((100, 4), 0.5)
    assert judgeable([example_rows(100, actuator=outputs)], frame) is None
    assert "layout" in (judgeable([example_rows(100, actuator=outputs)], None) or "")
    for rows in (
        example_rows(100),
        example_rows(100, actuator=outputs[:, :3]),
        example_rows(100, actuator=0 * outputs),
    ):
        assert "outputs of 4 motors" in (judgeable([rows], frame) or "")
    torque, thrust = np.zeros((100, 3)), np.full(100, 0.5)
    assert judgeable([example_rows(100, torque=torque, thrust=thrust)], frame) is not None  # its mixing is not known
    assert judgeable([example_rows(100, torque=torque, thrust=thrust)], layout_named("crazyflie")) is None


def test_refusals() -> None:
    with pytest.raises(InputError, match="effort: it needs the outputs"):
        fit([[example_rows(1000)]], layout_named("x"))
    with pytest.raises(IdentificationError, match="no unbroken 5 s"):
        fit([[example_rows(300, actuator=np.full((300, 4), 0.5))]], layout_named("x"))
    with pytest.raises(InputError, match="spread"):
        RotorTrimSpec(frame="x", source="actuator", mean=(0.0, 0.0, 0.0), spread=(0.0, 1.0, 1.0))
    with pytest.raises(InputError, match="not known"):
        RotorTrimSpec(frame="x", source="torque", mean=(0.0, 0.0, 0.0), spread=CALM)


def test_more_outputs_than_rotors_do_no_harm() -> None:
    outputs = np.random.default_rng(6).normal(0.5, 0.01, (800, 4))
    with_gimbal = np.column_stack((outputs, np.full((800, 2), 0.9)))
    four, six = (read(spec_of(), [example_rows(800, actuator=x)]) for x in (outputs, with_gimbal))
    np.testing.assert_array_equal(four.statistic, six.statistic)


def test_no_frame_hides_a_rotor() -> None:
    for frame in LAYOUTS.values():
        assert isinstance(frame, RotorLayout)
        assert (np.abs(frame.unmixing[2]) > 0.2).all()  # every rotor shows on yaw
