"""What fits make of flights, against plain numpy and scipy over the rows of all flights together."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flying_telemetry import DT_S, flying, flying_rows, without
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.errors import InputError
from mavdiag.monitors import MONITORS
from mavdiag.monitors.base import LearnContext
from mavdiag.monitors.fitting import variance_law
from mavdiag.rows.front import Rows

CONTEXT = LearnContext(Airframe(layout=layout_named("x")), None, DT_S, 11)


@cache
def flights() -> list[list[Rows]]:
    """Three flights, one of them with two breaks and losses."""
    broken = without(flying(3000, 2), (8.0, 9.5), (15.0, 15.2), (20.0, 22.0))
    return [flying_rows(one) for one in (flying(2600, 1), broken, flying(2800, 3))]


@given(st.integers(0, 999), st.floats(-2.0, 2.0))
def test_the_variance_law_is_the_non_negative_least_squares(seed: int, slope: float) -> None:
    rng = np.random.default_rng(seed)
    busy = rng.exponential(1.0, 200)
    squares = np.maximum(1.0 + slope * busy + 0.1 * rng.standard_normal(200), 0.01)
    k0, k1 = variance_law(squares, busy)
    (least0, least1), _ = nnls(np.column_stack((np.ones(200), busy)), squares)
    assert k1 == pytest.approx(least1, rel=1e-6, abs=1e-9)
    assert k0 == pytest.approx(max(least0, 0.05 * squares.mean()), rel=1e-6)


SPECS = {kind.name: kind.fit(flights(), CONTEXT)[0] for kind in MONITORS if kind.name != "unbalance"}


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        ("fsd", "margin_rad_s", 0.0),
        ("innovation", "k0", (1.0, 0.0, 1.0)),
        ("rotor_signature", "window_s", 0.0),
        ("vibration_level", "healthy", math.nan),
        ("rotor_trim", "mean", (math.inf, 0.0, 0.0)),
        ("sensor_noise", "rms", (1.0,) * 5),
        ("sensor_drift", "tilt", 0.0),
        ("thrust_loss", "per_command", math.inf),
    ],
)
def test_a_spec_that_describes_nothing_is_refused_by_its_field(kind: str, field: str, value: object) -> None:
    with pytest.raises(InputError, match=f"{kind}: {field}"):
        replace(SPECS[kind], **{field: value})


def test_what_fits_together_is_checked_together() -> None:
    with pytest.raises(InputError, match="not known"):
        replace(SPECS["rotor_trim"], source="torque")
    with pytest.raises(InputError, match="odd"):
        replace(SPECS["rotor_signature"].motion, window=4)
