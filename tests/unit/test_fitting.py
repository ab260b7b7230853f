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
from mavdiag.monitors.base import LearnContext, segments
from mavdiag.monitors.fitting import variance_law
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.monitors.sensor_noise import SensorNoise
from mavdiag.monitors.thrust_loss import ThrustLoss
from mavdiag.monitors.vibration_level import VibrationLevel
from mavdiag.rows.front import Rows

CONTEXT = LearnContext(Airframe(layout=layout_named("x")), None, DT_S, 11)


@cache
def flights() -> list[list[Rows]]:
    """Three flights, one of them with two breaks and losses."""
    broken = without(flying(3000, 2), (8.0, 9.5), (15.0, 15.2), (20.0, 22.0))
    return [flying_rows(one) for one in (flying(2600, 1), broken, flying(2800, 3))]


def valid(name: str) -> np.ndarray:
    """A column of all valid rows."""
    blocks = [rows.block for flight in flights() for rows in flight]
    return np.concatenate([getattr(one, name)[one.valid] for one in blocks])


@given(st.integers(0, 999), st.floats(-2.0, 2.0))
def test_the_variance_law_is_the_non_negative_least_squares(seed: int, slope: float) -> None:
    rng = np.random.default_rng(seed)
    busy = rng.exponential(1.0, 200)
    squares = np.maximum(1.0 + slope * busy + 0.1 * rng.standard_normal(200), 0.01)
    k0, k1 = variance_law(squares, busy)
    (least0, least1), _ = nnls(np.column_stack((np.ones(200), busy)), squares)
    assert k1 == pytest.approx(least1, rel=1e-6, abs=1e-9)
    assert k0 == pytest.approx(max(least0, 0.05 * squares.mean()), rel=1e-6)


def test_means_of_all_rows() -> None:
    (noise,) = SensorNoise.fit(flights(), CONTEXT)
    (loss,) = ThrustLoss.fit(flights(), CONTEXT)
    (vibration,) = VibrationLevel.fit(flights(), CONTEXT)
    force, thrust, shaken = valid("force"), valid("thrust"), valid("vibration")
    known = np.isfinite(thrust)
    assert loss.per_command == pytest.approx((-force[known, 2] / thrust[known]).mean(), rel=1e-12)
    shaken = shaken[np.isfinite(shaken).all(axis=1)]
    assert vibration.healthy == pytest.approx(np.linalg.norm(shaken, axis=1).mean(), rel=1e-12)
    fourth = [
        np.diff(np.column_stack((rows.block.rate, rows.block.force)), n=4, axis=0)[
            np.convolve(rows.block.valid, np.ones(5), "valid") == 5
        ]
        for flight in flights()
        for rows in flight
        if len(rows.block) > 50
    ]
    assert noise.rms == pytest.approx(np.sqrt(np.mean(np.concatenate(fourth) ** 2, axis=0)), rel=1e-2)


def test_the_trim_of_all_windows() -> None:
    (spec,) = RotorTrim.fit(flights(), CONTEXT)
    means = []
    for flight in flights():
        found = []
        for segment in map(list, segments(flight)):
            outputs = np.concatenate([one.block.actuator for one in segment])
            known = np.concatenate([one.block.valid for one in segment]) & np.isfinite(outputs).all(axis=1)
            trim = (outputs / outputs.mean(axis=1, keepdims=True) - 1.0) @ layout_named("x").unmixing.T
            full = np.convolve(known, np.ones(500), "valid") == 500
            windows = np.stack([np.convolve(np.where(known, one, 0.0), np.ones(500) / 500, "valid") for one in trim.T])
            found.append(windows.T[full])
        means.append(np.concatenate(found))
    mu = np.mean([one.mean(axis=0) for one in means], axis=0)
    rms = np.sqrt(np.mean(np.square(np.concatenate(means) - mu), axis=0))
    assert spec.mean == pytest.approx(mu, abs=2e-4)  # ticks are medians, without what a turn takes
    yaw = np.hypot(rms[2], 0.002)
    assert spec.spread == pytest.approx((max(rms[0], 3 * yaw), max(rms[1], 3 * yaw), yaw), rel=0.05)


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
