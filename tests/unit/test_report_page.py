"""Reports: pages that stand alone, figures that are what they say, and the drawing of the airframe."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from flying_telemetry import flying, without
from hypothesis import given
from hypothesis import strategies as st
from made_baselines import healthy, logged, whole
from made_history import records
from made_report import ONSET_S, RATE_HZ, ROTOR, cracked, results
from made_telemetry import flight
from page_reading import Page, check
from scipy.signal import welch

from mavdiag.airframe.fingerprint import joined
from mavdiag.airframe.layout import LAYOUTS, Place, RotorLayout, layout_at, layout_named
from mavdiag.baseline import Baseline
from mavdiag.errors import InputError
from mavdiag.face import rates
from mavdiag.history.warn import overview_of
from mavdiag.identify import Method, fit
from mavdiag.identify.estimate import validate
from mavdiag.judging import LogVerdict, Verdict, judge_in_full
from mavdiag.look.figures import spectrum_of
from mavdiag.monitors.base import FaultKind
from mavdiag.report.campaign import read_campaign, roc_of
from mavdiag.report.chart import Picture, Thinned, ticks_of
from mavdiag.report.drawing import SIZE, airframe_svg
from mavdiag.report.page import FlightReport, campaign_page, flight_report, flights_page, history_page
from mavdiag.report.pictures import monitor_picture, sweep_of
from mavdiag.report.sketch import Sketch
from mavdiag.rows.block import Block
from mavdiag.telemetry import Axis, Log, Signal

CREATED = "2026-01-01T00:00:00+00:00"
HOSTILE = "<script>alert(1)</script>\"'>&\u202e$x^2$<img src=x onerror=y>"
SECTIONS = (
    *("timeline", "flight", "evidence", "attitude", "rates", "residual", "fsd"),
    *("plane", "severity", "spectrum", "windows"),
)
SVG = "{http://www.w3.org/2000/svg}"
COAXIAL = layout_at("y6", [Place(x, y, spin) for x, y in ((1, 1), (1, -1), (-1, 0)) for spin in ("cw", "ccw")])


def report_of(log: Log, baseline: Baseline, *, figures: bool = True) -> FlightReport:
    return flight_report(log, baseline, 120, figures=figures)


def all_pictures(report: FlightReport) -> list[Picture]:
    return [*report.pictures, *report.method]


@cache
def weak() -> FlightReport:
    return report_of(logged(flying(3000, 7, weak_rotor=2, rise=0.5)), whole())


@cache
def weak_page() -> Page:
    return check(flights_page([weak()], whole(), "baseline.json", CREATED))


def test_a_page_stands_alone_and_has_every_figure_or_its_reason() -> None:
    page, found = weak_page(), all_pictures(weak())
    monitors = [one.key for one in found if one.key.startswith("monitor:")]
    assert "monitor:rotor_trim" in monitors
    assert [one.key for one in found if one.key not in monitors] == list(SECTIONS)
    assert {f"log-1-{one.key.replace(':', '-')}" for one in found} <= set(page.ids)
    shown = [one for one in found if one.svg]
    assert len(page.drawings) == len(shown) + 1 >= 9  # and the airframe
    for one in found:
        assert bool(one.svg) != bool(one.not_drawn)
        assert f"thesis Fig {one.thesis}" not in page.said
    assert page.said.count("Not drawn: ") == len(found) - len(shown)


def test_the_page_says_the_verdict_its_evidence_and_where_it_comes_from() -> None:
    said = weak_page().said
    assert "A propeller fault of rotor 2 was found" in said
    assert "Above their thresholds: " in said
    assert "% confidence" in said
    assert "look at the propeller of rotor 2 first" in said
    assert ("does not tell the cause (trim shift" in said) == ("trim shift: " in weak().verdict.reason)
    for name in ("rotor trim", "unbalance", "fsd ("):
        assert name in said
    assert "Link quality" in said
    assert "page made 2026-01-01 00:00 UTC by mavdiag" in said
    assert f"{(weak().verdict.since_s or math.nan) - weak().begin_s:.1f} s of the flight" in said
    late = logged(without(flying(300, 7), (0.0, 1.0), signals=(Signal.BODY_RATE,)))  # second 0 is that of the gyro
    for at_ns, told in ((10**18, "01:46:41 UTC"), (late.telemetry.first_ns, "00:00:02 UTC")):  # a wall clock, too
        assert report_of(replace(late, started_ns=at_ns), whole(), figures=False).utc(0.0) == told
    for kind in FaultKind:  # without a rotor
        unnamed = replace(weak(), verdict=replace(weak().verdict, kind=kind, rotor=None, rotors=()))
        assert f"A {kind} was found." in check(flights_page([unnamed], whole(), "baseline.json", CREATED)).said


@pytest.mark.parametrize(
    ("log", "reason"),
    [
        (logged(flying(3000, 7), "ardupilot"), "another link"),
        (logged(without(flying(3000, 7), (0.0, 1e9), signals=(Signal.BODY_RATE,))), "no body rate"),
        (logged(without(flying(3000, 7), (0.0, 1e9), signals=(Signal.ATTITUDE_SETPOINT,))), "no attitude setpoint"),
        (logged(flight(3000, 7), "px4"), "another link"),
    ],
)
def test_a_log_that_carries_less_says_what_is_not_drawn(log: Log, reason: str) -> None:
    found = report_of(log, whole())
    page = check(flights_page([found], whole(), "baseline.json", CREATED))
    assert [one.key for one in all_pictures(found) if not one.key.startswith("monitor:")] == list(SECTIONS)
    assert reason in page.said


def test_every_one_of_twelve_rotors_has_its_line() -> None:
    log = logged(flying(3000, 7, weak_rotor=2, rise=0.5))
    sketch = Sketch(log, 120)
    judge_in_full(log, whole(), show=sketch.take)
    sketch.slots = {key: replace(one, rotors=3 * one.rotors) for key, one in sketch.slots.items()}
    assert "rotor 12" in str(monitor_picture("rotor_trim", sketch, whole()))


def test_no_text_from_outside_is_markup() -> None:
    log = replace(healthy(1)[0], name=f"{HOSTILE}.tlog", notes=(HOSTILE, "b"), parameters={HOSTILE: 1.0})
    flight_there = report_of(log, whole(), figures=False)
    outside = whole().model_copy(update={"airframe": replace(whole().airframe, name=HOSTILE, layout_basis=HOSTILE)})
    unread = FlightReport(LogVerdict(f"{HOSTILE}/x", Verdict.ERROR, HOSTILE))
    text = flights_page([flight_there, unread], outside, HOSTILE, CREATED)
    page = check(text)
    assert "img" not in page.tags
    assert "\u202e" not in text
    assert page.said.count("<script>alert(1)</script>") >= 6  # as words
    told = check(history_page([overview_of(HOSTILE, records([0.5] * 6, airframe=HOSTILE), ())], CREATED))
    assert "img" not in told.tags
    assert told.said.count("<script>alert(1)</script>") >= 2


def test_several_logs_begin_with_a_table_that_leads_to_each_and_equal_values_give_equal_pages() -> None:
    flights = [weak(), FlightReport(LogVerdict("gone.bin", Verdict.ERROR, "no such file"))]
    text = flights_page(flights, whole(), "baseline.json", CREATED)
    page = check(text)
    assert {"#log-1", "#log-2"} <= set(page.addresses)
    assert "All logs: 1 not readable, 1 fault." in page.said
    assert "This file could not be read: no such file." in page.said
    assert flights_page(flights, whole(), "baseline.json", CREATED) == text


def test_a_campaign_is_drawn_from_its_results(tmp_path: Path) -> None:
    (path := tmp_path / "c.jsonl").write_bytes(results(HOSTILE[:60]).encode() + b"\n\xff\xfe")  # a torn line, and none
    campaign = read_campaign(path)
    assert (len(campaign.flights), campaign.unread, len(campaign.faulty)) == (40, 2, 24)
    page = check(campaign_page(campaign, HOSTILE, CREATED))
    found = sum(one.latency_s is not None for one in campaign.faulty)
    assert f"Of 24 judged flights with a damaged propeller {found} had an alarm" in page.said
    assert {f"campaign-{name}" for name in ("roc", "severity", "latency", "confusion")} <= set(page.ids)
    assert len(page.drawings) == 3


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        *((one, "holds no flight") for one in (b"", b"[1, 2]", b"\xff\xfe", b'{"record": "flight", "key": 1}')),
        (b'{"seed": 0, "detection": []}', "is a campaign's summary"),
    ],
)
def test_what_is_no_campaign_says_what_to_name(tmp_path: Path, content: bytes, reason: str) -> None:
    (path := tmp_path / "c.jsonl").write_bytes(content)
    with pytest.raises(InputError, match=rf"c\.jsonl: {reason}.*sitl-plant campaign -o"):
        read_campaign(path)


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
    log, judged = cracked()
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
    assert judged.chain is not None
    sketch = Sketch(log, 300)
    sketch.take(judged.chain, judged.pieces)
    drawn = sketch.spectrum
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
    higher, equal = high[:, None] > low, high[:, None] == low  # Mann and Whitney: ties count half
    assert roc.area == pytest.approx(np.mean(higher + 0.5 * equal))
    assert roc.at_threshold == pytest.approx((np.mean(low > 1), np.mean(high > 1)))


def discs(svg: str) -> dict[int, tuple[float, float, float]]:
    """Centre and radius of each rotor, by its number."""
    found = {}
    for group in ElementTree.fromstring(svg).iter(f"{SVG}g"):
        if "data-rotor" in group.attrib:
            disc = group.find(f"{SVG}circle")
            assert disc is not None
            x, y, radius = (float(disc.attrib[name]) for name in ("cx", "cy", "r"))
            found[int(group.attrib["data-rotor"])] = (x, y, radius)
    return found


@pytest.mark.parametrize("layout", [*LAYOUTS.values(), COAXIAL], ids=lambda layout: layout.name)
def test_every_rotor_is_within_the_picture_and_touches_no_other_one(layout: RotorLayout) -> None:
    found = discs(airframe_svg(layout))
    assert sorted(found) == list(range(1, layout.rotors + 1))
    for number, (x, y, radius) in found.items():
        assert radius > 8
        assert all(radius <= at <= SIZE - radius for at in (x, y))
        assert all(math.dist((x, y), one[:2]) > 2 * radius for other, one in found.items() if other != number)


def test_the_rotors_are_where_the_vehicle_has_them_and_turn_as_it_says() -> None:
    """T Eq 2.2-2.4: 1 rear right, 2 front right, 3 rear left, 4 front left; the nose is up. ArduPilot's quad X."""
    found = discs(airframe_svg(layout_named("qdrone2")))
    sides = {number: (y < SIZE / 2, x > SIZE / 2) for number, (x, y, _) in found.items()}
    assert sides == {1: (False, True), 2: (True, True), 3: (False, False), 4: (True, False)}
    text = airframe_svg(layout_named("x"))
    assert "rotor 1 front right, turns counter-clockwise" in text
    assert "rotor 3 front left, turns clockwise" in text


@given(st.text(), st.text())
def test_no_text_breaks_out(title: str, label: str) -> None:
    layout = layout_named("x")
    hostile = (f"{label}</text><script>1</script>", '"><script>')
    text = airframe_svg(layout, {1: hostile}, title=f"<{title}")
    hostile_tags, tags = (
        {one.tag for one in ElementTree.fromstring(svg).iter()} for svg in (text, airframe_svg(layout))
    )
    assert hostile_tags == tags
    assert "style=" not in airframe_svg(layout)
