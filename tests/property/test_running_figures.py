"""Sliding and exponential means against numpy and scipy, to the bit for any chunks."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from mavdiag.rows.windows import ema, forgetting, sliding_mean, start_ema, start_mean
from mavdiag.telemetry import BoolArray, FloatArray


def chunked(x: FloatArray, valid: BoolArray, window: int, edges: list[int]) -> tuple[FloatArray, BoolArray]:
    state, means, fulls = start_mean(x.shape[1]), [], []
    bounds = [0, *sorted(edges), len(x)]
    for low, high in itertools.pairwise(bounds):
        state, mean, full = sliding_mean(state, x[low:high], valid[low:high], window)
        means.append(mean)
        fulls.append(full)
    return np.concatenate(means), np.concatenate(fulls)


@given(seed=st.integers(0, 99), window=st.integers(1, 40), edges=st.lists(st.integers(0, 200), max_size=30))
def test_a_full_window_is_its_mean(seed: int, window: int, edges: list[int]) -> None:
    rng = np.random.default_rng(seed)
    x, valid = rng.normal(0, 3, (200, 2)), rng.random(200) > 0.02
    x[~valid] = np.nan
    mean, full = chunked(x, valid, window, edges)
    whole, whole_full = chunked(x, valid, window, [])
    np.testing.assert_array_equal(mean, whole)
    np.testing.assert_array_equal(full, whole_full)
    for i in range(200):
        wanted = i + 1 >= window and bool(valid[i + 1 - window : i + 1].all())
        assert bool(full[i]) == wanted
        if wanted:
            np.testing.assert_allclose(mean[i], x[i + 1 - window : i + 1].mean(axis=0), atol=1e-12)


@given(seed=st.integers(0, 99), cut=st.integers(0, 300), memory_s=st.floats(0.02, 5.0))
def test_the_exponential_mean_is_a_first_order_filter(seed: int, cut: int, memory_s: float) -> None:
    x, alpha = np.random.default_rng(seed).normal(0, 1, (300, 3)), forgetting(memory_s, 0.01)
    state, first = ema(start_ema(np.zeros(3)), x[:cut], alpha)
    _, second = ema(state, x[cut:], alpha)
    whole = ema(start_ema(np.zeros(3)), x, alpha)[1]
    np.testing.assert_array_equal(np.concatenate((first, second)), whole)
    np.testing.assert_allclose(whole, lfilter([alpha], [1, alpha - 1], x, axis=0), atol=1e-12)
