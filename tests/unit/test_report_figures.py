"""The numbers behind a report's figures, against calculations of their own."""

from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_report import DOCS, ONSET_S, RATE_HZ, ROTOR, cracked, script
from scipy.signal import welch

from mavdiag.airframe.fingerprint import joined
from mavdiag.face import rates
from mavdiag.identify import Method, fit
from mavdiag.identify.estimate import validate
from mavdiag.look.figures import spectrum_of
from mavdiag.report.campaign import roc_of
from mavdiag.report.chart import Thinned, ticks_of
from mavdiag.report.pictures import longest_by_column, sweep_of
from mavdiag.report.sketch import SHOWN_S, Sketch
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


def test_a_line_is_broken_where_data_are_missing_and_not_where_they_come_seldom() -> None:
    slow, gap = (Thinned((0.0, 100.0), 1000) for _ in range(2))
    slow.add(np.arange(100.0), np.arange(100.0))
    t = np.arange(0.0, 100.0, 0.05)
    gap.add(t[(t < 40) | (t > 60)], t[(t < 40) | (t > 60)])
    assert np.isfinite(slow.line().y).all()
    broken = gap.line()
    assert np.count_nonzero(np.isnan(broken.y)) == 1
    assert 39.8 < broken.x[np.isnan(broken.y)][0] < 40.0


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e6))
def test_ticks_are_few_round_and_within_the_range(low: float, span: float) -> None:
    high = low + span
    found = ticks_of(low, high, 5)
    assert 2 <= len(found) <= 11
    assert all(low - 1e-9 * abs(low) - 1e-6 * span <= at <= high + 1e-9 * abs(high) + 1e-6 * span for at in found)


def test_the_runs_are_those_that_a_walk_over_the_residual_finds() -> None:
    for trace in traces():
        rate, walked = sketch().rates[trace.axis], walk(trace)
        runs = rate.runs
        np.testing.assert_allclose(runs[2], [span for _, span, _ in walked], rtol=0.03)  # less beyond the envelope
        np.testing.assert_allclose(
            runs[[0, 3]].T, [(start - sketch().begin_ns / 1e9, peak) for start, _, peak in walked]
        )
        assert runs[2].max() == pytest.approx(trace.fsd_s.max())
        np.testing.assert_allclose(
            rate.squares / rate.judged, np.mean(np.square(trace.residual[trace.judged])), rtol=1e-9
        )
        few = longest_by_column(runs, 5)
        assert few.shape[1] <= 5 < runs.shape[1]
        assert few[2].max() == runs[2].max()
    start_s, stop_s = sketch().moment
    assert stop_s - start_s == pytest.approx(SHOWN_S)
    assert any(start_s <= rate.longest[1] <= stop_s for rate in sketch().rates.values())
    first, last = sketch().shown[0][0].t_ns[0], sketch().shown[-1][0].t_ns[-1]
    assert sketch().s(int(first)) <= start_s
    assert sketch().s(int(last)) >= stop_s


def walk(trace: RateTrace) -> list[tuple[float, float, float]]:
    """Start [s], length [s] and highest excess of each run, row by row."""
    found: list[tuple[float, float, float]] = []
    start, count, peak = 0.0, 0, 0.0
    for k in range(len(trace.t_ns)):
        excess = abs(trace.measured[k] - trace.simulated[k]) - trace.margin_rad_s
        if count and (not trace.judged[k] or excess <= 0 or trace.segment[k] != trace.segment[k - 1]):
            found.append((start, count / RATE_HZ, peak))
            count = 0
        if trace.judged[k] and excess > 0:
            start, peak = (start, max(peak, excess)) if count else (trace.t_ns[k] / 1e9, excess)
            count += 1
    return [*found, (start, count / RATE_HZ, peak)] if count else found


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


def test_the_pictures_of_the_page_on_reports_are_drawn(tmp_path: Path) -> None:
    script().main(tmp_path)
    page = (DOCS / "operating.md").read_text(encoding="utf-8")
    for name in ("report-evidence.svg", "report-residual.svg"):
        assert f"({name})" in page
        drawn, kept = (ElementTree.parse(folder / name).getroot() for folder in (tmp_path, DOCS))
        # Other versions of the libraries may place a line otherwise; what is said must be the same.
        assert texts_of(drawn) == texts_of(kept)


def texts_of(drawing: ElementTree.Element) -> list[str]:
    return [one.text for one in drawing.iter() if one.text and not one.tag.endswith("desc")]
