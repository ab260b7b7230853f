"""The page of a report: it stands alone, can be read, says what it does not show, and believes no text from outside."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from flying_telemetry import flying, without
from made_baselines import healthy, logged, plain, whole
from made_report import results
from made_telemetry import flight
from page_reading import Page, check

from mavdiag.baseline import Baseline
from mavdiag.errors import InputError
from mavdiag.judging import LogVerdict, Verdict
from mavdiag.report.campaign import parse_campaign, read_campaign
from mavdiag.report.chart import Chart, Line, Panel, Picture, picture
from mavdiag.report.page import FlightReport, campaign_page, flight_report, flights_page
from mavdiag.telemetry import Log, Signal

CREATED = "2026-01-01T00:00:00+00:00"
HOSTILE = "<script>alert(1)</script>\"'>&\u202e$x^2$<img src=x onerror=y>"
SECTIONS = (
    *("timeline", "flight", "evidence", "attitude", "rates", "residual", "fsd"),
    *("plane", "severity", "spectrum", "windows"),
)


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
    assert whole().digest in said or not whole().digest
    for name in ("rotor trim", "unbalance", "fsd ("):
        assert name in said
    assert "What must be known of this log" in said or not weak().verdict.notes
    assert "Link quality" in said
    assert "made 2026-01-01T00:00:00+00:00 by mavdiag" in said
    since_s = weak().verdict.since_s
    assert since_s is not None
    assert f"{since_s - weak().begin_s:.1f} s of the flight" in said


@pytest.mark.parametrize(
    ("log", "reason"),
    [
        (logged(flying(3000, 7), "ardupilot"), "another link"),
        (logged(without(flying(3000, 7), (0.0, 1e9), signals=(Signal.BODY_RATE,))), "no body rate"),
        (logged(without(flying(3000, 7), (0.0, 1e9), signals=(Signal.ATTITUDE_SETPOINT,))), "no attitude setpoint"),
        (logged(flight(3000, 7), "px4"), "another link"),
        (plain(1)[0], "another link"),
    ],
)
def test_a_log_that_carries_less_says_what_is_not_drawn(log: Log, reason: str) -> None:
    found = report_of(log, whole())
    page = check(flights_page([found], whole(), "baseline.json", CREATED))
    keys = [one.key for one in all_pictures(found) if not one.key.startswith("monitor:")]
    assert keys == list(SECTIONS)
    assert reason in page.said


def test_no_text_from_outside_is_markup() -> None:
    log = replace(healthy(1)[0], name=f"{HOSTILE}.tlog", notes=(HOSTILE, "b"), parameters={HOSTILE: 1.0})
    flight_there = report_of(log, whole(), figures=False)
    frame = whole().airframe
    outside = whole().model_copy(update={"airframe": replace(frame, name=HOSTILE, layout_basis=HOSTILE)})
    unread = FlightReport(LogVerdict(f"{HOSTILE}/x", Verdict.ERROR, HOSTILE))
    text = flights_page([flight_there, unread], outside, HOSTILE, CREATED)
    page = check(text)
    assert "img" not in page.tags
    assert "\u202e" not in text
    assert page.said.count("<script>alert(1)</script>") >= 6  # as words


def test_several_logs_begin_with_a_table_that_leads_to_each_and_equal_values_give_equal_pages() -> None:
    flights = [weak(), FlightReport(LogVerdict("gone.bin", Verdict.ERROR, "no such file"))]
    text = flights_page(flights, whole(), "baseline.json", CREATED)
    page = check(text)
    assert {"#log-1", "#log-2"} <= set(page.addresses)
    assert "All logs: 1 not readable, 1 fault." in page.said
    assert "This file could not be read: no such file." in page.said
    assert flights_page(flights, whole(), "baseline.json", CREATED) == text
    assert dots() == dots()


@picture("attitude")
def dots() -> Chart:
    line = Line(np.array([1.0, 2.0]), np.array([3.0, 4.0]), "a & b", shape="dots")
    return Chart([Panel("<label>", [line])], (0.0, 3.0), "words & <more>")


def test_a_campaign_is_drawn_from_its_results() -> None:
    campaign = parse_campaign(results(HOSTILE[:60]))
    assert (len(campaign.flights), campaign.unread, len(campaign.faulty)) == (40, 1, 24)
    page = check(campaign_page(campaign, HOSTILE, CREATED))
    found = sum(one.latency_s is not None for one in campaign.faulty)
    assert f"Of 24 judged flights with a damaged propeller {found} had an alarm" in page.said
    assert {f"campaign-{name}" for name in ("roc", "severity", "latency", "confusion")} <= set(page.ids)
    assert len(page.drawings) == 3


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "holds no flight"),
        (b"[1, 2]", "holds no flight"),
        (b'{"seed": 0, "detection": []}', "is a campaign's summary"),
        (b"\xff\xfe", "not UTF-8"),
        (b'{"record": "flight", "key": 1}', "holds no flight"),
    ],
)
def test_what_is_no_campaign_says_what_to_name(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "c.jsonl"
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"c\.jsonl: {reason}.*sitl-plant campaign -o"):
        read_campaign(path)
