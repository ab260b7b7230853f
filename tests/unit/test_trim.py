"""The trim and the rotor whose rise explains it, against numpy's least squares."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.airframe.layout import LAYOUTS, layout_named
from mavdiag.airframe.trim import (
    BESIDE,
    TILT_TRIM,
    rises,
    source_among,
    sources_of,
    trim_of,
)
from mavdiag.errors import InputError
from mavdiag.monitors.rotor_trim import RotorTrim, RotorTrimSpec, highest_rise, rise
from mavdiag.telemetry import FloatArray
from mavdiag.testing import example_rows

CALM = (0.03, 0.02, 0.01)
frames = st.sampled_from(sorted(LAYOUTS))
shifts = st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3)


def by_lstsq(shift: FloatArray, effect: FloatArray, spread: FloatArray) -> float:
    """The rise a of min || diag(1/spread) (effect a - shift) ||."""
    found, *_ = np.linalg.lstsq((effect / spread)[:, None], shift / spread, rcond=None)
    return float(found[0])


@given(frame=frames, shift=shifts, lean=st.lists(st.floats(-0.4, 0.4), min_size=2, max_size=2))
def test_the_rises_are_weighted_least_squares(frame: str, shift: list[float], lean: list[float]) -> None:
    layout = layout_named(frame)
    effects: FloatArray = np.asarray(np.linalg.pinv(layout.mixing), dtype=np.float64)  # (3, rotors)
    wind = TILT_TRIM * math.hypot(*lean)
    spread = np.array([math.hypot(CALM[0], wind), math.hypot(CALM[1], wind), CALM[2]])
    found = rises(np.array([shift]), layout, (spread[0], spread[1], spread[2]))
    expected = [by_lstsq(np.array(shift), effects[:, j], spread) for j in range(layout.rotors)]
    np.testing.assert_allclose(found, [expected], rtol=1e-9, atol=1e-12)


def test_idle_unknown_or_lacking_outputs_give_no_trim() -> None:
    layout, outputs = layout_named("x"), np.full((4, 4), 0.5)
    outputs[1] = 0.04
    outputs[2, 3] = np.nan
    valid = np.array([True, True, True, False])
    found, known = trim_of(example_rows(4, actuator=outputs, valid=valid).block, layout, "actuator")
    assert known.tolist() == [True, False, False, False]
    assert not found.any()
    assert not trim_of(example_rows(4, actuator=outputs[:, :3]).block, layout, "actuator")[1].any()
    assert not trim_of(example_rows(4, torque=np.ones((4, 3)), thrust=np.ones(4)).block, layout, "torque")[1].any()


def test_outputs_are_preferred_to_commands() -> None:
    rng, frame = np.random.default_rng(1), layout_named("crazyflie")
    outputs, torque, thrust = rng.normal(0.5, 0.01, (9, 4)), rng.normal(0.0, 0.01, (9, 3)), np.full(9, 0.5)
    both = example_rows(9, torque=torque, thrust=thrust, actuator=outputs)
    commands = example_rows(9, torque=torque, thrust=thrust)
    assert source_among([sources_of([both], frame)], frame) == "actuator"
    assert source_among([sources_of([commands], frame)], frame) == "torque"
    full = example_rows(9, actuator=np.ones((9, 4)))  # all of them say 100 %, all flight
    for rows in (example_rows(9), full):
        with pytest.raises(InputError, match="outputs of 4 motors that move above idle"):
            source_among([sources_of([rows], frame)], frame)


@given(frame=frames, shift=st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6))
def test_the_compiled_rise_is_that_of_arrays(frame: str, shift: list[float]) -> None:
    layout, both = layout_named(frame), np.array([shift])
    par = RotorTrim(RotorTrimSpec(layout=layout, source="actuator", spread=CALM)).begin(0.01).par
    wind, load = TILT_TRIM * math.hypot(*shift[3:5]), BESIDE * shift[5]
    spread = np.array([*(math.hypot(sd, wind, load) for sd in CALM[:2]), CALM[2]])
    expected = rises(both[:, :3], layout, spread)[0]
    found = [rise(par, rotor, both[0], True) for rotor in range(layout.rotors)]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
    assert highest_rise(par, both[0]) == max(found)
