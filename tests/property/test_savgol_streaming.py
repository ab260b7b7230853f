"""A stream in any blocks gives the batch result bit for bit."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.rows.savgol import SavgolFilter
from mavdiag.telemetry import FloatArray


@given(
    blocks=st.lists(st.integers(0, 60), max_size=12),
    columns=st.integers(1, 4),
    window=st.sampled_from([5, 11, 13, 25, 101]),
    slope=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_stream_equals_batch(blocks: list[int], columns: int, window: int, slope: bool, seed: int) -> None:
    filt = SavgolFilter.differentiator(window, 0.001) if slope else SavgolFilter.smoother(window)
    x = np.random.default_rng(seed).standard_normal((sum(blocks), columns))
    state, start = filt.start(columns), 0
    outputs: list[FloatArray] = [np.empty((0, columns))]
    for rows in blocks:
        state, out = filt.step(state, x[start : start + rows])
        outputs.append(out)
        start += rows
    # A dot product of other lengths is summed in another order: so much rounding of its terms is allowed.
    rounding = 1e-14 * float(np.abs(filt.taps).sum()) * float(np.abs(x).max(initial=0.0))
    np.testing.assert_allclose(np.concatenate(outputs), filt.batch(x), rtol=0.0, atol=rounding)
