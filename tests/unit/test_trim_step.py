"""The trim-step monitor: a step is found and named; what was there before, or comes slowly, is not."""

import numpy as np
import pytest
from made_rows import example_context, example_rows

from mavdiag.airframe.layout import LAYOUTS, layout_named
from mavdiag.airframe.trim import CURVE
from mavdiag.errors import IdentificationError
from mavdiag.monitors.rotor_trim import WINDOW_S
from mavdiag.monitors.trim_step import MEMORY_S, TrimStep, TrimStepSpec
from mavdiag.rows.block import COVERED, columns_of, no_past
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray, Three

CALM = (0.03, 0.03, 0.01)
LEAST = TrimStep.prior.least
DT_S = 0.02


def read(outputs: FloatArray, frame: str = "x", setpoint: FloatArray | None = None, spread: Three = CALM) -> Statistic:
    spec = TrimStepSpec(layout=layout_named(frame), source="actuator", spread=spread)
    return next(TrimStep(spec).over([example_rows(len(outputs), DT_S, actuator=outputs, setpoint=setpoint)]))


def level(seconds: float, rotors: int = 4, seed: int = 1) -> FloatArray:
    return np.random.default_rng(seed).normal(0.5, 0.004, (round(seconds / DT_S), rotors))


@pytest.mark.parametrize(("frame", "rotor"), [(f, r) for f in sorted(LAYOUTS) for r in range(layout_named(f).rotors)])
def test_a_step_of_each_rotor_of_each_layout_is_found_and_named(frame: str, rotor: int) -> None:
    layout, n = layout_named(frame), layout_named(frame).rotors
    outputs = level(40, n)
    for drag in (0.0, -1.0):  # as it was, and more of it: only the arm is sure
        other = level(40, n)
        other[1000:] += 0.05 * layout.mixing @ (layout.unmixing[:, rotor] * (1.0, 1.0, drag))
        place = int(read(other, frame, spread=(0.002, 0.002, 0.002)).rotors[-1].argmax())
        np.testing.assert_allclose(layout.unmixing[:2, place], layout.unmixing[:2, rotor], atol=1e-9)
    outputs[1000:, rotor] += 0.05  # after 20 s, a tenth of hover
    found = read(outputs, frame)
    before, after = found.value[found.valid & (found.t_ns < 20e9)], found.value[found.t_ns >= 25.6e9]
    assert before.max() < LEAST
    assert after[0] == pytest.approx(0.1 / (1 + 0.1 / n), rel=0.1)
    assert int(found.rotors[found.t_ns >= 25.6e9][0].argmax()) == rotor
    np.testing.assert_array_equal(found.level, found.value)


@pytest.mark.parametrize(("place", "found"), [(0.0, False), (0.3, False), (1.0, True)])
@pytest.mark.parametrize("weight", [0.05, 0.1, -0.05, 0.25, -0.2])  # of the vehicle's: taken up or dropped
def test_a_load_is_no_weak_rotor_unless_it_hangs_under_one(weight: float, place: float, found: bool) -> None:
    outputs, arms = level(120), np.sign(layout_named("x").mixing[:, :2])
    outputs[1000:] *= (1.0 + weight * (1.0 + place * arms @ arms[2])) ** (1.0 / (1.0 + 2.0 * CURVE))
    outputs[1000:1025] *= 0.5 / outputs[1000:1025].mean()  # the height answers later
    shown = read(outputs, spread=(0.002, 0.002, 0.002))
    value, rotors = shown.value[shown.valid], shown.rotors[shown.valid]
    assert (value.max() > LEAST) == found
    assert not found or rotors[value.argmax()].argmax() == (2 if weight > 0 else 3)
    assert not found or weight < 0 or value.max() > 1.5 * weight  # a rotor that lost four times as much, but no drag
    outputs[2000:, 0] += 0.025  # 20 s later another one, a twentieth of hover
    assert found or read(outputs, spread=(0.002, 0.002, 0.002)).rotors[-1].argmax() == 0


