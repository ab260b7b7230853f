"""Jolts are cut at four times the rms before them, as one sample after the other tells."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.monitors.model_residual import without_jolts
from mavdiag.rows.windows import start_ema
from mavdiag.telemetry import FloatArray

ALPHA = 0.001


def one_after_the_other(n: FloatArray) -> FloatArray:
    """The definition: s^2 is the mean square of what was kept, and four times max(1, s) cuts the next sample."""
    out = np.empty(n.shape)
    for column in range(n.shape[1]):
        square = 1.0
        for row, value in enumerate(n[:, column].tolist()):
            most = 4.0 * max(1.0, math.sqrt(square))
            out[row, column] = min(max(value, -most), most)
            square += ALPHA * (out[row, column] ** 2 - square)
    return out


@given(
    seed=st.integers(0, 99),
    size=st.sampled_from([0.5, 3.0, 30.0]),
    edges=st.lists(st.integers(0, 900), max_size=10),
)
def test_large_samples_are_cut_as_one_after_the_other(seed: int, size: float, edges: list[int]) -> None:
    rng = np.random.default_rng(seed)
    n = rng.normal(0.0, size, (900, 3)) * np.where(rng.random((900, 1)) < 0.05, 10.0, 1.0)
    n[:, 2] = 0.0
    state, parts = start_ema(np.ones(3)), []
    for piece in np.split(n, sorted(edges)):
        state, kept = without_jolts(state, piece, ALPHA)
        parts.append(kept)
    np.testing.assert_allclose(np.concatenate(parts), one_after_the_other(n), rtol=1e-12)


def test_calm_samples_are_left_alone() -> None:
    calm = np.random.default_rng(1).uniform(-4.0, 4.0, (50, 3))
    assert without_jolts(start_ema(np.ones(3)), calm, ALPHA)[1] is calm
