"""Fits to several flights, against plain numpy over the rows of all of them together."""

from functools import cache

import numpy as np
import pytest
from flying_telemetry import DT_S, flying, flying_rows, without

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.monitors.base import LearnContext, segments
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


def joined(name: str) -> tuple[np.ndarray, np.ndarray]:
    """A column of all valid rows, and the rows of all flights."""
    blocks = [rows.block for flight in flights() for rows in flight]
    return np.concatenate([getattr(one, name)[one.valid] for one in blocks]), np.array([len(one) for one in blocks])


def test_means_of_all_rows() -> None:
    (noise,) = SensorNoise.fit(flights(), CONTEXT)
    (loss,) = ThrustLoss.fit(flights(), CONTEXT)
    (vibration,) = VibrationLevel.fit(flights(), CONTEXT)
    force, _ = joined("force")
    thrust, _ = joined("thrust")
    known = np.isfinite(thrust)
    assert loss.per_command == pytest.approx((-force[known, 2] / thrust[known]).mean(), rel=1e-12)
    shaken, _ = joined("vibration")
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
    layout = layout_named("x")
    means = []
    for flight in flights():
        found = []
        for segment in segments(flight):
            outputs = np.concatenate([one.block.actuator for one in segment])
            valid = np.concatenate([one.block.valid for one in segment]) & np.isfinite(outputs).all(axis=1)
            trim = (outputs / outputs.mean(axis=1, keepdims=True) - 1.0) @ layout.unmixing.T
            full = np.convolve(valid, np.ones(500), "valid") == 500
            windows = np.stack([np.convolve(np.where(valid, one, 0.0), np.ones(500) / 500, "valid") for one in trim.T])
            found.append(windows.T[full])
        means.append(np.concatenate(found))
    mu = np.mean([one.mean(axis=0) for one in means], axis=0)
    rms = np.sqrt(np.mean(np.square(np.concatenate(means) - mu), axis=0))
    assert spec.mean == pytest.approx(mu, abs=2e-4)  # ticks are medians, without what a turn takes
    yaw = np.hypot(rms[2], 0.002)
    assert spec.spread == pytest.approx((max(rms[0], 3 * yaw), max(rms[1], 3 * yaw), yaw), rel=0.05)
