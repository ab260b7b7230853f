"""Running means, filters and exponential means of compiled loops against numpy and scipy."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.rows.running import FRESH, mean_size, push, total


@given(seed=st.integers(0, 99), window=st.integers(1, 40), at=st.integers(0, 3))
def test_a_full_window_is_its_mean(seed: int, window: int, at: int) -> None:
    rng = np.random.default_rng(seed)
    x, valid = rng.normal(0, 3, (200, 2)), rng.random(200) > 0.02
    x[~valid] = np.nan
    mem = np.zeros(at + mean_size(window, 2))
    for i in range(200):
        mem[at + FRESH : at + FRESH + 2] = x[i]
        full = push(mem, at, window, 2, bool(valid[i]))
        last = np.where(valid[: i + 1, None], x[: i + 1], 0.0)[-window:]
        assert full == (i + 1 >= window and bool(valid[i + 1 - window : i + 1].all()))
        np.testing.assert_allclose([total(mem, at, 2, 0), total(mem, at, 2, 1)], last.sum(axis=0), atol=1e-10)


def test_what_is_rounded_does_not_grow() -> None:
    mem = np.zeros(mean_size(10, 1))
    for value in (1e12, *[1e-3] * 100_000):
        mem[FRESH] = value
        push(mem, 0, 10, 1, True)
    assert abs(total(mem, 0, 1, 0) - 1e-2) < 1e-15
