"""Runs above the margin by a plain count, margins and longest runs of healthy flights, and the fit of both axes."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from flying_telemetry import flying, flying_rows
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.errors import IdentificationError
from mavdiag.identify import Method
from mavdiag.identify.model import ModelRecord
from mavdiag.monitors.run_length import (
    MarginRule,
    Residual,
    RunLength,
    RunLengthSpec,
    margin_of,
    residuals,
)
from mavdiag.rows.front import Rows
from mavdiag.rows.rates import RateBlock
from mavdiag.telemetry import Axis, FloatArray
from mavdiag.testing import example_context, example_rows

DT_S = 0.01
CONTEXT = replace(example_context(), window=11)

levels = st.lists(st.tuples(st.sampled_from([0.0, 0.5, 1.0, 1.5, -2.0]), st.booleans()), min_size=1, max_size=60)


def piece(r: FloatArray) -> Residual:
    n = len(r)
    return Residual(np.arange(n, dtype=np.int64) * 10_000_000, r, np.ones(n, dtype=np.bool_), DT_S)


@given(rows=levels)
def test_fsd_counts_consecutive_judged_rows_above_the_margin(rows: list[tuple[float, bool]]) -> None:
    flown, n = example_rows(len(rows) + 4), len(rows)
    rates = replace(flown.rates, y=np.tile([[x] for x, _ in rows], 3), commanded=np.array([v for _, v in rows]))
    still = ModelRecord(a=(1.0, 0.0), b=(0.0,), dt_s=DT_S, order=(1, 1, 0), method=Method.LS)
    monitor = RunLength(RunLengthSpec(axis=Axis.ROLL, model=still, margin_rad_s=1.0))
    _, found = monitor.step(monitor.start(), Rows(flown.block, rates))
    expected, count = [], 0
    for x, v in rows:
        count = count + 1 if v and abs(x) > 1.0 else 0
        expected.append(count)
    assert len(found) == n
    np.testing.assert_allclose(found.value, DT_S * np.array(expected), rtol=1e-12)


def test_the_margin_is_hazen_s_90th_percentile_of_the_size() -> None:
    r = np.array([-3.0, 1.0, 2.0, -5.0, 4.0])
    assert margin_of([[piece(r)]]) == 5.0  # Hazen: p = (i - 0.5)/n, so 90 % of five values is the fifth
    assert margin_of([[piece(np.arange(1.0, 11.0))]]) == 9.5
    assert margin_of([[piece(r)]], MarginRule.MAXIMUM) == 5.0


def test_b4_a_chunk_does_not_end_a_run() -> None:
    """B4: runs were counted in every chunk for itself, and a flight has two of them."""
    (rows,) = (one for one in flying_rows(flying(2000, 1)) if len(one.block) > 1000)
    (whole,) = RunLength.fit([[rows]], CONTEXT)[:1]
    model = whole.model.model()
    cut = [
        Rows(rows.block.rows(low, high), _part(rows, low, high))
        for low, high in itertools.pairwise((0, 700, 701, 1990))
    ]
    (one,), (other,) = (residuals(flight, Axis.ROLL, model) for flight in ([rows], cut))
    np.testing.assert_array_equal(one.r, other.r)
    assert one.valid.tolist() == other.valid.tolist()


def _part(rows: Rows, low: int, high: int) -> RateBlock:
    rates, kept = rows.rates, slice(low, high)
    return replace(
        rates,
        t_ns=rates.t_ns[kept],
        u=rates.u[kept],
        y=rates.y[kept],
        valid=rates.valid[kept],
        commanded=rates.commanded[kept],
    )


def test_an_axis_that_cannot_be_learnt_does_not_veto_the_other() -> None:
    rows = flying_rows(flying(3000, 2))
    for one in rows:
        one.rates.u[:, 1] = 0.0
    specs = RunLength.fit([rows], CONTEXT)
    assert [spec.axis for spec in specs] == [Axis.ROLL]
    assert specs[0].delay_s == pytest.approx(0.05)
    for one in rows:
        one.rates.u[:, 0] = 0.0
    with pytest.raises(IdentificationError, match=r"roll: u is constant.*; pitch: u is constant"):
        RunLength.fit([rows], CONTEXT)


def test_a_gyro_that_turns_against_its_set_point_is_refused() -> None:
    rows = flying_rows(flying(3000, 3))
    for one in rows:
        np.negative(one.rates.u, out=one.rates.u)
    with pytest.raises(IdentificationError, match="sign conventions"):
        RunLength.fit([rows], CONTEXT)
