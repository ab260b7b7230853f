"""The numbers behind a report's figures, against calculations of their own."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_report import ONSET_S, RATE_HZ, ROTOR, cracked
from scipy.signal import welch

from mavdiag.airframe.fingerprint import joined
from mavdiag.face import rates
from mavdiag.identify import Method, fit
from mavdiag.identify.validate import validate
from mavdiag.look.figures import spectrum_of
from mavdiag.report.campaign import roc_of
from mavdiag.report.chart import Thinned, ticks_of
from mavdiag.report.pictures import sweep_of
from mavdiag.report.sketch import Sketch
from mavdiag.rows.block import Block
from mavdiag.telemetry import Axis, FloatArray, Signal
from mavdiag.traces import RateTrace, rate_traces

pytest.importorskip("numba", reason="the plant is an extra")


def traces() -> tuple[RateTrace, ...]:
    _, judged = cracked()
    assert judged.chain is not None
    return rate_traces(judged.chain, judged.pieces)


@cache
def sketch() -> Sketch:
    log, judged = cracked()
    assert judged.chain is not None
    found = Sketch(log, 300)
    found.take(judged.chain, judged.pieces)
    return found


def blocks() -> list[Block]:
    return joined([piece.rows for piece in cracked()[1].pieces])


@given(st.integers(1, 3000), st.integers(2, 60), st.integers(0, 2**32 - 1))
def test_a_thinned_line_keeps_the_extremes_and_knows_of_no_chunks(n: int, k: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t, y = np.cumsum(rng.random(n)), rng.normal(size=n)
    y[rng.random(n) < 0.2] = np.nan
    known = y[np.isfinite(y)]
    whole, parts = (Thinned((0.0, float(t[-1])), k) for _ in range(2))
    whole.add(t, y)
    for cut in np.array_split(np.arange(n), 7):
        parts.add(t[cut], y[cut])
    line, again, area = whole.line(), parts.line(), whole.area("fault", 0.5)
    np.testing.assert_array_equal(line.x, again.x)
    np.testing.assert_array_equal(line.y, again.y)
    assert np.count_nonzero(np.isfinite(line.y)) <= 2 * k
    assert np.all(np.diff(line.x) >= 0)
    assert set(line.y[np.isfinite(line.y)]) <= set(known)
    if len(known):
        assert (np.nanmin(line.y), np.nanmax(line.y)) == (known.min(), known.max())
        assert whole.mean() == pytest.approx(known.mean())
    assert set(area.y[np.isfinite(area.y)]) <= set(known[known > 0.5])


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e6))
def test_ticks_are_few_round_and_within_the_range(low: float, span: float) -> None:
    high = low + span
    found = ticks_of(low, high, 5)
    assert 2 <= len(found) <= 11
    assert all(low - 1e-9 * abs(low) - 1e-6 * span <= at <= high + 1e-9 * abs(high) + 1e-6 * span for at in found)


def test_the_spectrum_is_scipys_and_its_peak_is_the_rotors_speed() -> None:
    spectrum = spectrum_of(blocks())
    assert spectrum is not None
    log = cracked()[0]
    speeds = log[Signal.ROTOR_SPEED]
    late = speeds.values[speeds.t_s > ONSET_S][:, ROTOR - 1] / (2 * np.pi)
    line = (spectrum.frequency_hz > 100) & (spectrum.frequency_hz < 199)
    peak_hz = spectrum.frequency_hz[line][spectrum.power[line, 0].argmax()]
    assert np.percentile(late, 2) - 2 <= peak_hz <= np.percentile(late, 98) + 2
    valid = np.concatenate([one.valid for one in blocks()])
    force = np.concatenate([one.force for one in blocks()])[valid, :2]
    assert np.count_nonzero(np.diff(valid)) <= 2  # one stretch
    frequency, power = welch(force, RATE_HZ, "hann", 400, 200, detrend="constant", axis=0)
    use = frequency > 5
    np.testing.assert_allclose(spectrum.frequency_hz, frequency, rtol=1e-3)
    np.testing.assert_allclose(spectrum.power[use], power[use], rtol=0.01)
    drawn = sketch().spectrum
    assert drawn is not None
    assert abs(drawn.averaged - spectrum.averaged) <= 2
    np.testing.assert_allclose(drawn.power[use], spectrum.power[use], rtol=0.3)


def test_the_window_sweep_fits_what_identify_fits() -> None:
    log, _ = cracked()
    rows = sweep_of(blocks(), Axis.ROLL, (2, 2, 1), Method.SRIV, 2)
    windows = [row.window for row in rows]
    assert windows == sorted(set(windows))
    row = next(one for one in rows if one.window == 41)
    flight = rates(log, Axis.ROLL, 41 / RATE_HZ)
    model = fit(flight.u, flight.y, (2, 2, 1), dt=flight.dt_s)
    assert row.model is not None
    assert row.model.r2t == pytest.approx(validate(model, flight.u, flight.y).r2t, abs=0.02)


@given(st.lists(st.integers(0, 20), min_size=1, max_size=40), st.lists(st.integers(0, 20), min_size=1, max_size=40))
def test_the_area_of_a_roc_is_the_chance_to_rank_a_pair_rightly(healthy: list[int], damaged: list[int]) -> None:
    low, high = (np.array(one, dtype=np.float64) for one in (healthy, damaged))
    roc = roc_of(low.tolist(), high.tolist())
    assert roc.area == pytest.approx(ranked(low, high))
    assert roc.at_threshold == pytest.approx((np.mean(low > 1), np.mean(high > 1)))


def ranked(low: FloatArray, high: FloatArray) -> float:
    """Mann and Whitney: the share of pairs in which the damaged flight scores higher, ties half."""
    return float(np.mean((high[:, None] > low) + 0.5 * (high[:, None] == low)))
