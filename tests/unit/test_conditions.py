"""Conditions of flight: each by its definition, on fast and slow links, with unknown signals and gaps."""

from dataclasses import replace

import numpy as np
import pytest
from made_conditions import column, made_block, measured, rows_of, slowly, spoilt

from mavdiag.monitors.conditions import TILT_BINS
from mavdiag.rows.conditions import BIN_S, Condition
from mavdiag.telemetry import BoolArray, FloatArray
from mavdiag.testing import example_rows

RATES_HZ = (10, 12.5, 20, 33, 50, 100, 400, 1000)


def seen(
    condition: Condition,
    *,
    setpoint: FloatArray | None = None,
    setpoint_valid: BoolArray | None = None,
    rate: FloatArray | None = None,
    thrust: FloatArray | None = None,
    height: FloatArray | None = None,
) -> FloatArray:
    """A condition of 8 s at 100 Hz with these signals."""
    block = example_rows(800, 0.01, setpoint=setpoint, setpoint_valid=setpoint_valid, rate=rate, thrust=thrust).block
    block = block if height is None else replace(block, height=height)
    return column(measured(rows_of(block)), condition)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("broken", [False, True])
def test_every_condition_is_what_its_definition_says(rate_hz: float, broken: bool) -> None:
    block = made_block(round(9 * rate_hz), 1 / rate_hz, seed=round(rate_hz))
    block = spoilt(block, seed=3) if broken else block
    found, (ends, expected) = measured(rows_of(block)), slowly(block)
    assert found.end_ns.tolist() == ends
    assert len(ends) > 70
    for condition in Condition:
        values = column(found, condition)
        np.testing.assert_allclose(values, expected[condition], rtol=1e-9, atol=1e-12, err_msg=condition)
        assert np.isfinite(values).any(), condition


def test_a_nose_that_turns_without_a_command_is_no_condition() -> None:
    """A damaged rotor turns it; before there is a slope of the command, and where none is known, the gyro tells."""
    spun = np.tile([0.0, 0.0, 5.0], (800, 1))
    found = seen(Condition.YAW_RATE, rate=spun)
    assert found[0] == 5.0
    np.testing.assert_array_equal(found[1:], 0.0)
    slow = np.stack((np.zeros(800), np.zeros(800), 0.001 * np.arange(800)), axis=1)
    np.testing.assert_allclose(seen(Condition.YAW_RATE, setpoint=slow, rate=spun)[1:], 0.1, rtol=1e-6)


def test_after_a_step_of_the_heading_the_gyro_tells_for_two_seconds() -> None:
    step = np.zeros((800, 3))
    step[405:, 2] = 1.5  # 15 rad/s in the bin that ends at 4.1 s
    found = seen(Condition.YAW_RATE, setpoint=step, rate=np.tile([0.0, 0.0, -0.8], (800, 1)))
    np.testing.assert_allclose(found[40:60], 0.8)
    np.testing.assert_array_equal(found[60:], 0.0)
    np.testing.assert_array_equal(found[1:40], 0.0)


def test_a_gap_is_not_known_and_leaves_no_trace() -> None:
    block = made_block(1500, 0.01, seed=2)
    valid = np.ones(1500, dtype=np.bool_)
    valid[600:700] = False
    whole, broken = measured(rows_of(block)), measured(rows_of(replace(block, valid=valid)))
    np.testing.assert_array_equal(whole.end_ns, broken.end_ns)
    inside = (broken.end_ns > block.t_ns[610]) & (broken.end_ns <= block.t_ns[690])
    assert inside.any()
    assert np.isnan(broken.values[inside]).all()
    after = broken.end_ns > block.t_ns[700] + (TILT_BINS + 3) * BIN_S * 1e9
    assert after.any()
    np.testing.assert_array_equal(broken.values[after], whole.values[after])
