"""The rate pair: equal delays, unwrapped angles, and validity of whole windows."""

import numpy as np
from made_telemetry import flight

from mavdiag.rows.align import AlignSpec, align, start
from mavdiag.rows.block import Block
from mavdiag.rows.rates import RateSpec, rates
from mavdiag.rows.rates import start as rate_start
from mavdiag.telemetry import FloatArray

SPEC = RateSpec.of(0.001, 101)


def aligned(setpoint: FloatArray) -> Block:
    """A block of a flight whose set-point is replaced."""
    _, blocks = align(AlignSpec(0.001), start(), flight(len(setpoint) + 51, seed=2))
    block = blocks[0].rows(0, len(setpoint))
    return Block(**{name: getattr(block, name) for name in Block.__slots__} | {"setpoint": setpoint})


def test_a_quadratic_setpoint_has_an_exact_slope_at_the_right_time() -> None:
    t = np.arange(2000) * 1e-3
    block = aligned(np.outer(0.3 * t**2, [1.0, 1.0, 1.0]))
    _, out = rates(SPEC, rate_start(SPEC), block)
    assert len(out) == 2000 - 100
    at = (out.t_ns - block.t_ns[0]) / 1e9
    np.testing.assert_allclose(out.u[:, 0], 0.6 * at, atol=1e-9)


def test_a_turn_through_pi_is_no_step() -> None:
    t = np.arange(3000) * 1e-3
    heading = (2.0 * t + np.pi) % (2 * np.pi) - np.pi
    _, out = rates(SPEC, rate_start(SPEC), aligned(np.outer(heading, [0.0, 0.0, 1.0])))
    np.testing.assert_allclose(out.u[:, 2], 2.0, atol=1e-6)


def test_a_row_is_valid_only_with_its_whole_window() -> None:
    block = aligned(np.zeros((2500, 3)))
    _, out = rates(SPEC, rate_start(SPEC), block)
    first_valid = int(np.argmax(out.valid))
    assert out.t_ns[first_valid] == block.t_ns[int(np.argmax(block.valid)) + 50]
    assert out.valid[first_valid:].all()


def test_a_new_segment_starts_the_filters_afresh() -> None:
    block = aligned(np.ones((300, 3)))
    state, _ = rates(SPEC, rate_start(SPEC), block)
    state, out = rates(SPEC, state, block.rows(0, 50, segment=7))
    assert len(out) == 0
    assert state.segment == 7
