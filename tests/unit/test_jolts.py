"""Jolts are cut at four times the rms before them, as one sample after the other tells."""

import math
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.identify.arx import Method, ModelRecord
from mavdiag.monitors.rotor_signature import HealthyMotion, residuals_of
from mavdiag.rows.windows import forgetting
from mavdiag.telemetry import FloatArray

PERIOD_S = 0.01
NOTHING = ModelRecord(a=(1.0, 0.0), b=(0.0,), dt_s=PERIOD_S, order=(1, 1, 0), method=Method.LS)
MOTION = HealthyMotion(dt_s=PERIOD_S, stride=1, window=5, roll=NOTHING, pitch=NOTHING, heave=NOTHING)


def one_after_the_other(n: FloatArray) -> FloatArray:
    """The definition: s^2 is the mean square of what was kept, and four times max(1, s) cuts the next sample."""
    out, alpha = np.empty(n.shape), forgetting(10.0, PERIOD_S)
    for column in range(n.shape[1]):
        square = 1.0
        for row, value in enumerate(n[:, column].tolist()):
            most = 4.0 * max(1.0, math.sqrt(square))
            out[row, column] = min(max(value, -most), most)
            square += alpha * (out[row, column] ** 2 - square)
    return out


@given(seed=st.integers(0, 99), size=st.sampled_from([0.5, 3.0, 30.0]))
def test_large_samples_are_cut_as_one_after_the_other(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    samples = np.zeros((900, 7))
    samples[:, 2:5] = rng.normal(0.0, size, (900, 3)) * np.where(rng.random((900, 1)) < 0.05, 10.0, 1.0)
    samples[:, 3], samples[:, 6] = 0.0, 1.0
    found = residuals_of(replace(MOTION, k0=(0.5, 1.0, 2.0)), samples, follows=False)
    np.testing.assert_allclose(found.n, one_after_the_other(found.r / np.sqrt([0.5, 1.0, 2.0])), rtol=1e-9)
