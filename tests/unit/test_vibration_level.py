"""The VIBRATION monitor: a mean, a floor, and refusals."""

import numpy as np
import pytest
from made_rows import example_context
from made_thresholds import calibrated

from mavdiag.monitors.vibration_level import VibrationLevel, VibrationLevelSpec
from mavdiag.testing import example_rows


def test_the_statistic_is_the_mean_norm_of_five_seconds() -> None:
    vibration = np.abs(np.random.default_rng(1).normal(1.0, 0.3, (1500, 3)))
    monitor = VibrationLevel(VibrationLevelSpec(healthy=1.0))
    _, found = monitor.step(monitor.start(), example_rows(1500, vibration=vibration))
    size = np.sqrt((vibration**2).sum(axis=1))
    expected = [size[i - 499 : i + 1].mean() for i in range(499, 1500)]
    np.testing.assert_allclose(found.value[found.valid], expected, rtol=1e-12)
    np.testing.assert_allclose(found.level, found.value - 1.0)
    assert int(found.valid.sum()) == 1001


def test_a_still_vehicle_gets_room_of_some_half_a_metre_per_second_squared() -> None:
    flights = [[example_rows(3000, segment=i, vibration=np.full((3000, 3), 0.01))] for i in range(3)]
    monitor, threshold = calibrated(VibrationLevel, flights, example_context())
    spec = monitor.spec
    assert spec.healthy == pytest.approx(0.01 * np.sqrt(3))
    assert 0.3 < threshold.value - spec.healthy < 0.8
