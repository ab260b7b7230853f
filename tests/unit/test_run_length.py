"""Models of the healthy response: run lengths beyond the margin, and the innovation."""

from dataclasses import replace

import numpy as np
import pytest
from flying_telemetry import flying, flying_rows
from hypothesis import given
from hypothesis import strategies as st
from made_rows import example_context, example_rows, read
from made_telemetry import body_rates
from scipy.linalg import block_diag, toeplitz
from scipy.signal import lfilter

from mavdiag.errors import IdentificationError, InputError
from mavdiag.identify import Method
from mavdiag.identify.arx import ModelRecord
from mavdiag.monitors import innovation
from mavdiag.monitors.base import Flights
from mavdiag.monitors.fitting import variance_law
from mavdiag.monitors.innovation import Innovation, InnovationSpec
from mavdiag.monitors.run_length import LEAST_MARGIN, RunLength, RunLengthSpec
from mavdiag.rows.block import MADE_UP, VALID, WHOLE, U
from mavdiag.rows.front import Rows
from mavdiag.telemetry import Axis, FloatArray

DT_S = 0.01
CONTEXT = replace(example_context(), window=11)

levels = st.lists(st.tuples(st.sampled_from([0.0, 0.5, 1.0, 1.5, -2.0]), st.booleans()), min_size=1, max_size=60)


@given(rows=levels, axis=st.sampled_from(Axis))
def test_fsd_counts_consecutive_judged_rows_above_the_margin(rows: list[tuple[float, bool]], axis: Axis) -> None:
    made, n = example_rows(len(rows) + 4), len(rows)
    turned, judged = (np.array(column) for column in zip(*rows, strict=True))
    columns = made.block.x[:, len(made.block) - len(made.rates_ns) :]
    columns[WHOLE : WHOLE + 2], columns[U + 3 : U + 6] = judged, np.outer(np.eye(3)[axis.column], turned)
    still = ModelRecord(a=(1.0, 0.0), b=(0.0,), dt_s=DT_S, order=(1, 1, 0), method=Method.LS)
    found = read(RunLength(RunLengthSpec(axis=axis, model=still, margin_rad_s=1.0)), made)
    count = 0
    expected = [count := count + 1 if v and abs(x) > 1.0 else 0 for x, v in rows]
    assert len(found) == n
    np.testing.assert_allclose(found.value, DT_S * np.array(expected), rtol=1e-12)


def test_the_margin_is_hazen_s_90th_percentile_of_the_size() -> None:
    rows = flying_rows(flying(2000, 1))
    rates = [values for one in rows for values in (one.rates.u, one.rates.y)]
    for rule, expected in (("max", 100), ("p90", 90)):
        for values in rates:
            values *= 10.0
        (spec,) = RunLength.fit([rows], replace(CONTEXT, axes=(Axis.ROLL,), margin_rule=rule))
        levels = np.abs(np.concatenate([one.signal[one.valid] for one in RunLength(spec).over(rows)]))
        assert spec.margin_rad_s == pytest.approx(np.percentile(levels, expected, method="hazen"), rel=1e-9)
    for values in rates:
        values *= 1e-4
    assert RunLength.fit([rows], replace(CONTEXT, axes=(Axis.ROLL,)))[0].margin_rad_s == LEAST_MARGIN


def test_an_axis_that_cannot_be_learnt_does_not_veto_the_other() -> None:
    rows = flying_rows(flying(3000, 2))
    for one in rows:
        one.rates.u[:, 1] = 0.0
    specs = RunLength.fit([rows], CONTEXT)
    assert [spec.axis for spec in specs] == [Axis.ROLL]
    assert specs[0].delay_s == pytest.approx(0.05)


@pytest.mark.parametrize(("times", "why"), [(1e-12, "u is constant.*; pitch: u is const"), (-1, "sign conventions")])
def test_an_axis_that_is_not_commanded_or_turns_against_it_is_refused(times: float, why: str) -> None:
    rows = flying_rows(flying(3000, 3))
    for one in rows:
        one.rates.u[:] *= times
    with pytest.raises(IdentificationError, match=why):
        RunLength.fit([rows], CONTEXT)


def fit(flights: Flights, dt_s: float = DT_S) -> InnovationSpec:
    return Innovation.fit(flights, example_context(dt_s=dt_s))[0]


