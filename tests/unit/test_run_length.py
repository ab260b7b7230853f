"""Runs above the margin by a plain count, the margin of healthy flights, and the fit of both axes."""

from dataclasses import replace

import numpy as np
import pytest
from flying_telemetry import flying, flying_rows
from hypothesis import given
from hypothesis import strategies as st
from made_rows import example_context

from mavdiag.errors import IdentificationError
from mavdiag.identify import Method
from mavdiag.identify.model import ModelRecord
from mavdiag.monitors.run_length import RunLength, RunLengthSpec
from mavdiag.telemetry import Axis
from mavdiag.testing import example_rows, with_rates

DT_S = 0.01
CONTEXT = replace(example_context(), window=11)

levels = st.lists(st.tuples(st.sampled_from([0.0, 0.5, 1.0, 1.5, -2.0]), st.booleans()), min_size=1, max_size=60)


@given(rows=levels, axis=st.sampled_from(Axis))
def test_fsd_counts_consecutive_judged_rows_of_its_axis_above_the_margin(
    rows: list[tuple[float, bool]], axis: Axis
) -> None:
    flown, n = example_rows(len(rows) + 4), len(rows)
    turned, judged = (np.array(column) for column in zip(*rows, strict=True))
    made = with_rates(flown, flown.rates.u, np.outer(turned, np.eye(3)[axis.column]), judged)
    still = ModelRecord(a=(1.0, 0.0), b=(0.0,), dt_s=DT_S, order=(1, 1, 0), method=Method.LS)
    monitor = RunLength(RunLengthSpec(axis=axis, model=still, margin_rad_s=1.0))
    _, found = monitor.step(monitor.start(), made)
    expected, count = [], 0
    for x, v in rows:
        count = count + 1 if v and abs(x) > 1.0 else 0
        expected.append(count)
    assert len(found) == n
    np.testing.assert_allclose(found.value, DT_S * np.array(expected), rtol=1e-12)


def test_the_margin_is_hazen_s_90th_percentile_of_the_size() -> None:
    rows = flying_rows(flying(2000, 1))
    for rule, expected in (("p90", 90), ("max", 100)):
        (spec,) = RunLength.fit([rows], replace(CONTEXT, axes=(Axis.ROLL,), margin_rule=rule))
        found = list(RunLength(spec).over(rows))
        levels = np.abs(np.concatenate([one.signal[one.valid] for one in found]))
        assert spec.margin_rad_s == pytest.approx(np.percentile(levels, expected, method="hazen"), rel=1e-9)


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
