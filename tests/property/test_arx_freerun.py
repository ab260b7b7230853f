"""The streaming simulation equals scipy's filter, in any blocks, from rest and from a given past."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mavdiag.errors import IdentificationError
from mavdiag.identify import ArxModel, Method, freerun
from mavdiag.telemetry import FloatArray


@st.composite
def models(draw: st.DrawFn) -> ArxModel:
    na, nb, nk = draw(st.integers(1, 4)), draw(st.integers(1, 5)), draw(st.integers(0, 4))
    poles = draw(st.lists(st.floats(-0.98, 0.98), min_size=na, max_size=na))
    b = draw(st.lists(st.floats(-5.0, 5.0), min_size=nb, max_size=nb))
    a = np.real(np.atleast_1d(np.poly(poles)))
    return ArxModel(a, np.array([0.0] * nk + b), 0.001, (na, nb, nk), Method.PUBLISHED)


@given(
    model=models(),
    blocks=st.lists(st.integers(0, 40), max_size=8),
    past=st.integers(0, 12),
    seed=st.integers(0, 2**32 - 1),
)
def test_blocks_equal_the_whole(model: ArxModel, blocks: list[int], past: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    past_u, past_y = rng.standard_normal(past), rng.standard_normal(past)
    u = rng.standard_normal(sum(blocks))
    state, position = freerun.start(model, past_u, past_y), 0
    parts: list[FloatArray] = [np.empty(0)]
    for size in blocks:
        state, y_sim = freerun.step(model, state, u[position : position + size])
        parts.append(y_sim)
        position += size
    streamed = np.concatenate(parts)
    whole = freerun.step(model, freerun.start(model, past_u, past_y), u)[1]
    # rounding in one sample rings on with the impulse response of 1/A
    ringing = ArxModel(model.a, np.array([1.0]), model.dt, (len(model.a) - 1, 1, 0), Method.PUBLISHED)
    amplification = float(np.sum(np.abs(ringing.simulate(np.eye(1, len(u) + 1)[0]))))
    scale = 1.0 + float(np.max(np.abs(whole), initial=0.0))
    tolerance = 1e-14 * scale * (10.0 + amplification)
    assert_allclose(whole, model.simulate(u, past_u, past_y), rtol=0, atol=tolerance)
    assert_allclose(streamed, whole, rtol=0, atol=tolerance)


def test_a_state_of_another_order_is_refused() -> None:
    small = ArxModel(np.array([1.0, -0.5]), np.array([0.0, 1.0]), 0.01, (1, 1, 1), Method.PUBLISHED)
    large = ArxModel(np.array([1.0, -0.5, 0.1]), np.array([0.0, 1.0, 2.0]), 0.01, (2, 2, 1), Method.PUBLISHED)
    with pytest.raises(IdentificationError, match="start"):
        freerun.step(large, freerun.start(small), np.zeros(4))
