"""The numbers behind a report's figures, against calculations of their own."""

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
from mavdiag.identify.validate import validate
from mavdiag.look.figures import spectrum_of
from mavdiag.report.campaign import roc_of
from mavdiag.report.pictures import longest_by_column, moment_of, runs_of, sweep_of
from mavdiag.report.style import envelope
from mavdiag.rows.block import Block
from mavdiag.telemetry import Axis, FloatArray, Signal
from mavdiag.traces import RateTrace, SlotTrace, rate_traces, slot_traces

pytest.importorskip("numba", reason="the plant is an extra")


def traces() -> tuple[tuple[RateTrace, ...], tuple[SlotTrace, ...]]:
    _, judged = cracked()
    assert judged.chain is not None
    return rate_traces(judged.chain, judged.pieces), slot_traces(judged.chain, judged.pieces)


def blocks() -> list[Block]:
    return joined([piece.rows for piece in cracked()[1].pieces])


@given(st.integers(1, 3000), st.integers(2, 60), st.integers(0, 2**32 - 1))
def test_an_envelope_keeps_the_extremes_and_invents_nothing(n: int, columns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t, y = np.cumsum(rng.random(n)), rng.normal(size=n)
    y[rng.random(n) < 0.2] = np.nan
    known = y[np.isfinite(y)]
    for filled, most in ((False, 3 * columns), (True, 2 * columns)):
        shown_t, shown = envelope(t, y, columns, filled=filled)
        if n > 2 * columns:
            assert len(shown) <= most
        assert np.all(np.diff(shown_t) >= 0)
        assert set(shown[np.isfinite(shown)]) <= set(known)
        if len(known):
            assert np.nanmax(shown) == known.max()
    if len(known):
        assert np.nanmin(envelope(t, y, columns)[1]) == known.min()


def test_the_runs_are_those_that_a_walk_over_the_residual_finds() -> None:
    for trace in traces()[0]:
        runs = runs_of(trace)
        walked = walk(trace)
        np.testing.assert_allclose(runs[2], [span for _, span, _ in walked], rtol=0.03)  # less beyond the envelope
        np.testing.assert_allclose(runs[[0, 3]].T, [(start, peak) for start, _, peak in walked])
        assert runs[2].max() == pytest.approx(trace.fsd_s.max())
        start_s, stop_s = moment_of([trace])
        assert start_s <= trace.t_ns[trace.fsd_s.argmax()] / 1e9 <= stop_s
        few = longest_by_column(runs, 5)
        assert few.shape[1] <= 5 < runs.shape[1]
        assert few[2].max() == runs[2].max()


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