@pytest.mark.parametrize("per_s", [1e-5, 1e-4, 2e-4])
def test_a_slow_drift_is_silent(per_s: float) -> None:
    """A rise of `per_s` of hover a second lags by no more than the memory and a window and a half; a fast one shows."""
    rise, climbs = 0.5 * DT_S * np.arange(9000)[:, None] * np.eye(4)[2], 1.0 + 0.06 * (np.arange(9000) // 750 % 2)
    outputs = level(180) + per_s * rise
    found = read(outputs)
    assert found.value[found.valid].max() < LEAST
    assert found.rotors[-60:, 2].mean() == pytest.approx(per_s * (MEMORY_S + 1.5 * WINDOW_S), abs=0.001)
    assert read((outputs + 5e-4 * rise) * climbs[:, None]).value.max() > 3 * LEAST  # though lift comes and goes


def test_nothing_is_judged_before_there_are_two_windows_nor_after_a_gap() -> None:
    outputs = level(40)
    outputs[1000:1010] = np.nan
    found = read(outputs)
    judged = found.t_ns[found.valid] / 1e9
    assert judged[0] == pytest.approx(2 * WINDOW_S, abs=DT_S)
    assert len(judged[(judged > 19.9) & (judged < 20 + 2 * WINDOW_S)]) <= 1
    assert judged[-1] > 39


def test_a_flight_that_is_too_short_is_refused() -> None:
    short = [[example_rows(950, 0.01, segment=i, actuator=level(19)) for i in range(3)]]
    for flights in (short, [short[0][:1]]):
        with pytest.raises(IdentificationError, match="no unbroken 10 s of flight to compare trims in; fly longer"):
            TrimStep.fit(flights, example_context("x"))
    assert TrimStep.fit([[example_rows(1050, 0.01, actuator=level(21))]], example_context("x"))


def test_outputs_that_stand_still_are_no_step_and_no_rotor() -> None:
    outputs = level(60)
    outputs[1000:, 1] = 0.56  # what they happened to be when the link began to repeat itself
    outputs[1000:] = outputs[1000]
    found = read(outputs)
    assert found.value[found.valid].max() < LEAST + 0.12 / 10  # one tick of ten, at most
    assert not found.valid[found.t_ns > 21e9].any()
    assert not read(np.ones((2000, 4))).valid.any()  # "all motors 100 %" is nothing to judge by


def test_ground_effect_is_no_reference() -> None:
    """20 s in low hover, outside of the envelope, then away: the shift was a fault for the rest of the flight."""
    outputs = level(90)
    outputs[1000:] *= 1 + layout_named("x").mixing @ np.array([0.0, 0.0, 0.03])
    spec = TrimStepSpec(layout=layout_named("x"), source="actuator", spread=CALM)
    monitor, rows = TrimStep(spec), example_rows(len(outputs), DT_S, actuator=outputs)
    assert next(monitor.over([rows])).value.max() > LEAST
    columns, begun = columns_of(rows, no_past(0)), monitor.begin(DT_S)
    columns.x[COVERED] = rows.block.t_ns > 21e9
    found = monitor.judge(begun, rows, columns, 0)[0]
    assert found.value[found.valid].max() < LEAST
    assert found.t_ns[found.valid][0] >= 30.9e9


def test_what_stays_becomes_the_reference_and_its_repair_is_no_fault() -> None:
    outputs = level(260)
    outputs[1000:9000, 2] += 0.05  # from 20 to 180 s
    found = read(outputs)
    at = found.t_ns / 1e9
    assert found.value[(at > 26) & (at < 120)].min() > 0.09
    assert found.value[at > 160].max() < LEAST  # there is a way out, and back: no other rotor rises
    outputs[11000:, 0] += 0.05  # another one, at 220 s
    again = read(outputs)
    assert again.value[again.t_ns > 226e9].min() > 0.08
    assert (again.rotors[again.t_ns > 226e9].argmax(axis=1) == 0).all()
