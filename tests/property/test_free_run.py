"""The compiled free run equals scipy's filter, from the first measured rate at rest and in any blocks."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from mavdiag.identify import ArxModel, Method
from mavdiag.identify.model import ModelRecord
from mavdiag.monitors.run_length import RunLength, RunLengthSpec
from mavdiag.telemetry import Axis
from mavdiag.testing import example_rows, rows_between


@st.composite
def models(draw: st.DrawFn) -> ArxModel:
    na, nb, nk = draw(st.integers(1, 4)), draw(st.integers(1, 5)), draw(st.integers(0, 4))
    poles = draw(st.lists(st.floats(-0.98, 0.98), min_size=na, max_size=na))
    b = draw(st.lists(st.floats(-5.0, 5.0), min_size=nb, max_size=nb))
    a = np.real(np.atleast_1d(np.poly(poles)))
    return ArxModel(a, np.array([0.0] * nk + b), 0.01, (na, nb, nk), Method.PUBLISHED)


@given(model=models(), edges=st.lists(st.integers(0, 120), max_size=8), seed=st.integers(0, 2**32 - 1))
def test_a_stream_equals_the_whole_and_scipy(model: ArxModel, edges: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = example_rows(120, rate=rng.standard_normal((120, 3)), setpoint=0.1 * rng.standard_normal((120, 3)))
    monitor = RunLength(RunLengthSpec(axis=Axis.PITCH, model=ModelRecord.of(model), margin_rad_s=1.0))
    whole = monitor.step(monitor.start(), rows)[1].signal
    state, parts = monitor.start(), []
    for first, stop in itertools.pairwise(sorted({0, 120, *edges})):
        state, found = monitor.step(state, rows_between(rows, first, stop))
        parts.append(found.signal)
    assert_array_equal(np.concatenate(parts), whole)
    u, y = rows.rates.u[:, 1], rows.rates.y[:, 1]
    expected = y - model.simulate(u, np.full(len(model.b), u[0]), np.full(len(model.a), y[0]))
    # rounding in one sample rings on with the impulse response of 1/A
    ringing = ArxModel(model.a, np.array([1.0]), model.dt, (len(model.a) - 1, 1, 0), Method.PUBLISHED)
    amplification = float(np.sum(np.abs(ringing.simulate(np.eye(1, len(u) + 1)[0]))))
    scale = 1.0 + float(np.max(np.abs(expected)))
    assert_allclose(whole, expected, rtol=0, atol=1e-14 * scale * (10.0 + amplification))