def responding(n: int, seed: int, *, noise: float = 0.02, busy: float = 0.2, bias: float | FloatArray = 0) -> Rows:
    """A gyro that follows the commanded rate, with process noise of `noise` rad/s."""
    rng = np.random.default_rng(seed)
    angle = np.asarray(lfilter([0.02], [1, -0.98], np.repeat(rng.normal(0, busy, (n // 100, 3)), 100, axis=0), axis=0))
    rate = np.asarray(lfilter([0, 0.3], [1, -0.7], body_rates(angle), axis=0))
    rate += np.asarray(lfilter([1], [1, -0.7], noise * rng.standard_normal((n, 3)), axis=0))
    return example_rows(n, DT_S, setpoint=angle, rate=rate + bias)


def test_the_level_is_that_of_textbook_filters() -> None:
    rows, spec = responding(3000, 1), fit([[responding(6000, 2)]])
    found, t = read(Innovation(spec), rows), np.searchsorted(rows.block.t_ns, rows.rates.t_ns)
    z = []
    for k in range(3):
        y, u = rows.block.rate[t, k] - spec.mean[k], rows.rates.u[:, k]
        e, alpha = lfilter([1, *spec.a[k]], [1], y) - lfilter([0, *spec.b[k]], [1], u), 1 - np.exp(-DT_S / 0.35)
        busy, fast = lfilter([alpha], [1, alpha - 1], u**2), np.exp(-DT_S / 0.016)  # 10 Hz
        drift = lfilter([0, 1 - fast], [1, -fast], np.append(np.zeros(4), e[4:]))
        z.append((e - drift) / np.sqrt(spec.k0[k] + spec.k1[k] * busy))
    expected = [np.sqrt(np.mean(np.square(z)[:, i - 99 : i + 1])) for i in range(103, len(t))]
    assert np.flatnonzero(found.valid).tolist() == list(range(103, len(t)))
    np.testing.assert_allclose(found.value[found.valid], expected, rtol=1e-9)


def test_the_fit_is_least_squares_with_the_variance_law_of_its_errors() -> None:
    rows = responding(6000, 3)
    spec, t = fit([[rows]]), np.searchsorted(rows.block.t_ns, rows.rates.t_ns)
    for k in range(3):
        y, u = rows.block.rate[t, k] - spec.mean[k], rows.rates.u[:, k]
        n = len(y)
        phi = np.stack([*(-y[4 - i : n - i] for i in range(1, 5)), *(u[4 - i : n - i] for i in range(1, 5))], axis=1)
        plain, late = np.linalg.lstsq(phi, y[4:], rcond=None)[0], DT_S / 0.2 * np.arange(5)
        gust = len(phi) * 0.05**2 * (1 + late) * np.exp(-late)  # autocorrelation of white noise behind two poles
        normal = phi.T @ phi + block_diag(toeplitz(gust[:4]), len(phi) * 0.001**2 * np.eye(4))
        theta = np.linalg.solve(normal, phi.T @ y[4:] - np.append(gust[1:], np.zeros(4)))
        np.testing.assert_allclose([*spec.a[k], *spec.b[k]], theta, rtol=1e-6, atol=1e-9)
        alpha, fast, e = 1 - np.exp(-DT_S / 0.35), np.exp(-DT_S / 0.016), y[4:] - phi @ theta
        news = np.square(e - lfilter([0, 1 - fast], [1, -fast], e))
        law = variance_law(news, lfilter([alpha], [1, alpha - 1], u**2)[4:])
        assert (spec.k0[k], spec.k1[k]) == pytest.approx(law, rel=1e-3, abs=1e-9)
        assert np.std(e) < 1.06 * np.std(y[4:] - phi @ plain)  # the price in air without gusts


def test_a_gyro_bias_like_the_healthy_one_does_not_count() -> None:
    spec = fit([[responding(6000, 6, bias=0.05)]])
    assert spec.mean == pytest.approx((0.05, 0.05, 0.05), abs=0.02)
    found = read(Innovation(spec), responding(3000, 7, bias=0.05))
    assert float(np.median(found.value[found.valid])) == pytest.approx(1.0, abs=0.1)
    dead = responding(6000, 6)
    dead.rates.gyro[:, 2] = 0.5
    with pytest.raises(IdentificationError, match="constant"):
        fit([[dead]])


def test_a_rotor_s_line_that_a_load_moves_is_not_leant_on() -> None:  # from 155 to 168 Hz, folded from 45 to 32 Hz
    turns = 0.02 * np.pi * np.arange(6000)[:, None]
    light, loaded = (responding(6000, 2, bias=0.05 * np.sin(hz * turns)) for hz in (155, 168))
    (spec,) = Innovation.fit([[light]], example_context(hover_rad_s=310 * np.pi))
    assert float(np.median(read(Innovation(spec), loaded).value)) < 1.2


def test_an_axis_that_is_never_commanded_has_no_law_of_what_its_command_is_rounded_by() -> None:
    (taught := responding(6000, 3)).rates.u[:, 1] *= 1e-12
    spec = fit([[taught]])
    assert (spec.b[1], spec.k1[1]) == ((0.0,) * 4, 0.0)  # 1e12 and 1e24 times what they are
    assert read(Innovation(spec), responding(3000, 7)).value.max() < 3.0


def test_what_is_slow_is_no_news_however_calm_the_flights_that_taught() -> None:
    spec, gust = fit([[responding(6000, 11)]]), 0.3 * np.sin(2 * np.pi * 0.5 * DT_S * np.arange(3000))[:, None]
    calm, windy = (read(Innovation(spec), responding(3000, 12, bias=x * gust)).value[300:] for x in (0, 1))
    assert np.median(windy) < 1.1 * np.median(calm)  # 2.1 times with the mean error in it


def test_flight_at_one_rate_tells_no_variance_at_rest() -> None:
    rng = np.random.default_rng(5)
    for busy in (np.full(6000, 0.3), 0.3 * rng.uniform(0.99, 1.01, 6000)):
        assert variance_law(rng.standard_normal(6000) ** 2, busy) == pytest.approx((1.0, 0.0), abs=0.15)
    busy = rng.exponential(0.3, 60000)  # and flight at many does
    assert variance_law((1 + 10 * busy) * rng.standard_normal(60000) ** 2, busy) == pytest.approx((1, 10), rel=0.1)


def test_one_wild_sample_adds_no_more_than_its_bound() -> None:
    spec, rate = fit([[responding(6000, 11)]]), np.random.default_rng(12).normal(0, 0.02, (3000, 3))
    wild = np.where(np.arange(3000)[:, None] == 1000, 1e300, rate)
    calm, shocked = (read(Innovation(spec), example_rows(3000, DT_S, rate=x)) for x in (rate, wild))
    assert np.isfinite(shocked.value).all()
    assert shocked.value[:1200].max() < (calm.value[:1200].max() ** 2 + 5 * 36.0 / 100) ** 0.5 + 0.01  # 5 rows feel it
    np.testing.assert_allclose(shocked.value[1200:], calm.value[1200:], atol=1e-3)


def test_rows_that_were_made_up_are_no_news_and_teach_nothing() -> None:
    whole, rate, lost = responding(6000, 11), responding(6000, 11).block.rate.copy(), slice(10, None, 20)
    spec, rate[lost] = fit([[whole]]), rate[lost] + 0.1
    lossy = example_rows(6000, DT_S, setpoint=whole.block.setpoint, rate=rate)
    lossy.block.x[VALID, lost] = MADE_UP
    assert read(Innovation(spec), lossy).value.max() < 1.2 * read(Innovation(spec), whole).value.max()
    assert fit([[lossy]]).k0 == pytest.approx(spec.k0, rel=0.1)
    lossy.block.x[VALID, 3000::5] = MADE_UP  # no news from then on
    assert not read(Innovation(spec), lossy).valid[3200:].any()


def test_one_rough_row_more_makes_no_leap() -> None:
    spec, rate = fit([[responding(6000, 11)]]), np.random.default_rng(12).normal(0, 0.02, (1200, 3))
    squares = []
    for many in range(25):
        rough = rate.copy()
        rough[800 : 800 + many] += 0.5 * (-1.0) ** np.arange(many)[:, np.newaxis]  # each row far from the one before
        squares.append(float(read(Innovation(spec), example_rows(1200, DT_S, rate=rough)).value[:850].max()) ** 2)
    assert squares[-1] > 100
    assert max(np.diff(squares)) < 0.12 * squares[-1]  # 24 rows: even steps would be 0.04
    assert squares == sorted(squares)


def test_refusals() -> None:
    with pytest.raises(InputError, match="the gyro comes at 10 Hz; a one-step prediction needs 20 Hz"):
        Innovation.need_stream(10.0)
    still, no = example_rows(2000), "no flight with a gyro and an attitude set-point"
    for rows, why in ((responding(300, 13), "500 are needed"), (still, "constant"), (example_rows(2), no)):
        with pytest.raises((IdentificationError, InputError), match=why):
            fit([[rows]])


def test_b10_every_flight_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """B10: the fit took the first flights until a limit of rows; now a like share of every flight."""
    calm, rough = [responding(4000, 20)], [responding(4000, 21, noise=0.2)]
    monkeypatch.setattr(innovation, "TRAIN_ROWS", 4000)
    one, other = fit([calm, rough]), fit([rough, calm])
    assert one.k0 == pytest.approx(other.k0, rel=1e-6)
    assert one.k0[0] > 10 * fit([calm]).k0[0]
